"""Tests of placements: rotations against a product of elementary rotations."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from mirror.traffic.placement.motion import Placement, StaticMotion

_ANGLE = st.floats(-3.1, 3.1)


def _turn(axis: int, angle: float) -> np.ndarray:
    matrix = np.eye(3)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    matrix[i, i] = matrix[j, j] = np.cos(angle)
    matrix[i, j], matrix[j, i] = -np.sin(angle), np.sin(angle)
    return matrix


@given(_ANGLE, st.floats(-1.5, 1.5), _ANGLE)
def test_rotation_is_roll_then_pitch_then_yaw(yaw: float, pitch: float, roll: float) -> None:
    place = Placement(1.0, 2.0, 3.0, yaw, pitch, roll)
    # A right-handed rotation about y lowers the nose.
    assert_allclose(place.rotation, _turn(2, yaw) @ _turn(1, -pitch) @ _turn(0, roll), atol=1e-14)
    moved = place.world_SE3_body().transform(np.array([[1.0, 0.0, 0.0]]))
    assert_allclose(moved.reshape(3), place.rotation[:, 0] + place.translation, atol=1e-12)


def test_pitch_lifts_the_nose_and_roll_the_left_side() -> None:
    assert Placement(0, 0, 0, 0.7, pitch_rad=0.1).rotation[2, 0] > 0
    assert Placement(0, 0, 0, 0.7, roll_rad=0.1).rotation[2, 1] > 0


def test_static_motion_is_constant() -> None:
    place = Placement(1.0, 2.0, 3.0, 0.5)
    assert StaticMotion(place).at(-1e9) is StaticMotion(place).at(1e9) is place
