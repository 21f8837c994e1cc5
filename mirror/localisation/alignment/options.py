"""Settings of `mirror align`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mirror.errors import UsageError


@dataclass(frozen=True)
class AlignmentOptions:
    """Settings of the alignment of passes.

    Attributes:
        cameras: cameras whose images are used; empty: the reference camera of each rig.
        step_m: distance between the used images of a pass.
        radius_m: distance between images of two passes up to which they are matched: twice the error of a position.
        angle_deg: angle between their directions up to which they are matched.
        neighbours: number of following images of its own pass that an image is matched with.
        partners: number of images of each other pass that an image is matched with.
        features: largest number of features of an image.
        least_share: smallest share of a pass' images that must be registered.
        least_shared: smallest number of points that a pass must share with others.
    """

    cameras: tuple[str, ...] = ()
    step_m: float = 2.0
    radius_m: float = 12.0
    angle_deg: float = 35.0
    neighbours: int = 4
    partners: int = 3
    features: int = 1500
    least_share: float = 0.5
    least_shared: int = 60

    def __post_init__(self) -> None:
        for name in ("step_m", "radius_m", "angle_deg"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise UsageError(f"{value}", place=f"--{name.replace('_', '-')}", expected="a finite number above 0")
        for name, least in (("neighbours", 1), ("partners", 1), ("features", 100), ("least_shared", 10)):
            if getattr(self, name) < least:
                place = f"--{name.replace('_', '-')}"
                raise UsageError(f"{getattr(self, name)}", place=place, expected=f"at least {least}")
        if not 0.0 < self.least_share <= 1.0:
            raise UsageError(f"{self.least_share}", place="--least-share", expected="a share above 0, at most 1")
