"""The boxes that an annotator found in one frame, checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.errors import MirrorError
from mirror.geometry.poses import Poses


class AnnotationError(MirrorError):
    """An annotator gave no valid result for a frame."""


@dataclass(frozen=True, eq=False)
class Detections:
    """N boxes in the ego frame at one time.

    Attributes:
        timestamp_ns: time of the boxes, Unix.
        ego_SE3_box: N poses; the origin is the middle of the box, x along its length.
        size_m: (N, 3) length, width, height, above 0.
        velocity_mps: (N, 3) velocity over ground along the ego axes; NaN where unknown.
        category: N class names.
        score: (N,) confidence from 0 to 1; NaN for a label made by a person.
        track_id: N object ids; empty: the annotator does not track.
        unfamiliar: whether the images do not look like those that the annotator was trained on.

    Raises:
        AnnotationError: shapes do not fit, or a number is invalid; its row is named.
    """

    timestamp_ns: int
    ego_SE3_box: Poses
    size_m: Float64
    velocity_mps: Float64
    category: tuple[str, ...]
    score: Float64
    track_id: tuple[str, ...] = ()
    unfamiliar: bool = False

    def __post_init__(self) -> None:
        count = len(self.ego_SE3_box)
        shapes = {"size_m": (count, 3), "velocity_mps": (count, 3), "score": (count,)}
        for name, shape in shapes.items():
            values = np.asarray(getattr(self, name), np.float64)
            if values.size == 0 and count == 0:
                values = values.reshape(shape)
            if values.shape != shape:
                raise AnnotationError(f"{name} of shape {values.shape}", expected=f"{shape}")
            object.__setattr__(self, name, values)
        if len(self.category) != count or len(self.track_id) not in (0, count):
            raise AnnotationError(
                f"{count} boxes with {len(self.category)} categories and {len(self.track_id)} track ids",
                expected="one category for each box, and one track id for each box or none",
            )
        _require(((self.size_m > 0.0) & np.isfinite(self.size_m)).all(axis=1), "size_m", self.size_m, "above 0, finite")
        _require(~np.isinf(self.velocity_mps).any(axis=1), "velocity_mps", self.velocity_mps, "finite, or unknown")
        valid = np.isnan(self.score) | ((self.score >= 0.0) & (self.score <= 1.0))
        _require(valid, "score", self.score, "0 to 1, or none")
        _require(np.array([bool(name) for name in self.category], np.bool_), "category", self.category, "a name")

    @classmethod
    def empty(cls, timestamp_ns: int) -> Detections:
        """Make an empty set of boxes."""
        nothing = np.empty((0, 3))
        return cls(timestamp_ns, Poses.unchecked(np.empty((0, 4)), nothing), nothing, nothing, (), np.empty(0))

    @classmethod
    def from_arrays(
        cls,
        timestamp_ns: int,
        centre_m: Float64,
        rotation: Float64,
        size_m: Float64,
        velocity_mps: Float64,
        category: Sequence[str],
        score: Float64,
        track_id: Sequence[str] = (),
    ) -> Detections:
        """Make boxes from arrays: centres (N, 3) and unit quaternions (N, 4), scalar first.

        Raises:
            AnnotationError: a number is not finite or out of range; its row is named.
        """
        centre_m, rotation = np.asarray(centre_m, np.float64), np.asarray(rotation, np.float64)
        if not len(centre_m):
            return cls.empty(timestamp_ns)
        _require(np.isfinite(centre_m).all(axis=1), "centre_m", centre_m, "finite")
        norm = np.linalg.norm(rotation, axis=1)
        _require(np.isfinite(norm) & (norm > 1e-6), "rotation", rotation, "a quaternion that is not zero")
        pose = Poses(rotation, centre_m)
        return cls(timestamp_ns, pose, size_m, velocity_mps, tuple(category), score, tuple(track_id))

    def __len__(self) -> int:
        return len(self.category)

    def __getitem__(self, rows: Any) -> Detections:
        chosen = np.arange(len(self))[rows]
        return Detections(
            self.timestamp_ns,
            self.ego_SE3_box[chosen],
            self.size_m[chosen],
            self.velocity_mps[chosen],
            tuple(self.category[row] for row in chosen),
            self.score[chosen],
            tuple(self.track_id[row] for row in chosen) if self.track_id else (),
        )

    def to_rows(self) -> list[dict[str, Any]]:
        """Return the boxes as JSON values: the columns of the ``boxes`` table without times and source."""
        columns: Mapping[str, Any] = {
            "track_id": self.track_id or [None] * len(self),
            "category": self.category,
            **self.ego_SE3_box.to_columns(),
            **dict(zip(("length_m", "width_m", "height_m"), self.size_m.T)),
            **dict(zip(("vx_mps", "vy_mps", "vz_mps"), self.velocity_mps.T)),
            "score": self.score,
        }
        return [{name: _value(values[row]) for name, values in columns.items()} for row in range(len(self))]


def _value(value: Any) -> Any:
    if isinstance(value, float):
        return None if np.isnan(value) else float(value)
    return value


def _require(valid: Bool | np.bool_, name: str, values: Any, expected: str) -> None:
    if not np.all(valid):
        row = int(np.argmin(valid))
        value = values[row]
        text = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
        raise AnnotationError(f"{name} {text} of a box", place=f"box {row}", expected=expected)
