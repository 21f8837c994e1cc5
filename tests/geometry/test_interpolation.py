"""Interpolation against closed forms, scipy and integers."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from mirror.errors import UsageError
from mirror.geometry import Poses, angle_between_deg, interpolate
from tests.draws import draws
from tests.geometry.poses import random_poses

EPOCH_NS = 1_700_000_000_123_456_789


def track(count: int = 50, seed: int = 0) -> tuple[np.ndarray, Poses]:
    generator = np.random.default_rng(seed)
    stamps = EPOCH_NS + np.cumsum(generator.integers(1_000_000, 100_000_000, count))
    return stamps, random_poses(count, seed, 1000.0)


def test_agrees_with_scipy() -> None:
    stamps, poses = track()
    query = np.random.default_rng(1).integers(stamps[0], stamps[-1], 500)
    ours = interpolate(stamps, poses, query)
    # Seconds since the first stamp are exact enough for the reference; seconds since 1970 would not be.
    seconds, wanted = (stamps - stamps[0]) * 1e-9, (query - stamps[0]) * 1e-9
    theirs = Slerp(seconds, Rotation.from_quat(poses.rotation, scalar_first=True))(wanted)
    assert angle_between_deg(ours.rotation, theirs.as_quat(scalar_first=True)).max() < 1e-9
    for axis in range(3):
        line = np.interp(wanted, seconds, poses.translation[:, axis])
        assert np.abs(ours.translation[:, axis] - line).max() < 1e-8


def test_recorded_stamps_give_the_recorded_poses_bit_for_bit() -> None:
    stamps, poses = track(1000)
    order = np.random.default_rng(0).permutation(1000)
    ours = interpolate(stamps, poses, stamps[order])
    assert (ours.rotation == poses.rotation[order]).all()
    assert (ours.translation == poses.translation[order]).all()


@given(st.integers(-(2**60), 2**60), st.integers(1, 10**12), st.floats(0, 1))
@settings(max_examples=draws(100))
def test_the_epoch_costs_no_digits(start: int, span: int, share: float) -> None:
    poses = Poses.exp([[0.0] * 6, [0, 0, 1.0, 0, 0, 0]])
    poses = Poses(poses.rotation, [[0.0, 0, 0], [1.0, 2.0, 3.0]])
    offset = int(span * share)
    got = interpolate([start, start + span], poses, start + offset)
    assert np.abs(got.translation - np.array([1.0, 2.0, 3.0]) * (offset / span)).max() < 1e-15
    assert abs(got.log()[0, 2] - offset / span) < 1e-14


def test_one_nanosecond_steps_are_distinct() -> None:
    poses = Poses.exp([[0.0] * 6, [0.0, 0, 0, 1, 0, 0]])
    got = interpolate([EPOCH_NS, EPOCH_NS + 1000], poses, np.arange(EPOCH_NS, EPOCH_NS + 1001))
    assert np.allclose(np.diff(got.translation[:, 0]), 1e-3, rtol=0, atol=1e-15)


def test_a_vehicle_at_rest_does_not_move() -> None:
    stamps, poses = track(2)
    still = Poses(np.tile(poses.rotation[:1], (2, 1)), np.tile(poses.translation[:1] + 1e6, (2, 1)))
    got = interpolate(stamps, still, np.linspace(stamps[0], stamps[1], 100).astype(np.int64)[1:-1])
    assert (got.translation == still.translation[0]).all()
    assert angle_between_deg(got.rotation, still.rotation[:1]).max() < 1e-13


def test_outside_is_an_error_that_says_what_to_do() -> None:
    stamps, poses = track()
    late = int(stamps[-1]) + 1
    with pytest.raises(UsageError) as error:
        interpolate(stamps, poses, [stamps[3], late, late + 5])
    text = str(error.value)
    assert str(late) in text
    assert f"{stamps[0]} to {stamps[-1]}" in text
    assert "leave that time out, or extrapolate" in text
    assert "query row 1" in text


def test_extrapolation_goes_on_at_the_velocity_of_the_end() -> None:
    poses = Poses.exp([[0, 0, 0.1 * k, 0, 0, 0] for k in range(3)])
    poses = Poses(poses.rotation, [[0.0, 0, 0], [1, 0, 0], [3, 0, 0]])
    got = interpolate([0, 10, 20], poses, [-10, 25, 30], extrapolate=True)
    assert np.allclose(got.translation[:, 0], [-1, 4, 5], atol=1e-14)
    assert np.allclose(got.log()[:, 2], [-0.1, 0.25, 0.3], atol=1e-14)


def test_bad_input() -> None:
    stamps, poses = track(5)
    with pytest.raises(UsageError, match="row 2"):
        interpolate([0, 10, 10, 20, 30], poses, 5)
    with pytest.raises(UsageError, match="row 3"):
        interpolate([0, 10, 20, 15, 30], poses, 5)
    with pytest.raises(UsageError, match="integers"):
        interpolate(stamps, poses, float(stamps[1]))
    with pytest.raises(UsageError, match="4 timestamps for 5 poses"):
        interpolate(stamps[:4], poses, stamps[0])
    with pytest.raises(UsageError, match="no poses"):
        interpolate(np.empty(0, dtype=np.int64), poses[:0], [1])


def test_one_pose_and_no_query() -> None:
    stamps, poses = track(1)
    assert (interpolate(stamps, poses, stamps).translation == poses.translation).all()
    assert len(interpolate(stamps, poses, np.empty(0, dtype=np.int64))) == 0
    with pytest.raises(UsageError, match="single pose"):
        interpolate(stamps, poses, stamps + 1, extrapolate=True)


def test_two_poses() -> None:
    stamps, poses = track(2)
    got = interpolate(stamps, poses, [stamps[0], stamps[1]])
    assert (got.rotation == poses.rotation).all()
    assert (got.translation == poses.translation).all()


def test_fast_enough_for_every_row_of_a_sensor() -> None:
    stamps, poses = track(10_000)
    query = np.random.default_rng(0).integers(stamps[0], stamps[-1], 200_000)
    interpolate(stamps, poses, query[:1000])
    best = min(_seconds(stamps, poses, query) for _ in range(3))
    assert best / len(query) < 1e-6
    best = min(_seconds(stamps, poses, query[:1]) for _ in range(50))
    # The 10,000 stamps are checked at every call.
    assert best < 200e-6


def _seconds(stamps: np.ndarray, poses: Poses, query: np.ndarray) -> float:
    start = time.perf_counter()
    interpolate(stamps, poses, query)
    return time.perf_counter() - start
