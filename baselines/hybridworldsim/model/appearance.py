"""Latent vectors of appearance: one for each traversal and camera of the training images."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from hybridworldsim.trainable.viewpoint import Source
from mirror.errors import UsageError

_SPREAD = 0.1


class AppearanceLatents(nn.Module):
    """The latent z(drive, sensor) of each camera in each traversal (supplement, "Controllable Lighting Change").

    The latent of a pair is the sum of the traversal's latent and of the pair's own. The pair's own latent begins at
    zero and learns slowly, so that a place that one camera of a traversal did not record is coloured as the other
    cameras recorded it.

    Args:
        sources: training pairs of traversal and camera.
        size: length of a latent vector.
    """

    def __init__(self, sources: Sequence[Source], size: int) -> None:
        super().__init__()
        self.sources: tuple[Source, ...] = ()
        self._rows: dict[Source, int] = {}
        self._drives: dict[str, int] = {}
        for source in sources:
            self._add_row(source)
        self.drives = nn.Parameter(_SPREAD * torch.randn(len(self._drives), size))
        self.sensors = nn.Parameter(torch.zeros(len(self.sources), size))

    def forward(self, source: Source) -> Tensor:
        """Return the latent (size,) of a pair.

        Raises:
            UsageError: the pair was not trained on.
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
        """Add a pair of traversal and camera with a fitted latent (size,); a known pair gets the new latent."""
        with torch.no_grad():
            self._add_row(source)
            self.drives, self.sensors = (
                nn.Parameter(torch.cat([table, table.new_zeros(count - len(table), table.shape[1])]))
                for table, count in ((self.drives, len(self._drives)), (self.sensors, len(self.sources)))
            )
            self.sensors[self._rows[source]] = latent - self.drives[self._drives[source.traversal_id]]

    def _add_row(self, source: Source) -> None:
        if source not in self._rows:
            self._rows[source] = len(self.sources)
            self.sources = (*self.sources, source)
            self._drives.setdefault(source.traversal_id, len(self._drives))
