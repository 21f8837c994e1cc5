"""Parameters of single training images; an image is identified by its source and its pose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import torch
from torch import Tensor, nn

from hybridworldsim.trainable.viewpoint import Source, Viewpoint
from mirror_baselines.splatting.kept_parameters import KeepsParameters
from mirror_baselines.splatting.row_adam import RowAdam

_KEY = 17


class PerImageTable(KeepsParameters):
    """A table with one row for each image; a row is added when its image is first used.

    Args:
        sources: traversals and cameras of the images.
        size: number of parameters of an image.
    """

    KEPT: ClassVar = ("keys",)

    def __init__(self, sources: Sequence[Source], size: int) -> None:
        super().__init__()
        self._sources = {source: place for place, source in enumerate(sources)}
        self.table = nn.Parameter(torch.empty(0, size))
        # A parameter, so that it is stored with the model.
        self.keys = nn.Parameter(torch.empty(0, _KEY), requires_grad=False)
        self._rows: dict[bytes, int] = {}
        self.adam = RowAdam(self.table)

    def row(self, viewpoint: Viewpoint) -> int | None:
        """Return the row of an image; None if the image was not trained on."""
        if len(self._rows) != len(self.keys):
            self._rows = {key.tobytes(): row for row, key in enumerate(self.keys.numpy())}
        key = self._key(viewpoint)
        return None if key is None else self._rows.get(key.numpy().tobytes())

    def add_image(self, viewpoint: Viewpoint, first: Tensor) -> None:
        """Add a row for an image unless it has one.

        Args:
            viewpoint: camera of the image.
            first: (size,) initial row.
        """
        key = self._key(viewpoint)
        if key is None or self.row(viewpoint) is not None:
            return
        first = first.to(self.table.device, non_blocking=True)
        table = nn.Parameter(torch.cat([self.table.detach(), first[None]]))
        moments = self.adam.state.pop(self.table, {})
        for name in ("exp_avg", "exp_avg_sq"):
            if name in moments:
                moments[name] = torch.cat([moments[name], torch.zeros_like(first)[None]])
        if moments:
            self.adam.state[table] = moments
        self.adam.param_groups[0]["params"] = [table]
        self.table = table
        self._rows[key.numpy().tobytes()] = len(self.keys)
        self.keys = nn.Parameter(torch.cat([self.keys, key[None]]), requires_grad=False)

    def update(self, viewpoint: Viewpoint) -> None:
        """Update the row of an image by its gradient."""
        row = self.row(viewpoint)
        if row is not None and self.table.grad is not None:
            rows = torch.full((1,), row, dtype=torch.int64, device=self.table.device)
            self.adam.update(rows, self.table.grad[row][None])
        self.table.grad = None

    def _key(self, viewpoint: Viewpoint) -> Tensor | None:
        place = self._sources.get(viewpoint.source)
        return None if place is None else torch.cat([torch.tensor([float(place)]), viewpoint.viewmat.flatten()])
