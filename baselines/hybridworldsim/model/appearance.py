"""Latent vectors of appearance: one for each traversal and camera that was trained on."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from hybridworldsim.training.viewpoint import Source
from mirror.errors import UsageError

_SPREAD = 0.1


class AppearanceLatents(nn.Module):
    """z(drive, sensor), supplement "Controllable Lighting Change": what a traversal looks like, and a camera in it.

    A pair's latent is its traversal's and the pair's own, which begins at zero and learns slowly: a place that one
    camera of a traversal never saw then looks there as it does to the others.

    Args:
        sources: pairs that are trained on.
        size: of a latent vector.
    """

    def __init__(self, sources: Sequence[Source], size: int) -> None:
        super().__init__()
        self.sources: tuple[Source, ...] = ()
        self._rows: dict[Source, int] = {}
        self._drives: dict[str, int] = {}
        for source in sources:
            self._know(source)
        self.drives = nn.Parameter(_SPREAD * torch.randn(len(self._drives), size))
        self.sensors = nn.Parameter(torch.zeros(len(self.sources), size))

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
        return self.drives[self._drives[source.traversal_id]] + self.sensors[row]

    def add(self, source: Source, latent: Tensor) -> None:
        """Know one more pair, by a latent (size,) that was fitted to it; a known pair gets another latent."""
        with torch.no_grad():
            self._know(source)
            self.drives, self.sensors = (
                nn.Parameter(torch.cat([table, table.new_zeros(count - len(table), table.shape[1])]))
                for table, count in ((self.drives, len(self._drives)), (self.sensors, len(self.sources)))
            )
            self.sensors[self._rows[source]] = latent - self.drives[self._drives[source.traversal_id]]

    def _know(self, source: Source) -> None:
        if source not in self._rows:
            self._rows[source] = len(self.sources)
            self.sources = (*self.sources, source)
            self._drives.setdefault(source.traversal_id, len(self._drives))
