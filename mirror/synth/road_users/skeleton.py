"""Skeletons of people who stand, walk and ride."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.portable import arrays, scalars
from mirror.synth.road_users.body import Saddle

_THIGH: Final = 0.245
_SHANK: Final = 0.246
_ANKLE: Final = 0.041
_ARM: Final = 0.172
_FOREARM: Final = 0.160
_HIP_OUT: Final = 0.050
_SHOULDER_OUT: Final = 0.112
_TRUNK: Final = 0.290
_STANCE: Final = 0.62
"""Share of a gait cycle for which a foot is on the ground."""
STRIDE: Final = 0.68
"""Length of two steps, as a share of the body height."""


@dataclass(frozen=True)
class Skeleton:
    """Joint positions in the body's frame (x forward, y left, z up), metres; in pairs, the left joint comes first.

    Attributes:
        hips: (2, 3) hip joints.
        knees: (2, 3) knee joints.
        ankles: (2, 3) ankle joints.
        soles: (2, 3) directions from heel to toe.
        shoulders: (2, 3) shoulder joints.
        elbows: (2, 3) elbow joints.
        wrists: (2, 3) wrist joints.
        neck: (3,) upper end of the trunk.
        head: (3,) centre of the skull.
        nod: downward rotation of the head, radians.
    """

    hips: Float64
    knees: Float64
    ankles: Float64
    soles: Float64
    shoulders: Float64
    elbows: Float64
    wrists: Float64
    neck: Float64
    head: Float64
    nod: float


def _left_right_rows(x: float | Float64, y: float | Float64, z: float | Float64) -> Float64:
    """Rows (2, 3) for left and right. Numpy's own functions are ten times slower, and each image has new poses."""
    rows = np.empty((2, 3))
    rows[:, 0], rows[:, 1], rows[:, 2] = x, y, z
    return rows


def head_half_m(height_m: float) -> float:
    """Return half the height of a head; children's heads are larger relative to their height."""
    return 0.5 * (0.160 + 0.037 * height_m)


def walking_skeleton(height_m: float, phase: float, pace: float, *, arm_raised: bool = False) -> Skeleton:
    """Compute a pose of the walk; at full pace the feet do not slide on the ground.

    Args:
        height_m: height of the person.
        phase: phase of the gait, which repeats after 1; at 0 the left heel touches the ground.
        pace: length of the steps, 0 to 1; at 0 the person stands.
        arm_raised: whether the left hand holds something up.
    """
    stride = STRIDE * height_m * pace
    phases = (phase + np.array([0.0, 0.5])) % 1.0
    stance, swing = np.minimum(phases / _STANCE, 1.0), np.maximum((phases - _STANCE) / (1.0 - _STANCE), 0.0)
    eased = swing - arrays.sin(2.0 * math.pi * swing) / (2.0 * math.pi)
    x = np.where(phases < _STANCE, _STANCE * stride * (0.5 - stance), _STANCE * stride * (eased - 0.5))
    # The heel leaves the ground in the last third of the stance; the toes point up as it comes down.
    roll = pace * arrays.power(np.clip((stance - 0.62) / 0.38, 0.0, 1.0), 1.5) * np.where(swing > 0.0, 1.0 - eased, 1.0)
    pitch = -0.95 * roll + 0.30 * pace * np.where(
        swing > 0.0, eased * eased * eased, np.clip(1.0 - 5.0 * stance, 0.0, 1.0)
    )
    lift = 0.075 * height_m * roll + 0.035 * height_m * pace * arrays.sin(math.pi * swing) ** 2
    ahead = 0.03 * height_m * arrays.sin(roll)
    ankles = _left_right_rows(x + ahead, np.array([0.8, -0.8]) * _HIP_OUT * height_m, _ANKLE * height_m + lift)
    return _upright_skeleton(height_m, ankles, pitch, x / (0.5 * _STANCE * STRIDE * height_m), 0.05 * pace, arm_raised)


def _upright_skeleton(
    height_m: float, ankles: Float64, pitch: Float64, step: Float64, lean: float, arm_raised: bool
) -> Skeleton:
    """Place the body over its feet; the arms swing opposite to the ``step`` of their side."""
    leg = 0.995 * (_THIGH + _SHANK) * height_m
    turn = 0.025 * height_m * step
    reach = np.maximum(leg**2 - (ankles[:, 0] - turn) ** 2, 0.0)
    top = 0.985 * (_THIGH + _SHANK + _ANKLE) * height_m
    hip = min(float((ankles[:, 2] + np.sqrt(reach)).min()), top)
    side = np.array([1.0, -1.0])
    hips = _left_right_rows(turn, side * _HIP_OUT * height_m, hip)
    knees = _middle_joints(hips, ankles, _THIGH * height_m, _SHANK * height_m, np.array([1.0, 0.0, 0.0]))
    soles = _left_right_rows(arrays.cos(pitch), 0.08 * side, arrays.sin(pitch))
    middle = np.array([0.0, 0.0, hip])
    up = np.array([scalars.sin(lean), 0.0, scalars.cos(lean)])
    chest = middle + _TRUNK * height_m * up
    shoulders = chest + _left_right_rows(-0.6 * turn, side * _SHOULDER_OUT * height_m, 0.0)
    swing = 0.03 - 0.33 * step
    bend = 0.18 + np.maximum(-0.30 * step, 0.0) + 0.12 * np.abs(step)
    arm = _left_right_rows(arrays.sin(swing), 0.10 * side, -arrays.cos(swing))
    forearm = _left_right_rows(arrays.sin(swing + bend), 0.02 * side, -arrays.cos(swing + bend))
    elbows = shoulders + _ARM * height_m * arm
    wrists = elbows + _FOREARM * height_m * forearm
    if arm_raised:
        wrists[0] = chest + np.array([0.13, 0.10, -0.03]) * height_m
        elbows[:1] = _middle_joints(
            shoulders[:1], wrists[:1], _ARM * height_m, _FOREARM * height_m, np.array([-0.2, 0.4, -1.0])
        )
    neck, head = _neck_and_head(height_m, chest, up)
    return Skeleton(hips, knees, ankles, soles, shoulders, elbows, wrists, neck, head, 0.03)


def _neck_and_head(height_m: float, chest: Float64, up: Float64) -> tuple[Float64, Float64]:
    """Positions of neck and head above the middle of the shoulders."""
    neck = chest + 0.015 * height_m * up
    # The head is as high as for a person who stands upright, hair included.
    total = (1.0 - 0.985 * (_THIGH + _SHANK + _ANKLE) - _TRUNK) * height_m
    rise = total - head_half_m(height_m) - 0.012
    return neck, chest + rise * np.array([0.5 * up[0], 0.0, 1.0]) / scalars.hypot(0.5 * up[0], 1.0) + [0.012, 0.0, 0.0]


def riding_skeleton(height_m: float, saddle: Saddle) -> Skeleton:
    """Compute the pose of a rider with hands on the grips and feet on the pedals."""
    side = np.array([1.0, -1.0])
    hip = np.array(saddle.hip) + np.array([0.0, 0.0, 0.055]) * height_m
    hips = hip + _left_right_rows(0.0, side * _HIP_OUT * height_m, 0.0)
    # The ball of the foot is on the pedal, with the heel above it.
    ankles = np.array([saddle.foot, saddle.foot_right]) + np.array([-0.055, 0.0, 0.072]) * height_m
    knees = _middle_joints(hips, ankles, _THIGH * height_m, _SHANK * height_m, np.array([1.0, 0.0, 0.35]))
    grips = np.array([saddle.hand, saddle.hand]) * _left_right_rows(1.0, side, 1.0)
    wrists = grips + np.array([-0.05, 0.0, 0.02]) * height_m
    leans = np.linspace(0.0, 1.1, 45)
    ups = np.c_[arrays.sin(leans), np.zeros(45), arrays.cos(leans)]
    chests = hip + _TRUNK * height_m * ups
    apart = np.linalg.norm(chests + np.array([0.0, _SHOULDER_OUT, 0.0]) * height_m - wrists[0], axis=1)
    up = ups[int(np.argmin(np.abs(apart - 0.88 * (_ARM + _FOREARM) * height_m)))]
    chest = hip + _TRUNK * height_m * up
    shoulders = chest + _left_right_rows(0.0, side * _SHOULDER_OUT * height_m, 0.0)
    elbows = _middle_joints(shoulders, wrists, _ARM * height_m, _FOREARM * height_m, np.array([-0.3, 0.0, -1.0]))
    elbows += _left_right_rows(0.0, 0.02 * side, 0.0)
    neck, head = _neck_and_head(height_m, chest, up)
    soles = np.tile([0.90, 0.0, -0.43], (2, 1))
    return Skeleton(hips, knees, ankles, soles, shoulders, elbows, wrists, neck, head, 0.0)


def _middle_joints(starts: Float64, ends: Float64, first_m: float, second_m: float, towards: Float64) -> Float64:
    """Middle joints (N, 3) of two-bone limbs, bent towards a direction; a limb stretches as far as its bones reach."""
    way = ends - starts
    length = np.linalg.norm(way, axis=1, keepdims=True)
    way = way / length
    length = np.clip(length, abs(first_m - second_m) + 1e-6, first_m + second_m)
    along = (first_m**2 - second_m**2 + length**2) / (2.0 * length)
    out = towards - (arrays.matmul(way, towards))[:, None] * way
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    return starts + along * way + np.sqrt(np.maximum(first_m**2 - along**2, 0.0)) * out
