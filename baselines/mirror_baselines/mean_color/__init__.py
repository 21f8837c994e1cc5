"""A floor below the floor: each view is one colour, the mean of its camera's training pictures."""

from __future__ import annotations

from mirror_baselines.mean_color.mean import MOST_PICTURES, mean_colour, render
from mirror_baselines.mean_color.submission import APPEARANCE, METHOD

__all__ = ["APPEARANCE", "METHOD", "MOST_PICTURES", "mean_colour", "render"]
