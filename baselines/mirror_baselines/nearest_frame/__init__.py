"""The floor of every benchmark: each view is shown the nearest training picture of its camera, as it was taken."""

from __future__ import annotations

from mirror_baselines.nearest_frame.matching import METRES_A_RADIAN, nearest, render
from mirror_baselines.nearest_frame.submission import APPEARANCE, METHOD

__all__ = ["APPEARANCE", "METHOD", "METRES_A_RADIAN", "nearest", "render"]
