"""Comfort: exact for polynomials, equal to SciPy's filter, and its bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.metrics.safety import COMFORT_BOUNDS, measure_comfort
from mirror.metrics.safety.comfort import differentiate
from tests.metrics.safety.logs import Actor, constant, moved, random_log, state_log

TIMES = 0.1 * np.arange(101)


@pytest.mark.parametrize(("window", "degree", "order"), [(9, 2, 1), (15, 2, 1), (5, 3, 2), (5, 2, 1), (15, 3, 3)])
@pytest.mark.parametrize("offset", [0.0, 1e9])
def test_polynomials_are_differentiated_exactly(window: int, degree: int, order: int, offset: float) -> None:
    rng = np.random.default_rng(window)
    times = np.cumsum(rng.uniform(0.05, 0.15, 60))
    curve = np.polynomial.Polynomial(rng.normal(size=degree + 1))
    values = offset + curve(times)
    found = differentiate(times, values, window=window, degree=degree, order=order)
    tolerance = 1e-6 if offset == 0.0 else 1e-2 * 10.0**order
    np.testing.assert_allclose(found, curve.deriv(order)(times), atol=tolerance)


@pytest.mark.parametrize(("window", "degree", "order"), [(9, 2, 1), (15, 2, 1), (5, 3, 2)])
def test_it_is_the_filter_of_savitzky_and_golay(window: int, degree: int, order: int) -> None:
    signal = pytest.importorskip("scipy.signal")
    values = np.random.default_rng(0).normal(size=(101, 2))
    expected = signal.savgol_filter(values, window, degree, deriv=order, delta=0.1, axis=0)
    found = differentiate(TIMES, values, window=window, degree=degree, order=order)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def braking(deceleration: float) -> Actor:
    speed = 30.0 - deceleration * TIMES
    return Actor(np.stack([30 * TIMES - 0.5 * deceleration * TIMES**2, 0 * TIMES, 0 * TIMES, speed, 0 * TIMES], axis=1))


def circling(speed: float, rate: float) -> Actor:
    yaw = rate * TIMES
    radius = speed / rate
    columns = [radius * np.sin(yaw), radius * (1 - np.cos(yaw)), yaw, speed * np.cos(yaw), speed * np.sin(yaw)]
    return Actor(np.stack(columns, axis=1))


@pytest.mark.parametrize(
    ("actor", "exceeded"),
    [
        (constant(0, 0, 0.3, 20.0, TIMES), None),
        (braking(2.5), None),
        (braking(4.04), None),
        (braking(4.06), "longitudinal_acceleration_mps2"),
        (braking(-2.41), "longitudinal_acceleration_mps2"),
        (circling(10.0, 0.4), None),
        (circling(10.0, 0.5), "lateral_acceleration_mps2"),
        (circling(-10.0, 0.5), "lateral_acceleration_mps2"),
        (circling(1.0, 1.0), "yaw_rate_radps"),
    ],
)
def test_bounds(actor: Actor, exceeded: str | None) -> None:
    found = measure_comfort(state_log(TIMES, actor))
    beyond = {
        name
        for name, (value, _) in found.worst.items()
        if not COMFORT_BOUNDS[name][0] - 1e-9 <= value <= COMFORT_BOUNDS[name][1] + 1e-9
    }
    assert beyond == ({exceeded} if exceeded else set())
    assert found.is_comfortable is (exceeded is None)
    assert (found.stamp_ns is None) is (exceeded is None)


def test_values_of_a_circle_and_of_constant_braking() -> None:
    found = measure_comfort(state_log(TIMES, circling(10.0, 0.3))).quantities
    np.testing.assert_allclose(found["lateral_acceleration_mps2"], 3.0, rtol=0.02)
    np.testing.assert_allclose(found["yaw_rate_radps"], 0.3, atol=1e-9)
    np.testing.assert_allclose(found["longitudinal_acceleration_mps2"][5:-5], 0.0, atol=1e-9)
    found = measure_comfort(state_log(TIMES, braking(3.0))).quantities
    np.testing.assert_allclose(found["longitudinal_acceleration_mps2"], -3.0, atol=1e-9)
    np.testing.assert_allclose(found["jerk_mps3"], 0.0, atol=1e-9)


def test_jerk_of_a_ramp() -> None:
    # The acceleration falls linearly at 5 m/s3.
    speed = 30.0 - 2.5 * TIMES**2
    log = state_log(TIMES, Actor(np.stack([0 * TIMES, 0 * TIMES, 0 * TIMES, speed, 0 * TIMES], axis=1)))
    found = measure_comfort(log)
    np.testing.assert_allclose(found.quantities["longitudinal_jerk_mps3"], -5.0, atol=1e-8)
    assert found.worst["longitudinal_jerk_mps3"][0] == pytest.approx(-5.0)


def test_headings_that_wrap_do_not_turn() -> None:
    log = state_log(TIMES, circling(10.0, 0.3))
    wrapped = replace(log, yaw_rad=np.angle(np.exp(1j * log.yaw_rad)))
    for name, values in measure_comfort(log).quantities.items():
        np.testing.assert_allclose(measure_comfort(wrapped).quantities[name], values, atol=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_the_frame_does_not_matter(seed: int) -> None:
    log = random_log(np.random.default_rng(seed), agents=0, stamps=30)
    one, other = (measure_comfort(log).quantities, measure_comfort(moved(log, 1e6, -2e6, 1.1)).quantities)
    for name, values in one.items():
        np.testing.assert_allclose(other[name], values, atol=1e-6)


def test_short_logs() -> None:
    with pytest.raises(UsageError, match="3 stamps"):
        measure_comfort(state_log(TIMES[:3], constant(0, 0, 0, 1.0, TIMES[:3])))
    assert measure_comfort(state_log(TIMES[:4], constant(0, 0, 0, 1.0, TIMES[:4]))).is_comfortable
    with pytest.raises(UsageError, match="2 samples"):
        differentiate(TIMES[:2], TIMES[:2], window=5, degree=2, order=1)
