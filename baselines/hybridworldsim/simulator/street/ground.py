"""The ground under road users: its height, and the attitude of a vehicle that stands on it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float64
from mirror.geometry import Poses, quaternion_from_heading_pitch_roll
from mirror.traffic.placement.motion import Placement

HeightField = Callable[[npt.ArrayLike, npt.ArrayLike], Float64]
_NEIGHBOURS = 6
_SOFTENING_M = 1.0


@dataclass(frozen=True, eq=False)
class StreetGround:
    """The ground of a street.

    Attributes:
        height_m: heights (N,) at positions x (N,) and y (N,).
    """

    height_m: HeightField

    def place(self, x_m: float, y_m: float, yaw_rad: float, base_m: float, track_m: float) -> Placement:
        """Return the placement of one body on the ground; see `places`."""
        return self.places(*(np.array([value]) for value in (x_m, y_m, yaw_rad, base_m, track_m)))[0]

    def places(
        self, x_m: Float64, y_m: Float64, yaw_rad: Float64, base_m: Float64, track_m: Float64
    ) -> list[Placement]:
        """Return the placements of N bodies on the ground; all heights are read at once.

        Args:
            x_m: (N,) positions of their middles.
            y_m: (N,) positions of their middles.
            yaw_rad: (N,) headings.
            base_m: (N,) distances of the points along the heading at which they touch the ground.
            track_m: (N,) distances of these points across the heading.
        """
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        along, aside = 0.5 * base_m, 0.5 * track_m
        x = np.stack([x_m + along * cos, x_m - along * cos, x_m - aside * sin, x_m + aside * sin, x_m])
        y = np.stack([y_m + along * sin, y_m - along * sin, y_m + aside * cos, y_m - aside * cos, y_m])
        heights = np.asarray(self.height_m(x.ravel(), y.ravel())).reshape(5, -1)
        front, rear, left, right, middle = heights
        pitch, roll = np.arctan2(front - rear, base_m), np.arctan2(left - right, track_m)
        return [Placement(*row) for row in np.column_stack([x_m, y_m, middle, yaw_rad, pitch, roll]).tolist()]

    def world_SE3_ego(  # noqa: N802
        self, x_m: float, y_m: float, yaw_rad: float, wheelbase_m: float, track_m: float
    ) -> Poses:
        """Return the pose of the ego frame, whose origin is on the ground below the rear axle."""
        reach = 0.5 * wheelbase_m
        middle = self.place(
            x_m + reach * math.cos(yaw_rad), y_m + reach * math.sin(yaw_rad), yaw_rad, wheelbase_m, track_m
        )
        height = float(np.asarray(self.height_m(np.array([x_m]), np.array([y_m])))[0])
        rotation = quaternion_from_heading_pitch_roll(
            np.array([90.0 - math.degrees(yaw_rad)]),
            np.array([math.degrees(middle.pitch_rad)]),
            np.array([math.degrees(middle.roll_rad)]),
        )
        return Poses(rotation, np.array([[x_m, y_m, height]]))


def ground_of_points(points_m: Float64) -> StreetGround:
    """Return the ground surface through points (N, 3), weighted by the inverse square of their distances."""
    from scipy.spatial import cKDTree

    tree, heights = cKDTree(points_m[:, :2]), points_m[:, 2]
    count = min(_NEIGHBOURS, len(points_m))

    def height_m(x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> Float64:
        distance, nearest = tree.query(np.column_stack([np.ravel(x_m), np.ravel(y_m)]), k=count)
        distance, nearest = distance.reshape(-1, count), nearest.reshape(-1, count)
        weight = 1.0 / (distance**2 + _SOFTENING_M**2)
        mean: Float64 = (weight * heights[nearest]).sum(axis=1) / weight.sum(axis=1)
        return mean

    return StreetGround(height_m)
