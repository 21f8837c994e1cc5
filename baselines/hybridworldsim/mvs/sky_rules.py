"""The thresholds that tell the sky from other parts of an image, in `hybridworldsim.mvs.sky` and in its plain form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class SkyRules:
    """The thresholds; colours are CIE Lab in the 8-bit levels of OpenCV (L from 0 to 255, a and b + 128).

    Attributes:
        min_rise: least upward component of a pixel's unit ray.
        max_deviation: greatest standard deviation of L in a smooth window of 3 x 3 px.
        min_part_px: least size of a smooth part.
        min_blue: how far b of a dark sky lies below grey, at least.
        blue_weight: weight of blue beside L in the choice of the best part.
        lightness_quantile: quantile of the image's L below which a sky is dark.
        colour_distance_share: greatest colour distance within one sky, as a share of its L above `dark_lightness`.
        dark_lightness: see `colour_distance_share`.
        colour_distances: least and greatest value of that distance.
        neutral: the b of grey.
    """

    min_rise: float = 0.03
    max_deviation: float = 2.0
    min_part_px: int = 12
    min_blue: float = 4.0
    blue_weight: float = 6.0
    lightness_quantile: float = 0.6
    colour_distance_share: float = 0.2
    dark_lightness: float = 20.0
    colour_distances: tuple[float, float] = (3.0, 22.0)
    neutral: float = 128.0


RULES: Final = SkyRules()
"""The rules that are used."""
