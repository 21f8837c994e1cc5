"""Colours of Gaussians and processing of rendered images: the part in which the methods differ."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.optim import Optimizer

from hybridworldsim.trainable.training_image import TrainingImage
from hybridworldsim.trainable.viewpoint import Source, Viewpoint


@dataclass(frozen=True, eq=False)
class FinishedImage:
    """A rendered image after its appearance was applied.

    Attributes:
        rgb: (H, W, 3) final colours.
        plain: (H, W, 3) colours for the structure loss.
    """

    rgb: Tensor
    plain: Tensor


class AppearanceModel(nn.Module):
    """Spherical harmonics that all images share: vanilla 3DGS.

    Its parameters do not belong to single Gaussians. Tables with a row for each Gaussian are held by the trainer, for
    densification.

    Args:
        sh_degree: degree of the spherical harmonics.
    """

    def __init__(self, sh_degree: int) -> None:
        super().__init__()
        self.sh_degree = sh_degree

    def tables(self, count: int) -> dict[str, Tensor]:
        """Return the further parameters of `count` Gaussians.

        The part of a name before "_" selects the learning rate.
        """
        return {"shN": torch.zeros(count, (self.sh_degree + 1) ** 2 - 1, 3)}

    def bands(self, source: Source, degree: int) -> list[tuple[str, int, int]]:
        """Return the tables that form a source's spherical harmonics: name, first coefficient, and end of range.

        Args:
            source: traversal and camera of the appearance.
            degree: degree of the spherical harmonics: (degree + 1)^2 coefficients.
        """
        count = (degree + 1) ** 2
        return [("sh0", 0, 1), ("shN", 1, count)] if degree else [("sh0", 0, 1)]

    def optimizers(self) -> list[Optimizer]:
        """Return the optimisers of the parameters that do not belong to single Gaussians."""
        return []

    def update(self, viewpoint: Viewpoint) -> None:
        """Update the model's own parameters by their gradients, and clear the gradients."""

    def prepare(self, viewpoint: Viewpoint, progress: float) -> None:
        """Prepare for training on an image: set the learning rates for a progress from 0 to 1."""

    def finish(self, rgb: Tensor, alpha: Tensor, viewpoint: Viewpoint) -> FinishedImage:
        """Compute the final colours of an image.

        Args:
            rgb: (H, W, 3) as rasterized, over black.
            alpha: (H, W).
            viewpoint: camera of the image.
        """
        return FinishedImage(rgb, rgb)

    def losses(self, alpha: Tensor, image: TrainingImage) -> dict[str, tuple[float, Tensor]]:
        """Return the further losses: weight and value by name."""
        return {}
