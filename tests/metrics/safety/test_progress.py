"""Progress along a route."""

from __future__ import annotations

import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.metrics.safety import route_progress
from tests.metrics.safety.logs import Actor, constant, moved, state_log

TIMES = 0.1 * np.arange(51)
STRAIGHT = np.stack([np.linspace(-20.0, 200.0, 111), np.zeros(111)], axis=1)


def test_straight_on_aside_and_backwards() -> None:
    found = route_progress(state_log(TIMES, constant(0.0, 1.2, 0.0, 10.0, TIMES)), STRAIGHT)
    assert found.progress_m == pytest.approx(50.0)
    assert found.route_ahead_m == pytest.approx(200.0)
    np.testing.assert_allclose(found.offset_m, 1.2)
    np.testing.assert_allclose(found.along_m, 20.0 + 10.0 * TIMES)
    assert route_progress(state_log(TIMES, constant(50.0, 0, 0, -4.0, TIMES)), STRAIGHT).progress_m == pytest.approx(
        -20
    )
    assert route_progress(state_log(TIMES, constant(50.0, 0, 0, 0.0, TIMES)), STRAIGHT).progress_m == 0.0


def test_a_route_that_crosses_itself_is_followed() -> None:
    # A figure of eight: the middle is passed twice.
    angle = np.linspace(0.0, 2.0 * np.pi, 721)
    route = 30.0 * np.stack([np.sin(angle), np.sin(angle) * np.cos(angle)], axis=1)
    steps = np.hypot(*np.diff(route, axis=0).T)
    states = np.column_stack([route[::6], np.zeros((121, 3))])
    found = route_progress(state_log(0.1 * np.arange(121), Actor(states)), route)
    assert found.progress_m == pytest.approx(steps.sum(), abs=1e-6)
    assert (np.diff(found.along_m) > 0.0).all()


def test_the_frame_does_not_matter() -> None:
    log = state_log(TIMES, constant(0.0, 1.2, 0.1, 10.0, TIMES))
    cos, sin = np.cos(0.7), np.sin(0.7)
    route = STRAIGHT @ np.array([[cos, sin], [-sin, cos]]) + [4e6, -5e6]
    one, other = route_progress(log, STRAIGHT), route_progress(moved(log, 4e6, -5e6, 0.7), route)
    assert other.progress_m == pytest.approx(one.progress_m, abs=1e-6)
    np.testing.assert_allclose(other.offset_m, one.offset_m, atol=1e-6)


@pytest.mark.parametrize("route", [[[0, 0]], [[0, 0], [0, 0]], [[0, 0], [np.nan, 1]], [[0, 0, 0], [1, 1, 1]]])
def test_bad_routes_are_refused(route: list[list[float]]) -> None:
    with pytest.raises(UsageError, match="a route of"):
        route_progress(state_log(TIMES, constant(0, 0, 0, 1.0, TIMES)), route)


def test_a_route_of_two_points_is_a_route() -> None:
    log = state_log(TIMES, constant(0.0, 1.2, 0.0, 10.0, TIMES))
    assert route_progress(log, [[-20.0, 0.0], [200.0, 0.0]]).progress_m == pytest.approx(50.0)
