"""Nearest descriptors, however BLAS rounds their similarities."""

from __future__ import annotations

import numpy as np
import pytest

from mirror.arrays import Float32
from mirror.calibration.descriptors import find_clear_nearest, find_nearest, measure_angles


def _units(seed: int, count: int) -> Float32:
    vectors = np.random.default_rng(seed).random((count, 128), np.float32)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _rounded(first: Float32, second: Float32, seed: int) -> Float32:
    """Similarities as another BLAS kernel rounds them: up to 2e-7 off."""
    noise = np.random.default_rng(seed).uniform(-2e-7, 2e-7, (len(first), len(second)))
    return np.asarray(first @ second.T + noise, np.float32)


@pytest.mark.parametrize("seed", range(8))
def test_equal_descriptors_are_never_clear(seed: int) -> None:
    one = _units(1, 40)
    twice = np.concatenate([one, one])
    assert (find_clear_nearest(one, twice, _rounded(one, twice, seed)) == -1).all()
    assert (find_nearest(one, twice, _rounded(one, twice, seed)) == np.arange(40)).all()


@pytest.mark.parametrize("seed", range(8))
def test_rounding_of_similarities_does_not_matter(seed: int) -> None:
    one = _units(2, 60)
    other = one + np.random.default_rng(3).normal(0.0, 0.02, one.shape).astype(np.float32)
    other /= np.linalg.norm(other, axis=1, keepdims=True)
    other = np.concatenate([other, other[:5] + np.float32(1e-4)])
    expected = find_clear_nearest(one, other, one @ other.T, farthest_rad=0.7)
    assert (expected[5:] == np.arange(5, 60)).all()
    assert (find_clear_nearest(one, other, _rounded(one, other, seed), farthest_rad=0.7) == expected).all()


def test_neighbours_are_those_of_all_angles_in_float64() -> None:
    one, other = _units(4, 50), _units(5, 70)
    cosine = one.astype(np.float64) @ other.astype(np.float64).T
    angle = np.sort(np.arccos(cosine), axis=1)
    clear = (angle[:, 0] <= 0.66) & (angle[:, 0] < 0.99 * angle[:, 1])
    expected = np.where(clear, cosine.argmax(axis=1), -1)
    assert 5 < clear.sum() < 45
    similarity = one @ other.T
    before = similarity.copy()
    assert (find_clear_nearest(one, other, similarity, ratio=0.99, farthest_rad=0.66) == expected).all()
    assert (similarity == before).all()


def test_small_and_large_angles_are_exact() -> None:
    angle = np.array([0.0, 1e-3, 0.7, np.pi / 2, np.pi])
    first = np.tile(np.float32([1.0, 0.0]), (5, 1))
    second = np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32)
    assert np.abs(measure_angles(first, second) - angle).max() < 5e-4  # float32 has 3.4e-4 at an angle of pi
    assert measure_angles(first[:2], second[:2]) == pytest.approx(angle[:2], abs=1e-9)
