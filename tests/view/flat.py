"""A renderer of one colour, for the tests of the viewer of a street."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mirror.arrays import UInt8
from mirror.methods.interactive import TrainedAppearance
from mirror.protocols.views.view import RenderView

DAY, NIGHT = "a.d0.1700000000000", "a.d1.1700086400000"
COLOURS = {DAY: (230.0, 60.0, 20.0), NIGHT: (20.0, 40.0, 220.0)}


class Flat:
    """Renders one colour: that of the mixture of appearances, brighter to the left of the driven line."""

    appearances = (TrainedAppearance(NIGHT, "night", "clear"), TrainedAppearance(DAY, "day", "clear"))

    def __init__(self) -> None:
        self.views: list[tuple[RenderView, bool]] = []

    def render(self, view: RenderView, weights: Mapping[str, float], *, moving: bool) -> UInt8:
        self.views.append((view, moving))
        colour = sum(weight * np.array(COLOURS[name]) for name, weight in weights.items())
        return np.broadcast_to(colour, (view.height_px, view.width_px, 3)).astype(np.uint8)
