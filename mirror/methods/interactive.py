"""Renderers that move through a scene: what `mirror view` asks for, and what any other method gives it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from mirror.arrays import UInt8
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
    """A renderer of views from any place, in mixtures of the trained appearances."""

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


class InteractiveMethod(Protocol):
    """A method with an interactive renderer of its own: the capability `opens_interactively`."""

    def open_interactive(self, model: Path) -> InteractiveRenderer:
        """Open a trained model."""
        ...


class InteractiveDeviceMethod(Protocol):
    """An `InteractiveMethod` with the capability `takes_device`."""

    def open_interactive(self, model: Path, *, device: str = ...) -> InteractiveRenderer:
        """Open a trained model to render on a device, such as ``cpu`` or ``cuda:0``."""
        ...


@dataclass(frozen=True)
class PlainRenderer:
    """The renderer for methods without an interactive one: each image has one trained appearance, never a mixture.

    Attributes:
        appearances: the trained appearances, in order of traversals.
        renderer: the method's renderer.
    """

    appearances: tuple[TrainedAppearance, ...]
    renderer: Callable[[RenderView], UInt8]

    def render(self, view: RenderView, weights: Mapping[str, float], *, moving: bool) -> UInt8:
        """Render a view in the appearance with the greatest weight; see `InteractiveRenderer.render`."""
        chosen = max(self.appearances, key=lambda one: weights.get(one.traversal_id, 0.0))
        of_it = {"traversal_id": chosen.traversal_id, "light": chosen.light, "weather": chosen.weather}
        return self.renderer(view.model_copy(update=of_it))
