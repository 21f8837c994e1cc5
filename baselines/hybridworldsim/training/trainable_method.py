"""What a method of static reconstruction is to the training loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor, nn

from hybridworldsim.training.training_image import TrainingImage
from hybridworldsim.training.viewpoint import Viewpoint


@dataclass(frozen=True, eq=False)
class Rendering:
    """An image that a model renders.

    Attributes:
        rgb: (H, W, 3) float32.
        alpha: (H, W).
        depth_m: (H, W) expected camera z: the mean of what is seen, weighted as colours are.
        counts: of Gaussians and anchors: held, decoded, drawn.
    """

    rgb: Tensor
    alpha: Tensor
    depth_m: Tensor
    counts: Mapping[str, int]


@dataclass(frozen=True)
class StepReport:
    """What a step tells.

    Attributes:
        losses: by name, unweighted; ``rgb`` is the mean square error of scored pixels.
        gaussians: held by the model.
    """

    losses: Mapping[str, float]
    gaussians: int


class TrainableMethod(Protocol):
    """A model with its optimisers: one a method."""

    @property
    def model(self) -> nn.Module:
        """What is learnt: its parameters are all that rendering needs."""
        ...

    @property
    def reads_depth(self) -> bool:
        """Whether it learns from depth maps: they are not read otherwise."""
        ...

    def step(self, image: TrainingImage, progress: float) -> StepReport:
        """Learn from one image.

        Args:
            image: what was taken.
            progress: from 0 to 1, for the schedules.
        """
        ...

    def render(self, viewpoint: Viewpoint) -> Rendering:
        """Render without gradients; the appearance is that of the viewpoint's source, which was trained on."""
        ...

    def state(self) -> dict[str, Tensor]:
        """All that training needs to go on exactly: parameters, moments, statistics, generators."""
        ...

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """The opposite of `state`."""
        ...
