"""Renderers that move through a scene: what `mirror view` asks for, and what any other method gives it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from mirror.arrays import UInt8
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.hosting import checked_renderer
from mirror.methods.plugin import InstalledMethod
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
    """A method with an interactive renderer of its own."""

    def open_interactive(self, model: Path) -> InteractiveRenderer:
        """Open a trained model."""
        ...


@dataclass(frozen=True)
class PlainRenderer:
    """The renderer of a method without an interactive one: each image has one trained appearance, none is a mixture.

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


def open_interactive(
    name: str, method: InstalledMethod, model: Path, appearances: Sequence[TrainedAppearance]
) -> InteractiveRenderer:
    """Open a trained model to move through it.

    Args:
        name: name of the method, for messages.
        method: the method.
        model: folder of the model.
        appearances: the trained traversals, for a method that has no `open_interactive`.
    """
    if isinstance(method, InteractiveMethod):
        return method.open_interactive(model)
    return PlainRenderer(tuple(appearances), checked_renderer(name, method.open(model, AppearancePolicy())))
