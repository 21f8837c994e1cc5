"""Bounds, quantiles and verdicts against closed forms; drift and stage differences against exact motions."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from mirror.calibration.localisation import compute_drift
from mirror.calibration.stages import compare_rows
from mirror.calibration.statistics import clopper_pearson, compute_fleet_statistics, require_scipy, samples_needed
from mirror.errors import UsageError
from mirror.geometry import Poses, quaternion_exp


def test_998_samples_without_a_failure_are_needed() -> None:
    assert samples_needed() == 998
    assert clopper_pearson(998, 998)[0] >= 0.997
    assert clopper_pearson(997, 997)[0] < 0.997


@pytest.mark.parametrize(("successes", "samples"), [(0, 5), (3, 10), (49, 50), (200, 200)])
def test_the_bounds_are_those_of_binomial_tails(successes: int, samples: int) -> None:
    from scipy.stats import binom

    lower, upper = clopper_pearson(successes, samples)
    if successes:
        assert binom.sf(successes - 1, samples, lower) == pytest.approx(0.05, abs=1e-9)
    else:
        assert lower == 0.0
    if successes < samples:
        assert binom.cdf(successes, samples, upper) == pytest.approx(0.05, abs=1e-9)
    else:
        assert upper == 1.0


def test_without_scipy_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    require_scipy()
    monkeypatch.setitem(sys.modules, "scipy", None)
    with pytest.raises(UsageError, match="needs scipy") as caught:
        require_scipy()
    assert "calibration" in str(caught.value)
    assert "pip install" in str(caught.value)


def test_no_samples_and_wrong_counts() -> None:
    assert clopper_pearson(0, 0) == (0.0, 1.0)
    with pytest.raises(UsageError):
        clopper_pearson(3, 2)


def test_the_quantile_of_normal_errors() -> None:
    errors = np.random.default_rng(1).normal(0.0, 0.08, (20000, 3))
    angle = np.linalg.norm(errors, axis=1)
    ids = [f"t{number}" for number in range(len(angle))]
    found = compute_fleet_statistics(ids, ["v"] * len(ids), angle, np.full(len(angle), 0.05))
    # The 99.7 % quantile of Maxwell's distribution with 0.08 is 0.299.
    assert found.robust_quantile_deg == pytest.approx(0.299, abs=0.004)
    assert found.empirical_quantile_deg == pytest.approx(0.299, abs=0.02)
    assert found.corrected_rms_deg == pytest.approx(np.sqrt(3 * 0.08**2 - 0.05**2), abs=0.002)


def test_verdicts_count_traversals() -> None:
    many = [f"t{number}" for number in range(1000)]
    assert compute_fleet_statistics(many, many, np.full(1000, 0.1), np.zeros(1000)).verdict == "pass"
    few = compute_fleet_statistics(["a"] * 7 + ["b"] * 7, ["v"] * 14, [0.1] * 13 + [0.5], np.zeros(14))
    assert (few.samples, few.samples_below, few.cameras, few.cameras_below) == (2, 1, 14, 13)
    # One failure of two: at 95 % the share is below 97.5 %.
    assert few.verdict == "fail"
    assert compute_fleet_statistics(["a", "b"], ["v", "v"], [0.1, 0.2], np.zeros(2)).verdict == "too few"
    assert compute_fleet_statistics(many, many, np.full(1000, 0.5), np.zeros(1000)).verdict == "fail"
    none = compute_fleet_statistics([], [], [], [])
    assert none.verdict == "too few"
    assert np.isnan(none.median_deg)


def test_a_scale_error_is_a_drift_of_its_percentage() -> None:
    way = np.stack([np.linspace(0.0, 300.0, 601), np.zeros(601), np.zeros(601)], axis=1)
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (601, 1))
    drift = compute_drift(Poses(turns, 1.005 * way), Poses(turns, way), 100.0)
    assert len(drift) == 41
    assert np.abs(drift - 0.5).max() < 1e-9
    moved = Poses.exp([[0.0, 0.0, 1.0, 5.0, -3.0, 2.0]]) @ Poses(turns, way)
    assert compute_drift(moved, Poses(turns, way), 50.0).max() < 1e-9
    assert not len(compute_drift(Poses(turns, way), Poses(turns, way), 400.0))
    with pytest.raises(UsageError):
        compute_drift(Poses(turns, way), Poses(turns[:3], way[:3]), 10.0)


def test_stages_differ_by_the_angle_about_the_vehicles_axes() -> None:
    first = Poses(quaternion_exp(np.array([[0.3, -0.4, 0.2]])), np.array([[1.0, 2.0, 3.0]]))
    turn = Poses(quaternion_exp(np.radians([[0.1, -0.2, 0.3]])), np.zeros((1, 3)))
    second = Poses((turn @ first).rotation, first.translation + np.array([0.03, 0.0, -0.04]))

    def row(pose: Poses, stage: str) -> dict[str, object]:
        columns = {name: float(value[0]) for name, value in pose.to_columns().items()}
        return {**columns, "vehicle_id": "v", "drive_id": "d", "camera": "c", "stage": stage, "valid_from_ns": None}

    found = compare_rows(row(first, "factory"), row(second, "online"))
    assert found.axes_deg == pytest.approx((0.1, -0.2, 0.3), abs=1e-9)
    assert found.angle_deg == pytest.approx(np.sqrt(0.14), abs=1e-9)
    assert found.distance_cm == pytest.approx(5.0, abs=1e-9)
    assert not found.is_jump
    assert compare_rows(row(first, "online"), row(second, "online")).is_jump
