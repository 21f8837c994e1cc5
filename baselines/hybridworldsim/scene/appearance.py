"""Latent vectors of appearance: one for each traversal and camera that was trained on."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from hybridworldsim.training.viewpoint import Source
from mirror.errors import UsageError

_SPREAD = 0.1


class Appearance(nn.Module):
    """z(drive, sensor), supplement "Controllable Lighting Change".

    Args:
        sources: pairs that are trained on.
        size: of a latent vector.
    """

    def __init__(self, sources: Sequence[Source], size: int) -> None:
        super().__init__()
        self.sources = tuple(sources)
        self._rows = {source: row for row, source in enumerate(self.sources)}
        self.latents = nn.Parameter(_SPREAD * torch.randn(len(self.sources), size))

    def forward(self, source: Source) -> Tensor:
        """(size,) of a pair.

        Raises:
            UsageError: it was not trained on; `policies` say what to take in its place.
        """
        row = self._rows.get(source)
        if row is None:
            raise UsageError(
                f"no appearance of camera {source.camera} in {source.traversal_id}",
                expected=f"one of the {len(self.sources)} pairs that were trained on",
                remedy="choose what to take in its place: --appearance nearest, mean or a traversal",
            )
        return self.latents[row]

    def add(self, source: Source, latent: Tensor) -> None:
        """Know one more pair, by a latent (size,) that was fitted to it; a known pair gets another latent."""
        with torch.no_grad():
            if source in self._rows:
                self.latents[self._rows[source]] = latent
                return
            self._rows[source] = len(self.sources)
            self.sources = (*self.sources, source)
            self.latents = nn.Parameter(torch.cat([self.latents, latent[None]]))
