"""How Gaussians get colours, and what is done to an image of them: the part in which the methods differ."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.optim import Optimizer

from hybridworldsim.training.training_image import TrainingImage
from hybridworldsim.training.viewpoint import Source, Viewpoint


@dataclass(frozen=True, eq=False)
class FinishedImage:
    """An image as it is compared.

    Attributes:
        rgb: (H, W, 3).
        plain: (H, W, 3) for the structural loss.
    """

    rgb: Tensor
    plain: Tensor


class AppearanceModel(nn.Module):
    """Spherical harmonics, the same in all images: vanilla 3DGS.

    Its parameters are those that belong to no Gaussian; tables with a row a Gaussian are held by the learner, for
    densification.

    Args:
        sh_degree: of colours.
    """

    def __init__(self, sh_degree: int) -> None:
        super().__init__()
        self.sh_degree = sh_degree

    def tables(self, count: int) -> dict[str, Tensor]:
        """Further parameters of so many Gaussians; what is before "_" in a name says whose learning rate it has."""
        return {"shN": torch.zeros(count, (self.sh_degree + 1) ** 2 - 1, 3)}

    def bands(self, source: Source, degree: int) -> list[tuple[str, int, int]]:
        """Of which tables a source's spherical harmonics are the sum: name, first band coefficient, and the one past.

        Args:
            source: whose appearance.
            degree: of the harmonics: (degree + 1)^2 coefficients.
        """
        count = (degree + 1) ** 2
        return [("sh0", 0, 1), ("shN", 1, count)] if degree else [("sh0", 0, 1)]

    def optimizers(self) -> list[Optimizer]:
        """Of the parameters that belong to no Gaussian."""
        return []

    def update(self, viewpoint: Viewpoint) -> None:
        """Take a step with the gradients of these parameters, which then are none."""

    def prepare(self, viewpoint: Viewpoint, progress: float) -> None:
        """An image from here is about to be learnt from; learning rates are to be those of progress, from 0 to 1."""

    def finish(self, rgb: Tensor, alpha: Tensor, viewpoint: Viewpoint) -> FinishedImage:
        """What the image becomes.

        Args:
            rgb: (H, W, 3) as rasterized, over black.
            alpha: (H, W).
            viewpoint: the camera.
        """
        return FinishedImage(rgb, rgb)

    def losses(self, alpha: Tensor, image: TrainingImage) -> dict[str, tuple[float, Tensor]]:
        """Further losses: weight and value by name."""
        return {}
