"""The lowest floor: each view is one colour, the mean of its camera's training images."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mirror.lazy import lazy_names

if TYPE_CHECKING:
    from mirror_baselines.mean_color.mean import MAX_IMAGES as MAX_IMAGES
    from mirror_baselines.mean_color.mean import mean_colour as mean_colour
    from mirror_baselines.mean_color.mean import render as render
    from mirror_baselines.mean_color.submission import APPEARANCE as APPEARANCE
    from mirror_baselines.mean_color.submission import METHOD as METHOD

__all__ = ["APPEARANCE", "MAX_IMAGES", "METHOD", "mean_colour", "render"]

_MEAN = dict.fromkeys(("MAX_IMAGES", "mean_colour", "render"), "mirror_baselines.mean_color.mean")
_SUBMISSION = dict.fromkeys(("APPEARANCE", "METHOD"), "mirror_baselines.mean_color.submission")
__getattr__, __dir__ = lazy_names(__name__, _MEAN | _SUBMISSION)
