"""Colours of MTGS: each traversal has its own higher bands, and each training image its exposure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import torch
from torch import Tensor
from torch.optim import Optimizer

from hybridworldsim.model.settings import Rate
from hybridworldsim.trainable.viewpoint import Source, Viewpoint
from mirror.errors import UsageError
from mirror_baselines.splatting.appearance import AppearanceModel, FinishedImage
from mirror_baselines.splatting.per_image import PerImageTable

_IDENTITY: Final = torch.eye(3, 4)


class TraversalAppearance(AppearanceModel):
    """Spherical harmonics with a part for each traversal; memory grows with the number of traversals.

    Args:
        sh_degree: degree of the spherical harmonics.
        sources: traversals and cameras of the training images.
        adapters: whether traversals differ in the constant band too.
        exposure: learning rate of each training image's 3 x 4 colour matrix; None: there are no matrices.
    """

    def __init__(self, sh_degree: int, sources: Sequence[Source], *, adapters: bool, exposure: Rate | None) -> None:
        super().__init__(sh_degree)
        names = sorted({source.traversal_id for source in sources})
        self._traversals = {name: place for place, name in enumerate(names)}
        self._adapters, self._rate = adapters, exposure
        self.exposures = PerImageTable(sources, _IDENTITY.numel())

    def tables(self, count: int) -> dict[str, Tensor]:
        """See `AppearanceModel`."""
        rest = (self.sh_degree + 1) ** 2 - 1
        bands = {f"shN_{place}": torch.zeros(count, rest, 3) for place in self._traversals.values()}
        if self._adapters:
            bands |= {f"adapter_{place}": torch.zeros(count, 1, 3) for place in self._traversals.values()}
        return bands

    def bands(self, source: Source, degree: int) -> list[tuple[str, int, int]]:
        """See `AppearanceModel`.

        Raises:
            UsageError: the traversal was not trained on.
        """
        place = self._traversals.get(source.traversal_id)
        if place is None:
            raise UsageError(
                f"no appearance of {source.traversal_id}",
                expected=f"one of the {len(self._traversals)} traversals that were trained on",
                remedy="render it with the appearance of the nearest of them",
            )
        bands = [("sh0", 0, 1)]
        if degree:
            bands.append((f"shN_{place}", 1, (degree + 1) ** 2))
        if self._adapters:
            bands.append((f"adapter_{place}", 0, 1))
        return bands

    def optimizers(self) -> list[Optimizer]:
        """See `AppearanceModel`."""
        return [self.exposures.adam]

    def prepare(self, viewpoint: Viewpoint, progress: float) -> None:
        """See `AppearanceModel`."""
        if self._rate is not None:
            self.exposures.adam.param_groups[0]["lr"] = self._rate.at(progress)
            self.exposures.add_image(viewpoint, _IDENTITY.flatten())

    def update(self, viewpoint: Viewpoint) -> None:
        """See `AppearanceModel`."""
        self.exposures.update(viewpoint)

    def finish(self, rgb: Tensor, alpha: Tensor, viewpoint: Viewpoint) -> FinishedImage:
        """See `AppearanceModel`; SSIM compares the colours before the matrix."""
        row = self.exposures.row(viewpoint)
        if row is None:
            return FinishedImage(rgb, rgb)
        matrix = self.exposures.table[row].view(3, 4)
        return FinishedImage(rgb @ matrix[:, :3].T + matrix[:, 3], rgb)
