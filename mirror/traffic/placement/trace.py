"""Smooth motions: the placement of a vehicle by length along its way, and the length by time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Float64
from mirror.portable import arrays, scalars
from mirror.traffic.lanes.ways import STEP_M, Way
from mirror.traffic.placement.motion import Placement

HeightField = Callable[[Float64, Float64], Float64]
"""Function from arrays of x and y to the heights of the ground, metres."""

# Control points beyond the ends of the way, enough for the longest vehicle.
_PAD: Final = 44
# Substeps of the trailing rear axle; with fewer steps it would cut bends.
_PULLS: Final = 10


@dataclass(frozen=True)
class Chassis:
    """The dimensions with which a vehicle's front axle follows a line while the rear axle trails.

    Attributes:
        length_m: length of the body.
        width_m: width of the body.
        wheelbase_m: distance between the axles; some decimetres for pedestrians.
        rear_overhang_m: distance from the rear axle to the rear end.
        origin_m: distance from the rear axle forward to the origin of the body frame.
    """

    length_m: float
    width_m: float
    wheelbase_m: float
    rear_overhang_m: float
    origin_m: float

    @classmethod
    def of_box(cls, length_m: float, width_m: float) -> Chassis:
        """Return the chassis of a body given by its box, with the origin in the box's middle."""
        wheelbase, overhang = 0.6 * length_m, 0.2 * length_m
        return cls(length_m, width_m, wheelbase, overhang, 0.5 * length_m - overhang)

    @property
    def front_overhang_m(self) -> float:
        """Distance from the front axle to the front end."""
        return self.length_m - self.rear_overhang_m - self.wheelbase_m


@dataclass(frozen=True)
class Aside:
    """The lateral position in a lane.

    Attributes:
        right_m: mean offset to the right of the middle.
        wander_m: amplitude of the slow variation around the mean.
        phase: phase of the variation.
    """

    right_m: float = 0.0
    wander_m: float = 0.0
    phase: float = 0.0

    def at(self, along_m: Float64) -> Float64:
        """Return the offsets (N,) to the right of the middle at lengths (N,), metres."""
        slow = arrays.sin(along_m / 31.0 + self.phase) + 0.5 * arrays.sin(along_m / 13.0 + 2.3 * self.phase)
        return self.right_m + self.wander_m * slow


@dataclass(frozen=True, eq=False)
class Trace:
    """The placements of a vehicle along its way: uniform cubic B-splines, twice differentiable.

    The length along the way refers to the vehicle's front end. The trace continues straight beyond the ends of the way.

    Attributes:
        controls: (N, 6) x, y, z, yaw, pitch, roll of the control points every `STEP_M`, the first at ``begin_m``.
        begin_m: length of the first control point.
    """

    controls: Float64
    begin_m: float

    def at(self, along_m: Float64) -> tuple[Float64, Float64]:
        """Return placements (N, 6) at lengths (N,), and the forward motion of the origin per metre of length (N,)."""
        low, high = self.begin_m + STEP_M, self.begin_m + STEP_M * (len(self.controls) - 3)
        inside = np.clip(along_m, low, high)
        place = (inside - self.begin_m) / STEP_M
        first = np.minimum(place.astype(np.int64), len(self.controls) - 3)
        f = place - first
        weights, slopes = _weights(f)
        rows = self.controls[first[:, None] + np.arange(-1, 3)]
        values = np.einsum("nk,nkd->nd", weights, rows)
        slope = np.einsum("nk,nkd->nd", slopes, rows[:, :, :2]) / STEP_M
        values[:, :2] += (along_m - inside)[:, None] * slope
        return values, arrays.hypot(slope[:, 0], slope[:, 1])


@dataclass(frozen=True, eq=False)
class Schedule:
    """The length along a way as a function of time: cubic between knots, with continuous speed.

    Attributes:
        begin_s: time of the first knot.
        step_s: time between knots.
        along_m: (N,) lengths at the knots.
        speed_mps: (N,) speeds at the knots; constant before the first and after the last knot.
    """

    begin_s: float
    step_s: float
    along_m: Float64
    speed_mps: Float64

    @property
    def end_s(self) -> float:
        """Time of the last knot."""
        return self.begin_s + self.step_s * (len(self.along_m) - 1)

    def since(self, start_s: float) -> Schedule:
        """Return the schedule with times relative to ``start_s``."""
        return replace(self, begin_s=self.begin_s - start_s)

    def time_of(self, along_m: float) -> float:
        """Return the first time at a length, accurate to a nanosecond."""
        last = int(np.argmax(self.along_m >= along_m))
        low, high = self.begin_s + self.step_s * max(last - 1, 0), self.begin_s + self.step_s * last
        while high - low > 1e-9:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self.at(np.array([middle]))[0][0] >= along_m else (middle, high)
        return high

    def at(self, time_s: Float64) -> tuple[Float64, Float64]:
        """Return lengths (N,) and speeds (N,) at times (N,)."""
        last = len(self.along_m) - 1
        place = (np.asarray(time_s, np.float64) - self.begin_s) / self.step_s
        inside = np.clip(place, 0.0, last)
        i = np.minimum(inside.astype(np.int64), last - 1)
        f = inside - i
        s0, s1 = self.along_m[i], self.along_m[i + 1]
        v0, v1 = self.speed_mps[i] * self.step_s, self.speed_mps[i + 1] * self.step_s
        d = s1 - s0
        along = s0 + f * (v0 + f * (3.0 * d - 2.0 * v0 - v1 + f * (v0 + v1 - 2.0 * d)))
        speed = v0 + f * (2.0 * (3.0 * d - 2.0 * v0 - v1) + 3.0 * f * (v0 + v1 - 2.0 * d))
        return along + (place - inside) * speed, speed / self.step_s


@dataclass(frozen=True, eq=False)
class TraceMotion:
    """The motion of a road user along its way."""

    trace: Trace
    schedule: Schedule

    def at(self, time_s: float) -> Placement:
        """Return the placement ``time_s`` after the start of the drive."""
        # Plain Python, because numpy's overhead would dominate for a single placement.
        schedule, trace = self.schedule, self.trace
        last = len(schedule.along_m) - 1
        place = (time_s - schedule.begin_s) / schedule.step_s
        inside = min(max(place, 0.0), float(last))
        i = min(int(inside), last - 1)
        f = inside - i
        s0, s1 = schedule.along_m[i : i + 2].tolist()
        v0, v1 = schedule.speed_mps[i : i + 2].tolist()
        v0, v1, d = v0 * schedule.step_s, v1 * schedule.step_s, s1 - s0
        b, c = 3.0 * d - 2.0 * v0 - v1, v0 + v1 - 2.0 * d
        speed = v0 + f * (2.0 * b + 3.0 * f * c)
        along = s0 + f * (v0 + f * (b + f * c)) + (place - inside) * speed
        end = len(trace.controls) - 3
        knot = (along - trace.begin_m) / STEP_M
        on = min(max(knot, 1.0), float(end))
        k = min(int(on), end)
        f = on - k
        g = 1.0 - f
        weights = np.array(
            (
                (
                    g * g * g / 6.0,
                    (4.0 - 3.0 * f * f * (2.0 - f)) / 6.0,
                    (4.0 - 3.0 * g * g * (2.0 - g)) / 6.0,
                    f * f * f / 6.0,
                ),
                (-0.5 * g * g, f * (1.5 * f - 2.0), g * (2.0 - 1.5 * g), 0.5 * f * f),
            )
        )
        value, slope = (arrays.matmul(weights, trace.controls[k - 1 : k + 3])).tolist()
        over = knot - on
        return Placement(
            value[0] + over * slope[0],
            value[1] + over * slope[1],
            value[2],
            value[3],
            value[4],
            value[5],
            scalars.hypot(slope[0], slope[1]) / STEP_M * speed / schedule.step_s,
            along,
        )


def build_trace(way: Way, chassis: Chassis, height_m: HeightField, aside: Aside | None = None) -> Trace:
    """Build the trace of a vehicle that follows a way: front axle on the line, rear axle trailing (a tractrix).

    Args:
        way: way that the vehicle follows.
        chassis: chassis of the vehicle.
        height_m: heights of the ground.
        aside: lateral position; default: the middle of the way.
    """
    begin = -STEP_M * _PAD
    along = begin - chassis.front_overhang_m + np.arange(len(way.points) + 2 * _PAD, dtype=np.float64) * STEP_M
    guide = _on_line(way.points, along)
    if aside is not None:
        step = np.gradient(guide, axis=0)
        step /= np.linalg.norm(step, axis=1, keepdims=True)
        guide = guide + aside.at(along)[:, None] * np.column_stack([step[:, 1], -step[:, 0]])
    rear = trail_rear_axle(np.ascontiguousarray(guide), chassis.wheelbase_m)
    step = np.gradient(rear, axis=0)
    yaw = np.unwrap(arrays.arctan2(step[:, 1], step[:, 0]))
    ahead = np.column_stack([arrays.cos(yaw), arrays.sin(yaw)])
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    base, track = chassis.wheelbase_m, 0.8 * chassis.width_m
    middle = rear + 0.5 * base * ahead
    wheels = np.concatenate([rear, rear + base * ahead, middle + 0.5 * track * left, middle - 0.5 * track * left])
    back, front, port, starboard = height_m(wheels[:, 0], wheels[:, 1]).reshape(4, len(rear))
    origin = rear + chassis.origin_m * ahead
    height = back + (front - back) * (chassis.origin_m / base)
    pitch, roll = arrays.arctan2(front - back, base), arrays.arctan2(port - starboard, track)
    return Trace(np.column_stack([origin, height, yaw, pitch, roll]), begin)


def _weights(f: Float64) -> tuple[Float64, Float64]:
    """Weights (N, 4) of the four nearest control points, for the value and for the slope."""
    g = 1.0 - f
    value = (
        g * g * g / 6.0,
        (4.0 - 3.0 * f * f * (2.0 - f)) / 6.0,
        (4.0 - 3.0 * g * g * (2.0 - g)) / 6.0,
        f * f * f / 6.0,
    )
    slope = (-0.5 * g * g, f * (1.5 * f - 2.0), g * (2.0 - 1.5 * g), 0.5 * f * f)
    return np.stack(value, axis=1), np.stack(slope, axis=1)


def _on_line(points: Float64, along_m: Float64) -> Float64:
    """Points (M, 2) at lengths (M,) of a line sampled every `STEP_M`, which continues straight beyond its ends."""
    end = STEP_M * (len(points) - 1)
    inside = np.clip(along_m, 0.0, end)
    over = (along_m - inside)[:, None]
    place = STEP_M * np.arange(len(points))
    points_at = np.column_stack([np.interp(inside, place, points[:, axis]) for axis in (0, 1)])
    first, last = points[1] - points[0], points[-1] - points[-2]
    return points_at + np.where(over < 0.0, over * first / arrays.norm(first), over * last / arrays.norm(last))


@njit(cache=True, nogil=True)
def trail_rear_axle(guide: Float64, base: float) -> Float64:
    """Return the points (N, 2) of the rear axle when the front axle follows the points (N, 2)."""
    rear = np.empty_like(guide)
    dx, dy = guide[1, 0] - guide[0, 0], guide[1, 1] - guide[0, 1]
    long = scalars.hypot(dx, dy)
    x, y = guide[0, 0] - base * dx / long, guide[0, 1] - base * dy / long
    for i in range(len(guide)):
        before = max(i - 1, 0)
        for part in range(1, _PULLS + 1):
            share = part / _PULLS
            dx = guide[before, 0] + share * (guide[i, 0] - guide[before, 0]) - x
            dy = guide[before, 1] + share * (guide[i, 1] - guide[before, 1]) - y
            pull = 1.0 - base / scalars.hypot(dx, dy)
            x, y = x + pull * dx, y + pull * dy
        rear[i, 0], rear[i, 1] = x, y
    return rear
