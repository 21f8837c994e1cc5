"""Gaussians as the rasterizer takes them, decoded for one viewpoint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class Splats:
    """What a node shows of itself.

    Attributes:
        means: (N, 3) in the block's frame, metres.
        quats: (N, 4) scalar first, of any length.
        scales: (N, 3) standard deviations, metres.
        opacities: (N,) in [0, 1].
        colours: (N, 3) in [0, 1].
        rows: (N,) int64: which of the node's Gaussians these are.
        held: how many Gaussians the node has in all.
        decoded: how many it decoded.
        seen: (M,) int64: of a node of anchors, which of them were decoded.
    """

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    colours: Tensor
    rows: Tensor
    held: int
    decoded: int
    seen: Tensor | None = None

    def __len__(self) -> int:
        return len(self.means)


def joined(parts: Sequence[Splats]) -> Splats:
    """Those of several nodes one after the other; `rows` counts through them all."""
    return Splats(
        torch.cat([part.means for part in parts]),
        torch.cat([part.quats for part in parts]),
        torch.cat([part.scales for part in parts]),
        torch.cat([part.opacities for part in parts]),
        torch.cat([part.colours for part in parts]),
        rows=torch.arange(sum(map(len, parts))),
        held=sum(part.held for part in parts),
        decoded=sum(part.decoded for part in parts),
    )
