"""Colours of OmniRe: a cube of sky behind the Gaussians, and an affine map of colours for each image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.optim import Optimizer

from hybridworldsim.training.training_image import TrainingImage
from hybridworldsim.training.viewpoint import Source, Viewpoint
from mirror_baselines.omnire_style.sky_cube import SkyCube
from mirror_baselines.splatting.appearance import AppearanceModel, FinishedImage
from mirror_baselines.splatting.per_image import PerImageTable

if TYPE_CHECKING:
    from mirror_baselines.omnire_style.settings import OmnireStyle

_LEAST: Final = 1e-4
_IDENTITY: Final = torch.eye(3, 4)


class AffineAppearance(AppearanceModel):
    """Spherical harmonics before a sky, through a map of colours that an image's embedding gives.

    An image that was not trained on has the mean of all embeddings, as in OmniRe.

    Args:
        sources: whose images are trained on.
        settings: sizes and rates.
    """

    def __init__(self, sources: Sequence[Source], settings: OmnireStyle) -> None:
        super().__init__(settings.sh_degree)
        self.settings = settings
        self.cube = SkyCube(settings.sky_px)
        self.embeddings = PerImageTable(sources, settings.embedding)
        last = nn.Linear(settings.hidden, _IDENTITY.numel())
        self.affine = nn.Sequential(nn.Linear(settings.embedding, settings.hidden), nn.ReLU(), last)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self._adam = torch.optim.Adam(
            [{"params": self.cube.parameters()}, {"params": self.affine.parameters()}], eps=1e-15, fused=True
        )
        self._generator = torch.Generator()

    def optimizers(self) -> list[Optimizer]:
        """See `AppearanceModel`."""
        return [self._adam, self.embeddings.adam]

    def prepare(self, viewpoint: Viewpoint, progress: float) -> None:
        """See `AppearanceModel`."""
        sky, affine = self.settings.sky.at(progress), self.settings.affine.at(progress)
        self._adam.param_groups[0]["lr"] = sky
        self._adam.param_groups[1]["lr"] = affine
        self.embeddings.adam.param_groups[0]["lr"] = affine
        self._generator.manual_seed(self.settings.seed * 1_000_003 + len(self.embeddings.keys))
        self.embeddings.add_image(viewpoint, torch.randn(self.settings.embedding, generator=self._generator))

    def update(self, viewpoint: Viewpoint) -> None:
        """See `AppearanceModel`."""
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)
        self.embeddings.update(viewpoint)

    def finish(self, rgb: Tensor, alpha: Tensor, viewpoint: Viewpoint) -> FinishedImage:
        """See `AppearanceModel`."""
        whole = rgb + (1.0 - alpha)[..., None] * self.cube(viewpoint)
        row = self.embeddings.row(viewpoint)
        table = self.embeddings.table
        if row is None and not len(table):
            return FinishedImage(whole, whole)
        matrix = self.affine(table.mean(0) if row is None else table[row]).view(3, 4) + _IDENTITY
        mapped = whole @ matrix[:, :3].T + matrix[:, 3]
        return FinishedImage(mapped, mapped)

    def losses(self, alpha: Tensor, image: TrainingImage) -> dict[str, tuple[float, Tensor]]:
        """Cross entropy of what is opaque and what is not sky, where the dataset has masks of the sky."""
        if image.sky is None or not self.settings.opacity_weight:
            return {}
        solid = (~image.sky).to(alpha.dtype)
        entropy = functional.binary_cross_entropy(alpha.clamp(_LEAST, 1.0 - _LEAST), solid, reduction="none")
        mean = torch.where(image.scored, entropy, 0.0).sum() / image.scored.sum().clamp_min(1)
        return {"opacity": (self.settings.opacity_weight, mean)}
