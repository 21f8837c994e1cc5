"""Gaussians as the rasterizer takes them, decoded for one viewpoint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class DecodedSplats:
    """The decoded Gaussians of a node.

    Attributes:
        means: (N, 3) in the block's frame, metres.
        quats: (N, 4) scalar first, of any length.
        scales: (N, 3) standard deviations, metres.
        opacities: (N,) in [0, 1].
        colours: (N, 3) in [0, 1].
        rows: (N,) int64 indices among the node's Gaussians.
        stored_count: number of Gaussians of the node.
        decoded_count: number of Gaussians that were decoded.
        anchor_ids: (M,) int64 decoded anchors, for a node of anchors.
    """

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    colours: Tensor
    rows: Tensor
    stored_count: int
    decoded_count: int
    anchor_ids: Tensor | None = None

    def __len__(self) -> int:
        return len(self.means)


def concatenate_splats(parts: Sequence[DecodedSplats]) -> DecodedSplats:
    """Concatenate the Gaussians of several nodes; `rows` numbers the Gaussians of all nodes."""
    return DecodedSplats(
        torch.cat([part.means for part in parts]),
        torch.cat([part.quats for part in parts]),
        torch.cat([part.scales for part in parts]),
        torch.cat([part.opacities for part in parts]),
        torch.cat([part.colours for part in parts]),
        rows=torch.arange(sum(map(len, parts)), device=parts[0].means.device),
        stored_count=sum(part.stored_count for part in parts),
        decoded_count=sum(part.decoded_count for part in parts),
    )
