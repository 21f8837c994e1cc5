"""The floor of every benchmark: each view shows the nearest recorded training image of its camera."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mirror.lazy import lazy_names

if TYPE_CHECKING:
    from mirror_baselines.nearest_frame.matching import METRES_PER_RADIAN as METRES_PER_RADIAN
    from mirror_baselines.nearest_frame.matching import find_nearest as find_nearest
    from mirror_baselines.nearest_frame.matching import render as render
    from mirror_baselines.nearest_frame.submission import APPEARANCE as APPEARANCE
    from mirror_baselines.nearest_frame.submission import METHOD as METHOD

__all__ = ["APPEARANCE", "METHOD", "METRES_PER_RADIAN", "find_nearest", "render"]

_MATCHING = dict.fromkeys(("METRES_PER_RADIAN", "find_nearest", "render"), "mirror_baselines.nearest_frame.matching")
_SUBMISSION = dict.fromkeys(("APPEARANCE", "METHOD"), "mirror_baselines.nearest_frame.submission")
__getattr__, __dir__ = lazy_names(__name__, _MATCHING | _SUBMISSION)
