"""How the recording vehicle drives: a line through waypoints with rounded corners, and a speed along it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.geometry import Poses, quaternion_from_heading_pitch_roll
from mirror.synth.road_users import Placement

_STEP_M: Final = 0.05
_SIDEWAYS_MPS2: Final = 2.2
_FORWARD_MPS2: Final = 1.6
# Nobody keeps a speed exactly: now and then drivers let up.
_EASING: Final = 0.14
_EASING_M: Final = 17.0


@dataclass(frozen=True)
class Stop:
    """A halt: where along the line, and for how long."""

    at_m: float
    seconds: float


@dataclass(frozen=True)
class Drive:
    """One drive of a vehicle: exact truth at any time from 0 to ``duration_s``.

    Attributes:
        waypoints: (N, 2) world metres; the line is straight between them and runs on straight beyond the ends.
        speed_mps: greatest cruising speed; less in bends.
        corner_m: radius of the rounded corners.
        keep_right_m: how far right of the line of the waypoints it drives.
        stops: halts, in order.
        sway: phase of the small motions of the body on its springs, and of the speed.
    """

    waypoints: Sequence[tuple[float, float]]
    speed_mps: float
    corner_m: float = 9.0
    keep_right_m: float = 0.0
    stops: Sequence[Stop] = field(default_factory=tuple)
    sway: float = 0.0

    @cached_property
    def _line(self) -> tuple[Float64, Float64, Float64]:
        """Driven length (M,), points (M, 2) and unwrapped yaw (M,)."""
        points = np.asarray(self.waypoints, np.float64)
        pieces = [points[0]]
        for before, corner, after in zip(points[:-2], points[1:-1], points[2:]):
            pieces.append(_rounded(before, corner, after, self.corner_m))
        pieces.append(points[-1])
        rough = np.vstack(pieces)
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(rough, axis=0).T))])
        even = np.linspace(0.0, along[-1], max(int(along[-1] / _STEP_M), 2))
        centre = np.column_stack([np.interp(even, along, rough[:, axis]) for axis in (0, 1)])
        tangent = np.gradient(centre, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        driven = centre + self.keep_right_m * np.column_stack([tangent[:, 1], -tangent[:, 0]])
        length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(driven, axis=0).T))])
        return length, driven, np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))

    @cached_property
    def _schedule(self) -> tuple[Float64, Float64]:
        """Times and the lengths driven by then: as fast as bends, halts and the pedals allow."""
        length, _, yaw = self._line
        bend = np.abs(np.gradient(yaw, length))
        cruise = self.speed_mps * (1.0 - _EASING * (0.5 + 0.5 * np.sin(length / _EASING_M + self.sway)))
        speed = np.minimum(cruise, np.sqrt(_SIDEWAYS_MPS2 / np.maximum(bend, 1e-4)))
        for stop in self.stops:
            speed[np.argmin(np.abs(length - stop.at_m))] = 0.05
        step = np.diff(length)
        for i in range(1, len(speed)):
            speed[i] = min(speed[i], np.sqrt(speed[i - 1] ** 2 + 2.0 * _FORWARD_MPS2 * step[i - 1]))
        for i in range(len(speed) - 2, -1, -1):
            speed[i] = min(speed[i], np.sqrt(speed[i + 1] ** 2 + 2.0 * _FORWARD_MPS2 * step[i]))
        times = np.concatenate([[0.0], np.cumsum(2.0 * step / (speed[1:] + speed[:-1]))])
        for stop in self.stops:
            here = int(np.argmin(np.abs(length - stop.at_m)))
            times = np.insert(times, here + 1, times[here])
            length = np.insert(length, here + 1, length[here])
            times[here + 1 :] += stop.seconds
        return times, length

    @property
    def duration_s(self) -> float:
        """From the first to the last waypoint."""
        return float(self._schedule[0][-1])

    def driven_m(self, time_s: Float64) -> Float64:
        """Lengths (N,) driven by times (N,)."""
        return np.interp(time_s, *self._schedule)

    def on_line(self, driven_m: Float64) -> tuple[Float64, Float64]:
        """Points (N, 2) and yaws (N,) at driven lengths, straight on beyond both ends."""
        length, points, yaw = self._line
        inside = np.clip(driven_m, 0.0, length[-1])
        over = np.asarray(driven_m) - inside
        at_yaw = np.interp(inside, length, yaw)
        at = np.column_stack([np.interp(inside, length, points[:, axis]) for axis in (0, 1)])
        return at + over[:, None] * np.column_stack([np.cos(at_yaw), np.sin(at_yaw)]), at_yaw

    def speeds_mps(self, time_s: Float64) -> Float64:
        """Speeds (N,) at times (N,), over a tenth of a second."""
        return (self.driven_m(time_s + 0.05) - self.driven_m(time_s - 0.05)) / 0.1

    def poses(self, time_s: Float64) -> Poses:
        """``world_SE3_ego`` at times (N,): the rear axle on the line, the body swaying by tenths of a degree."""
        points, yaw = self.on_line(self.driven_m(time_s))
        moving = np.minimum(self.speeds_mps(time_s) / 5.0, 1.0)
        pitch = 0.12 * np.sin(2.1 * time_s + self.sway) * moving
        roll = 0.18 * np.sin(1.3 * time_s + 2.0 * self.sway) * moving
        rotation = quaternion_from_heading_pitch_roll(90.0 - np.degrees(yaw), pitch, roll)
        return Poses(rotation, np.column_stack([points, np.zeros(len(points))]))


@dataclass(frozen=True)
class Following:
    """The motion of a road user that keeps a distance to the recording vehicle, ahead of it or behind it."""

    drive: Drive
    ahead_m: float

    def at(self, time_s: float) -> Placement:
        """The placement ``time_s`` after the drive's start."""
        time = np.array([time_s])
        points, yaw = self.drive.on_line(self.drive.driven_m(time) + self.ahead_m)
        return Placement(float(points[0, 0]), float(points[0, 1]), float(yaw[0]), float(self.drive.speeds_mps(time)[0]))


def _rounded(before: Float64, corner: Float64, after: Float64, radius: float) -> Float64:
    """The arc (M, 2) that rounds a corner."""
    into, out = corner - before, after - corner
    into, out = into / np.linalg.norm(into), out / np.linalg.norm(out)
    turn = np.arctan2(into[0] * out[1] - into[1] * out[0], into @ out)
    if abs(turn) < 1e-6:
        return corner[None]
    left = np.sign(turn) * np.array([-into[1], into[0]])
    start = corner - into * radius * np.tan(abs(turn) / 2.0)
    middle = start + left * radius
    angle = np.linspace(0.0, turn, max(int(abs(turn) * radius / _STEP_M), 8))
    spoke = start - middle
    cos, sin = np.cos(angle), np.sin(angle)
    return middle + np.column_stack([cos * spoke[0] - sin * spoke[1], sin * spoke[0] + cos * spoke[1]])
