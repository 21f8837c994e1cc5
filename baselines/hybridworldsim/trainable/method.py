"""The interface between a method of static reconstruction and the training loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from torch import Tensor, nn

from hybridworldsim.trainable.training_image import TrainingImage
from hybridworldsim.trainable.viewpoint import Viewpoint
from mirror.arrays import Float32


@dataclass(frozen=True, eq=False)
class Rendering:
    """An image that a model renders.

    Attributes:
        rgb: (H, W, 3) float32.
        alpha: (H, W).
        depth_m: (H, W) expected camera z: the mean over the Gaussians of a pixel, weighted as colours are.
        counts: numbers of Gaussians and anchors that are held, decoded and drawn.
    """

    rgb: Tensor
    alpha: Tensor
    depth_m: Tensor
    counts: Mapping[str, int]


@dataclass(frozen=True)
class StepReport:
    """The result of a step.

    Attributes:
        losses: unweighted losses by name; ``rgb`` is the mean square error of the scored pixels.
        gaussians: number of Gaussians of the model.
    """

    losses: Mapping[str, float]
    gaussians: int


class RenderableModel(Protocol):
    """A model that renders the appearances that it was trained on."""

    @property
    def model(self) -> nn.Module:
        """The trained module; its parameters are all that rendering needs."""
        ...

    def render(self, viewpoint: Viewpoint) -> Rendering:
        """Render without gradients, in the appearance of the viewpoint's source, which must be a training source."""
        ...


class TrainableMethod(RenderableModel, Protocol):
    """A model with its optimisers."""

    @property
    def reads_depth(self) -> bool:
        """Return whether the method learns from depth maps; if not, no depth maps are read."""
        ...

    def step(self, image: TrainingImage, progress: float) -> StepReport:
        """Train on one image.

        Args:
            image: the training image.
            progress: from 0 to 1, for the schedules.
        """
        ...

    def state(self) -> dict[str, Tensor]:
        """Return everything that training needs to continue exactly, such as parameters, moments and generators."""
        ...

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `state` returned."""
        ...


@runtime_checkable
class MovableMethod(TrainableMethod, Protocol):
    """A `TrainableMethod` that computes on any device, as the capability `takes_device` states."""

    def to(self, device: str) -> TrainableMethod:
        """Return the untrained model on a device, named as in torch, with its optimisers made there."""
        ...


class CoverRenderableModel(RenderableModel, Protocol):
    """A model that also renders what covers each pixel before given depths: the capability `renders_covers`."""

    def render_covers(self, viewpoint: Viewpoint, limit_m: Float32) -> tuple[Rendering, Tensor]:
        """Render as `render` does, and return the share (H, W) of each pixel that Gaussians nearer than a depth cover.

        Args:
            viewpoint: the camera, with a training source.
            limit_m: (H, W) depth (camera z) of each pixel; 0 or less: nothing is before it.
        """
        ...
