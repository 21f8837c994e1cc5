"""A floor below the floor: each view is one colour, the mean of its camera's training pictures."""

from __future__ import annotations

from mean_color.mean import MOST_PICTURES, mean_colour, render
from mean_color.submission import APPEARANCE, METHOD

__all__ = ["APPEARANCE", "METHOD", "MOST_PICTURES", "mean_colour", "render"]
