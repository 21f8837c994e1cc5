"""Options of tracking, and the groups of categories that are tracked together."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Final

from mirror.errors import UsageError

_GROUPS: Final = {
    "pedestrian": ("pedestrian", "person", "walker"),
    "two_wheeler": ("bicycle", "motorcycle", "cyclist", "motorcyclist", "scooter"),
    "static": ("barrier", "traffic_cone"),
}
ACCELERATION_MPS2: Final = {"vehicle": 1.2, "two_wheeler": 1.2, "pedestrian": 0.5, "static": 0.01}
"""Process noise of the motion models, by group: square root of the spectral density of the acceleration, which does not
depend on the frame rate; m/s2 per root hertz."""


def group_of(category: str) -> str:
    """Return the group of a category: pedestrian, two_wheeler, static, or else vehicle.

    Annotators confuse categories of one group, so boxes are matched within groups; a track has the category of most of
    its boxes, weighted by score.
    """
    return next((group for group, names in _GROUPS.items() if category.lower() in names), "vehicle")


@dataclass(frozen=True)
class BoxTrackingOptions:
    """Settings of the tracker of image features.

    Attributes:
        sigma_m: standard deviation of a box's position at range 0.
        sigma_share: its growth, as a share of the distance from the vehicle.
        gate_m: a box farther than this from a track's predicted position is never matched.
        gate_sigmas: a box farther than this in standard deviations of the prediction is never matched.
        max_gap_s: a track without a box for longer ends.
        min_boxes: a track with fewer boxes is dropped.
        min_score: a track whose score is lower is dropped; see `mirror.annotation.tracking.tracker.track_score`.
        birth_score: a box with a lower score begins no track, but may continue one.
        fill_gaps_s: gaps of a track up to this length get interpolated boxes; 0: none.
        turn_model: smooth moving vehicles with a model of constant turn rate; False: of constant velocity.

    Raises:
        UsageError: a number is out of range.
    """

    sigma_m: float = 0.25
    sigma_share: float = 0.02
    gate_m: float = 4.0
    gate_sigmas: float = 4.0
    max_gap_s: float = 2.0
    min_boxes: int = 3
    min_score: float = 0.1
    birth_score: float = 0.05
    fill_gaps_s: float = 1.5
    turn_model: bool = True

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            positive = field.name in ("sigma_m", "gate_m", "gate_sigmas", "max_gap_s", "min_boxes")
            if not (math.isfinite(value) and (value > 0.0 if positive else value >= 0.0)):
                place = f"--{field.name.replace('_', '-')}"
                raise UsageError(
                    f"{value}", place=place,
                    expected=f"a finite number, {'more than 0' if positive else 'at least 0'}",
                    remedy=f"give another number with {place}",
                )  # fmt: skip


TrackingOptions = BoxTrackingOptions
"""The name of `BoxTrackingOptions` in version 0.1; it stays importable."""
