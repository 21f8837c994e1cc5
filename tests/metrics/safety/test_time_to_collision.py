"""Time to collision against closed forms, against shapely in fine steps, and across rates of the log."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.errors import UsageError
from mirror.metrics.safety import least_time_to_collision, time_to_collision
from tests.draws import draws
from tests.metrics.safety.logs import Actor, constant, moved, polygon, polygons, random_log, resample, state_log

TIMES = 0.1 * np.arange(21)


@settings(max_examples=draws(60), deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_it_is_the_first_time_at_which_moved_polygons_meet(seed: int) -> None:
    log = random_log(np.random.default_rng(seed), agents=1, stamps=1)
    value = time_to_collision(log)[0, 1]
    steps = np.arange(0.0, 3.0, 0.002)
    hits = steps[shapely.intersects(polygons(log, 0, 0, steps), polygons(log, 1, 0, steps))]
    if len(hits):
        assert hits[0] - 0.002 - 1e-9 <= value <= hits[0] + 1e-9
    elif value < 2.9:
        # A touch shorter than a step.
        assert polygon(log, 0, 0, value).distance(polygon(log, 1, 0, value)) < 1e-6


def test_closed_forms() -> None:
    ego = constant(0, 0, 0, 15.0, TIMES)
    values = time_to_collision(state_log(TIMES, ego, constant(34.5, 0, 0, 5.0, TIMES)))[:, 1]
    assert values == pytest.approx(3.0 - TIMES, abs=1e-12)
    same_speed = state_log(TIMES, ego, constant(34.5, 0, 0, 15.0, TIMES))
    assert np.isinf(time_to_collision(same_speed)[:, 1]).all()
    beside = state_log(TIMES, ego, constant(0, 1.8 + 1e-9, 0, 5.0, TIMES))
    assert np.isinf(time_to_collision(beside)[:, 1]).all()
    overlapping = state_log(TIMES, ego, constant(1.0, 0, 0, 15.0, TIMES))
    assert (time_to_collision(overlapping)[:, 1] == 0.0).all()
    assert np.isinf(time_to_collision(overlapping)[:, 0]).all()


def test_a_reversing_ego_collides_with_an_agent_behind() -> None:
    # nuPlan's own code projects the speed's magnitude along the heading, away from the agent behind.
    log = state_log(TIMES, constant(0, 0, 0, -5.0, TIMES), constant(-14.5, 0, 0, 0.0, TIMES))
    assert least_time_to_collision(log).value_s == pytest.approx(0.0, abs=1e-9)
    assert time_to_collision(log)[0, 1] == pytest.approx(2.0)


def test_the_end_of_the_horizon_counts() -> None:
    # A grid of steps that excludes its end misses a contact at exactly the horizon.
    log = state_log([0.0], constant(0, 0, 0, 10.0, [0.0]), constant(34.5, 0, 0, 0.0, [0.0]))
    assert least_time_to_collision(log, horizon_s=3.0).value_s == 3.0
    assert least_time_to_collision(log, horizon_s=2.9).value_s == math.inf


def test_every_agent_is_kept() -> None:
    # Flags that are reset for each object let the last one decide.
    ego = constant(0, 0, 0, 10.0, TIMES)
    near, far = constant(30, 0, 0, 0.0, TIMES), constant(200, 0, 0, 10.0, TIMES)
    for actors in ((near, far), (far, near)):
        least = least_time_to_collision(state_log(TIMES, ego, *actors))
        assert least.agent == f"agent{1 + actors.index(near)}"
        assert least.value_s == pytest.approx(0.55, abs=1e-9)
        assert least.stamp_ns == 1_700_000_002_000_000_000
        assert np.isinf(least.by_agent_s[[0, 1 + actors.index(far)]]).all()


def weaving(times: np.ndarray) -> tuple[Actor, Actor]:
    """An ego that closes in on a lead and swerves past it: the course to a collision ends between two stamps."""
    y = 1.25 * (1.0 + np.tanh(3.0 * (times - 1.03)))
    vy = np.gradient(y, times)
    ego = np.stack([15.0 * times, y, np.arctan2(vy, 15.0), np.full_like(times, 15.0), vy], axis=1)
    return Actor(ego), constant(28.0, 0.0, 0.0, 4.0, times)


@pytest.mark.parametrize("begin", [0.0, 0.013, 0.05, 0.077])
def test_it_does_not_depend_on_the_rate_of_the_log(begin: float) -> None:
    log = state_log(begin + TIMES, *weaving(begin + TIMES))
    coarse, fine = least_time_to_collision(log), least_time_to_collision(resample(log, 10))
    assert 0.1 < coarse.value_s < 3.0
    assert coarse.value_s == pytest.approx(fine.value_s, abs=0.001)
    assert coarse.value_s <= time_to_collision(resample(log, 100)).min() + 1e-6


@settings(max_examples=draws(40), deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_it_is_the_least_of_a_finely_resampled_log(seed: int) -> None:
    log = random_log(np.random.default_rng(seed))
    least = least_time_to_collision(log, horizon_s=3.0)
    stamps = time_to_collision(resample(log, 200)).min()
    if stamps <= 3.0:
        assert least.value_s <= stamps + 1e-9
        assert least.value_s >= stamps - 0.01
    else:
        # Only a course that lasts less than the samples' distance may be found, and finer samples find it too.
        assert math.isinf(least.value_s) or least.value_s >= time_to_collision(resample(log, 4000)).min() - 0.01


@pytest.mark.parametrize("seed", [1780, *range(40)])
def test_an_interpolated_log_has_the_same_least_time(seed: int) -> None:
    # Seed 1780: the least sample of a step lies above an earlier step's value, the minimum beside it below.
    log = random_log(np.random.default_rng(seed), agents=4, stamps=21)
    least, finer = least_time_to_collision(log).value_s, least_time_to_collision(resample(log, 10)).value_s
    assert least == pytest.approx(finer, abs=0.005) or (math.isinf(least) and math.isinf(finer))


@settings(max_examples=draws(30), deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-5e6, 5e6), st.floats(-5e6, 5e6), st.floats(-np.pi, np.pi))
def test_the_frame_does_not_matter(seed: int, x: float, y: float, turn: float) -> None:
    log = random_log(np.random.default_rng(seed))
    one, other = least_time_to_collision(log), least_time_to_collision(moved(log, x, y, turn))
    assert one.value_s == pytest.approx(other.value_s, abs=1e-4) or (one.value_s > 2.99 and other.value_s > 2.99)


def test_a_horizon_is_positive() -> None:
    log = state_log([0.0], constant(0, 0, 0, 10.0, [0.0]))
    assert least_time_to_collision(log).agent is None
    for horizon in (0.0, -1.0, math.nan):
        with pytest.raises(UsageError, match="horizon_s"):
            least_time_to_collision(log, horizon_s=horizon)
