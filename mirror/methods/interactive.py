"""The interface of methods that render fast enough to move through a scene: what `mirror view` asks for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from mirror.arrays import UInt8
from mirror.errors import UsageError
from mirror.methods.registry import installed_method
from mirror.protocols.views.view import RenderView


@dataclass(frozen=True)
class TrainedAppearance:
    """One appearance that a model has learned.

    Attributes:
        traversal_id: the traversal.
        light: its light.
        weather: its weather.
    """

    traversal_id: str
    light: str
    weather: str


class InteractiveRenderer(Protocol):
    """Renders views from any place, in mixtures of the trained appearances."""

    @property
    def appearances(self) -> tuple[TrainedAppearance, ...]:
        """The trained appearances, in order of traversals."""
        ...

    def render(self, view: RenderView, weights: Mapping[str, float], *, moving: bool) -> UInt8:
        """Render a view.

        Args:
            view: a pinhole view.
            weights: weight of each appearance by traversal; they sum to one.
            moving: whether the camera is moving: parts that change little from image to image may be taken from an
                earlier one.

        Returns:
            Pixels (H, W, 3), RGB.
        """
        ...


@runtime_checkable
class InteractiveMethod(Protocol):
    """An installed method with an interactive renderer."""

    def open_interactive(self, model: Path) -> InteractiveRenderer:
        """Open a trained model."""
        ...


def find_interactive(name: str) -> InteractiveMethod:
    """Find an installed method with an interactive renderer.

    Raises:
        UsageError: no method of that name is installed, or it has no function `open_interactive`.
    """
    method = installed_method(name)
    if not isinstance(method, InteractiveMethod):
        raise UsageError(
            f"method {name} has no interactive renderer", expected="a method with a function `open_interactive`",
            remedy="render a video: mirror render DATASET MODEL --trajectory recorded",
        )  # fmt: skip
    return method
