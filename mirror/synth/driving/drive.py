"""The motion of the recording vehicle, exact at any time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.geometry import Poses, quaternion_from_heading_pitch_roll
from mirror.portable import arrays
from mirror.traffic.lanes.ways import STEP_M
from mirror.traffic.placement.trace import Schedule, Trace

_DIVE_DEG: Final = 0.22
_LEAN_DEG: Final = 0.32
"""Pitch and roll of the body on its springs, degrees per m/s2 of longitudinal and lateral acceleration."""
_SETTLES: Final = 5


@dataclass(frozen=True, eq=False)
class Drive:
    """One drive of the recording vehicle: the exact motion at any time from 0 to ``duration_s``.

    Attributes:
        route: name of the route.
        trace: placements of the ego frame (rear axle, on the ground) along the way.
        schedule: position of the front end along the way over time, from the start of the drive.
        duration_s: duration of the drive.
        clock_s: time of the signal cycle at the start of the drive.
        sway: phase of the small motions of the body.
    """

    route: str
    trace: Trace
    schedule: Schedule
    duration_s: float
    clock_s: float
    sway: float = 0.0

    @cached_property
    def _springs(self) -> Float64:
        """(T, 2) pitch and roll, degrees, at the knots of the schedule and at two further knots at either end."""
        schedule = self.schedule
        knots = schedule.begin_s + np.arange(-2, len(schedule.along_m) + 2, dtype=np.float64) * schedule.step_s
        along, speed = schedule.at(knots)
        ahead, _ = self.trace.at(along + 0.5 * STEP_M)
        previous, _ = self.trace.at(along - 0.5 * STEP_M)
        bend = (ahead[:, 3] - previous[:, 3]) / STEP_M
        pull = np.gradient(speed, schedule.step_s)
        time = knots + self.sway
        rough = np.minimum(speed / 6.0, 1.0)
        pitch = _DIVE_DEG * pull + rough * (0.05 * arrays.sin(8.3 * time) + 0.07 * arrays.sin(5.1 * time + 1.0))
        roll = _LEAN_DEG * speed**2 * bend + rough * (
            0.06 * arrays.sin(6.7 * time) + 0.08 * arrays.sin(4.3 * time + 2.0)
        )
        window = 0.5 - 0.5 * arrays.cos(2.0 * math.pi * np.arange(1, 2 * _SETTLES + 2) / (2 * _SETTLES + 2))
        window /= window.sum()
        padded = np.pad(np.column_stack([pitch, roll]), ((_SETTLES, _SETTLES), (0, 0)), "edge")
        return np.column_stack([arrays.convolve(padded[:, axis], window) for axis in (0, 1)])

    def driven_m(self, time_s: Float64) -> Float64:
        """Return the lengths (N,) driven since the start at times (N,)."""
        start, _ = self.schedule.at(np.zeros(1))
        return self.schedule.at(np.asarray(time_s, np.float64))[0] - start[0]

    def speeds_mps(self, time_s: Float64) -> Float64:
        """Return the forward speeds (N,) of the ego frame at times (N,)."""
        along, speed = self.schedule.at(np.asarray(time_s, np.float64))
        return speed * self.trace.at(along)[1]

    def poses(self, time_s: Float64) -> Poses:
        """Return ``world_SE3_ego`` at times (N,): on the ground, with the pitch and roll of the body on its springs."""
        time = np.asarray(time_s, np.float64)
        along, _ = self.schedule.at(time)
        poses, _ = self.trace.at(along)
        pitch, roll = self._sway(time).T
        rotation = quaternion_from_heading_pitch_roll(
            90.0 - np.degrees(poses[:, 3]), np.degrees(poses[:, 4]) + pitch, np.degrees(poses[:, 5]) + roll
        )
        return Poses(rotation, poses[:, :3])

    def _sway(self, time_s: Float64) -> Float64:
        """(N, 2) pitch and roll of the body on its springs, degrees: a cubic B-spline in time."""
        springs = self._springs
        place = (time_s - self.schedule.begin_s) / self.schedule.step_s + 2.0
        inside = np.clip(place, 1.0, len(springs) - 3.0)
        i = np.minimum(inside.astype(np.int64), len(springs) - 3)
        f = (inside - i)[:, None]
        g = 1.0 - f
        weights = (
            g * g * g / 6.0,
            (4.0 - 3.0 * f * f * (2.0 - f)) / 6.0,
            (4.0 - 3.0 * g * g * (2.0 - g)) / 6.0,
            f * f * f / 6.0,
        )
        return sum((w * springs[i + k - 1] for k, w in enumerate(weights)), start=np.zeros((len(i), 2)))
