"""Boxes that a detector found, or that are true: one row each, of many samples together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from mirror.arrays import AnyArray, Bool, Float64
from mirror.errors import UsageError
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import matrix_from_quaternion
from mirror.metrics.detection.config import DetectionConfig
from mirror.metrics.inputs import Numbers, as_numbers, require_rows


@dataclass(frozen=True, eq=False)
class DetectionBoxes:
    """N boxes in a frame whose z points up.

    Attributes:
        sample: (N,) which sample (a rig's frame) each belongs to: strings or integers.
        category: (N,) strings.
        centre_m: (N, 3).
        lwh_m: (N, 3) length, width, height, above 0.
        yaw_rad: (N,) heading about z.
        velocity_mps: (N, 2) along x and y; NaN: not known.
        attribute: (N,) strings; empty: none.
        score: (N,) confidence of predictions, not negative; zeros for true boxes.

    Raises:
        UsageError: shapes do not fit, or a number is not what stands above; its row is named.
    """

    sample: AnyArray
    category: AnyArray
    centre_m: Float64
    lwh_m: Float64
    yaw_rad: Float64
    velocity_mps: Float64
    attribute: AnyArray
    score: Float64

    def __post_init__(self) -> None:
        count = len(np.atleast_1d(self.sample))
        shapes = {
            "centre_m": (count, 3),
            "lwh_m": (count, 3),
            "yaw_rad": (count,),
            "velocity_mps": (count, 2),
            "score": (count,),
        }
        for part in fields(self):
            shape = shapes.get(part.name)
            given = getattr(self, part.name)
            values = np.asarray(given) if shape is None else as_numbers(given, part.name, np.float64)
            if shape is not None and values.size == 0:
                values = values.reshape(shape if count == 0 else values.shape)
            if values.shape != (shape or (count,)):
                raise UsageError(f"{part.name} of shape {values.shape}", expected=f"{shape or (count,)}")
            object.__setattr__(self, part.name, np.ascontiguousarray(values))
        require_rows(np.isfinite(self.centre_m).all(axis=1), "centre_m", self.centre_m, "finite numbers")
        positive = (self.lwh_m > 0.0) & np.isfinite(self.lwh_m)
        require_rows(positive.all(axis=1), "lwh_m", self.lwh_m, "finite numbers above 0")
        require_rows(np.isfinite(self.yaw_rad), "yaw_rad", self.yaw_rad, "a finite number")
        require_rows(
            ~np.isinf(self.velocity_mps).any(axis=1), "velocity_mps", self.velocity_mps, "finite numbers, or NaN"
        )
        require_rows(
            (self.score >= 0.0) & np.isfinite(self.score), "score", self.score, "a finite number, not negative"
        )

    @classmethod
    def from_poses(
        cls,
        sample: AnyArray | Sequence[Any],
        category: AnyArray | Sequence[str],
        poses: Poses,
        lwh_m: Numbers,
        *,
        velocity_mps: Numbers | None = None,
        attribute: AnyArray | Sequence[str] | None = None,
        score: Numbers | None = None,
    ) -> DetectionBoxes:
        """Make boxes from their poses; attributes that are not given are unknown.

        Args:
            sample: (N,).
            category: (N,).
            poses: N poses ``dst_SE3_box`` in a frame whose z points up.
            lwh_m: (N, 3).
            velocity_mps: (N, 2).
            attribute: (N,).
            score: (N,).

        Raises:
            UsageError: as `DetectionBoxes`.
        """
        forward = matrix_from_quaternion(poses.rotation)[..., 0]
        return cls(
            np.asarray(sample),
            np.asarray(category),
            poses.translation,
            as_numbers(lwh_m, "lwh_m", np.float64),
            np.arctan2(forward[:, 1], forward[:, 0]),
            np.full((len(poses), 2), np.nan) if velocity_mps is None else as_numbers(velocity_mps, "velocity_mps"),
            np.full(len(poses), "") if attribute is None else np.asarray(attribute),
            np.zeros(len(poses)) if score is None else as_numbers(score, "score"),
        )

    def __len__(self) -> int:
        return len(self.score)

    def __getitem__(self, rows: slice | AnyArray) -> DetectionBoxes:
        return DetectionBoxes(*(getattr(self, part.name)[rows] for part in fields(self)))

    @classmethod
    def concatenate(cls, parts: Sequence[DetectionBoxes]) -> DetectionBoxes:
        """Concatenate several sets of boxes, in order."""
        return cls(*(np.concatenate([getattr(one, part.name) for one in parts]) for part in fields(cls)))


def in_range(boxes: DetectionBoxes, ego_xy_m: Numbers, config: DetectionConfig) -> Bool:
    """Mark the boxes to judge: nearer to the ego vehicle than the range of their class.

    Apply it to true and predicted boxes alike. The development kit also leaves out true boxes without a lidar or radar
    point, and two-wheelers in bicycle racks: ``boxes[in_range(...) & (points != 0)]``.

    Args:
        boxes: N boxes.
        ego_xy_m: (N, 2) or (2,): where the ego vehicle is, in the boxes' frame.
        config: the ranges.

    Returns:
        (N,).

    Raises:
        UsageError: a category has no range; its row is named.
    """
    away = boxes.centre_m[:, :2] - as_numbers(ego_xy_m, "ego_xy_m", np.float64)
    limit = np.array(list(config.class_range.values()), dtype=np.float64)[category_codes(boxes, config)]
    return np.asarray(np.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2) < limit)


def category_codes(boxes: DetectionBoxes, config: DetectionConfig) -> AnyArray:
    """Return each box's index (N,) among the classes.

    Raises:
        UsageError: a category is not among them; its row is named.
    """
    codes = np.full(len(boxes), -1, dtype=np.int64)
    for code, name in enumerate(config.class_range):
        codes[boxes.category == name] = code
    require_rows(codes >= 0, "category", boxes.category, " | ".join(config.class_range))
    return codes
