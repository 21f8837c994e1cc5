"""Colours of OmniRe: a sky cube behind the Gaussians, and an affine map of colours for each image."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.optim import Optimizer

from hybridworldsim.trainable.training_image import TrainingImage
from hybridworldsim.trainable.viewpoint import Source, Viewpoint
from mirror_baselines.omnire_style.sky_cube import SkyCube
from mirror_baselines.splatting.appearance import AppearanceModel, FinishedImage
from mirror_baselines.splatting.per_image import PerImageTable

if TYPE_CHECKING:
    from mirror_baselines.omnire_style.settings import OmnireStyle

_LEAST: Final = 1e-4
_IDENTITY: Final = torch.eye(3, 4)


class AffineAppearance(AppearanceModel):
    """Spherical harmonics in front of a sky, followed by an affine colour map that depends on the image's embedding.

    An untrained image uses the mean of all embeddings, as in OmniRe.

    Args:
        sources: traversals and cameras of the training images.
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
        self._adam = self._make_adam()
        self._generator = torch.Generator()

    def _make_adam(self) -> Optimizer:
        groups = [{"params": self.cube.parameters()}, {"params": self.affine.parameters()}]
        return torch.optim.Adam(groups, eps=1e-15, fused=True)

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Any:
        super()._apply(fn, recurse)
        # A move may replace the parameters.
        self._adam = self._make_adam()
        return self

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
        composited = rgb + (1.0 - alpha)[..., None] * self.cube(viewpoint)
        row = self.embeddings.row(viewpoint)
        table = self.embeddings.table
        if row is None and not len(table):
            return FinishedImage(composited, composited)
        change = self.affine(table.mean(0) if row is None else table[row]).view(3, 4)
        matrix = change + torch.eye(3, 4, device=change.device)
        mapped = composited @ matrix[:, :3].T + matrix[:, 3]
        return FinishedImage(mapped, mapped)

    def losses(self, alpha: Tensor, image: TrainingImage) -> dict[str, tuple[float, Tensor]]:
        """Compute the cross entropy between alpha and the mask of non-sky pixels, where sky masks exist."""
        if image.sky is None or not self.settings.opacity_weight:
            return {}
        solid = (~image.sky).to(alpha.dtype)
        entropy = functional.binary_cross_entropy(alpha.clamp(_LEAST, 1.0 - _LEAST), solid, reduction="none")
        mean = torch.where(image.scored, entropy, 0.0).sum() / image.scored.sum().clamp_min(1)
        return {"opacity": (self.settings.opacity_weight, mean)}
