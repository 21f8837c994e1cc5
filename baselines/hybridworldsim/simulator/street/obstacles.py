"""Where an agent cannot start: in a wall, or off the drivable area."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from hybridworldsim.simulator.street.street import Street
from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.metrics.safety import inside_area

if TYPE_CHECKING:
    from mirror.synth import Model, SynthDrive

_ABOVE_M: Final = 80.0
_TOLERANCE_M: Final = 0.5
_ON_FOOT: Final = frozenset({"pedestrian", "cyclist", "bicycle"})
_HOLLOW_M: Final = 0.4


def corners_of(box: Float64) -> Float64:
    """Return the corners (4, 2) of a box (x, y, yaw, half length, half width)."""
    x, y, yaw, length, width = box.tolist()
    ahead, left = np.array([math.cos(yaw), math.sin(yaw)]), np.array([-math.sin(yaw), math.cos(yaw)])
    signs = ((1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0))
    return np.array([np.array([x, y]) + a * length * ahead + b * width * left for a, b in signs])


@dataclass(frozen=True, eq=False)
class Walls:
    """The buildings and walls of a synthetic street, seen from above, in which no agent may start.

    Attributes:
        street: the street.
        model: its fixed surfaces; None: the street is not synthetic, and its walls are unknown.
        low_m: (2, S) least x and y of each surface.
        high_m: (2, S) greatest x and y of each surface.
    """

    street: Street
    model: Model | None
    low_m: Float64
    high_m: Float64

    @classmethod
    @lru_cache(maxsize=2)
    def of(cls, street: Street) -> Walls:
        """Prepare the surfaces of a street."""
        if street.drive is None:
            return cls(street, None, np.zeros((2, 0)), np.zeros((2, 0)))
        return cls(street, street.drive.world.model, *_bounds_from_above(street.drive))

    def find(self, points: Float64) -> str | None:
        """Return the name of the wall over one of the points (N, 2), up to a person's height; None without a wall."""
        if self.model is None:
            return None
        from mirror.synth import Label, cast_rays

        # Only these surfaces can lie on a vertical ray; all 90,000 of a street take ten times as long.
        (left, bottom), (right, top) = points.min(axis=0), points.max(axis=0)
        near = (self.low_m[0] <= right) & (self.high_m[0] >= left) & (self.low_m[1] <= top) & (self.high_m[1] >= bottom)
        model = self.model.select(near)
        solid = (Label.BUILDING, Label.WALL)
        for x, y in points:
            ground = float(np.asarray(self.street.ground.height_m(np.array([x]), np.array([y])))[0])
            origin = np.array([x, y, ground + _ABOVE_M])
            distance, index = cast_rays(model, origin, np.array([[0.0, 0.0, -1.0]]))
            if index[0] < 0 or distance[0] > _ABOVE_M - _HOLLOW_M:
                continue
            faces, at = model.faces, int(index[0])
            label = int(faces["label"][at] if at < len(faces) else model.rounds["label"][at - len(faces)])
            if label in solid:
                return Label(label).name.lower()
        return None


@lru_cache(maxsize=2)
def _bounds_from_above(drive: SynthDrive) -> tuple[Float64, Float64]:
    """The least and greatest x and y (2, S) of each fixed surface; a rollout has a street of its own, not a drive."""
    low, high = drive.world.model.surface_bounds()
    return np.ascontiguousarray(low[:, :2].T), np.ascontiguousarray(high[:, :2].T)


def check_free(street: Street, walls: Walls, agent_id: str, category: str, box: Float64) -> None:
    """Refuse an agent that starts in a wall or off the drivable area.

    In a synthetic street every fixed object counts as a wall. Elsewhere only the drivable area is known, where
    vehicles have to start.

    Raises:
        UsageError: the agent cannot start there.
    """
    place = f"agent {agent_id!r}"
    corners = corners_of(box)
    if category not in _ON_FOOT:
        margin = box.copy()
        margin[3:] -= _TOLERANCE_M
        if not inside_area(corners_of(margin), street.road_map.drivable_rings).all():
            raise UsageError(
                f"it starts off the drivable area, at ({box[0]:.1f}, {box[1]:.1f})", place=place,
                expected="all corners on the drivable area", remedy="change its offset or its place ahead of the ego",
            )  # fmt: skip
    if label := walls.find(np.concatenate([corners, box[None, :2]])):
        raise UsageError(
            f"it starts in a {label}, at ({box[0]:.1f}, {box[1]:.1f})", place=place,
            expected="a free place", remedy="change its offset or its place ahead of the ego",
        )  # fmt: skip
