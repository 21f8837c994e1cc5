"""Settings of `mirror poses`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mirror.errors import UsageError

ScaleSource = Literal["track", "rig", "height", "length"]


@dataclass(frozen=True)
class StructureOptions:
    """Settings of structure from motion.

    Attributes:
        camera: camera whose images are registered; None: the reference camera of the rig.
        lens: YAML file of its lens; None: that of the recording, else it is estimated.
        scale: where scale and world frame come from; None: the first that the recording has, in the order of
            `ScaleSource`.
        camera_height_m: height of the camera above the road; None: that of its recorded mounting.
        length_m: length of the way between the first and the last image; None: not known.
        masks: folder of masks of road users, ``CAMERA/TIMESTAMP_NS.png``; None: there are none.
        motion_percent: median motion of the image after which the next one is used, percent of its width.
        longest_step_s: an image is used after this time even if nothing moves.
        features: largest number of features of an image.
        neighbours: number of following images that an image is matched with.
        longest_gap_s: a drive is cut where no image is registered for longer.
        least_images: smallest number of images of a part of a drive.
        least_share: smallest share of the used images that must be registered.
    """

    camera: str | None = None
    lens: Path | None = None
    scale: ScaleSource | None = None
    camera_height_m: float | None = None
    length_m: float | None = None
    masks: Path | None = None
    motion_percent: float = 1.0
    longest_step_s: float = 0.5
    features: int = 2500
    neighbours: int = 10
    longest_gap_s: float = 2.0
    least_images: int = 8
    least_share: float = 0.5

    def __post_init__(self) -> None:
        for name in ("camera_height_m", "length_m", "motion_percent", "longest_step_s", "longest_gap_s"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise UsageError(f"{value}", place=f"--{name.replace('_', '-')}", expected="a finite number above 0")
        for name, least in (("features", 100), ("neighbours", 2), ("least_images", 3)):
            if getattr(self, name) < least:
                place = f"--{name.replace('_', '-')}"
                raise UsageError(f"{getattr(self, name)}", place=place, expected=f"at least {least}")
        if not 0.0 < self.least_share <= 1.0:
            raise UsageError(f"{self.least_share}", place="--least-share", expected="a share above 0, at most 1")
