"""Steps that no body can make, and the difference of two logs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hybridworldsim.simulator.ego.vehicle import (
    Controls,
    EgoState,
    VehicleParameters,
    advance,
    center_position,
    center_velocity,
)
from mirror.metrics.safety import StateLog, find_difference, find_impossible_motion
from tests.metrics.safety.logs import constant, state_log

TIMES = 0.1 * np.arange(31)


def moving() -> StateLog:
    """The ego at 10 m/s, a car at 8 m/s before it."""
    return state_log(TIMES, constant(0.0, 0.0, 0.0, 10.0, TIMES), constant(30.0, 0.0, 0.0, 8.0, TIMES))


@pytest.mark.parametrize("rate_hz", [2.0, 10.0, 100.0])
@pytest.mark.parametrize("seed", range(5))
def test_a_vehicle_with_any_controls_moves_possibly(seed: int, rate_hz: float) -> None:
    """The vehicle of the simulator, with the most violent controls that it takes."""
    rng, vehicle = np.random.default_rng(seed), VehicleParameters()
    state = EgoState(5.0, -3.0, 2.0, float(rng.uniform(0.0, 25.0)))
    rows = []
    for _ in range(100):
        rows.append((*center_position(vehicle, state), state.yaw_rad, *center_velocity(vehicle, state)))
        state = advance(vehicle, state, Controls(float(rng.uniform(-50, 50)), float(rng.uniform(-1, 1))), 1 / rate_hz)
    x, y, yaw, vx, vy = np.array(rows).T[:, :, None].copy()
    yaw = np.remainder(yaw + math.pi, 2.0 * math.pi) - math.pi
    log = StateLog(
        np.round(np.arange(100) / rate_hz * 1e9).astype(np.int64), x, y, yaw, vx, vy, np.array([vehicle.length_m]),
        np.array([vehicle.width_m]), np.ones((100, 1), np.bool_), ("ego",), ("ego",), vehicle.rear_axle_to_center_m,
    )  # fmt: skip
    assert find_impossible_motion(log) is None


def test_noise_of_labels_and_absent_agents_are_possible() -> None:
    log = moving()
    rng = np.random.default_rng(0)
    x, present = log.x_m.copy(), log.present.copy()
    x[:, 1] += rng.normal(0.0, 0.15, len(TIMES))
    present[10:20, 1] = False
    x[20:, 1] += 500.0
    assert find_impossible_motion(replace(log, x_m=x, present=present)) is None
    single = replace(moving(), stamps_ns=log.stamps_ns[:1], present=log.present[:1], **{
        name: getattr(log, name)[:1] for name in ("x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps")
    })  # fmt: skip
    assert find_impossible_motion(single) is None


def shifted(name: str, actor: int, by: float) -> Callable[[StateLog], StateLog]:
    def change(log: StateLog) -> StateLog:
        values = getattr(log, name).copy()
        values[12:, actor] += by
        return replace(log, **{name: values})

    return change


@pytest.mark.parametrize(
    ("change", "actor", "quantity"),
    [
        (shifted("x_m", 0, 100.0), "ego", "from where its speed leads"),
        (shifted("x_m", 0, 0.3), "ego", "from where its speed leads"),
        (shifted("y_m", 0, 0.5), "ego", "sideways"),
        (shifted("vx_mps", 0, -4.0), "ego", "change of speed"),
        (shifted("yaw_rad", 0, 0.5), "ego", "turn in a step"),
        (shifted("x_m", 1, -2.0), "agent1", "from where its velocity leads"),
        (shifted("vx_mps", 1, 100.0), "agent1", "speed: 108.00 m/s"),
    ],
)
def test_the_step_that_no_body_can_make_is_named(
    change: Callable[[StateLog], StateLog], actor: str, quantity: str
) -> None:
    assert find_impossible_motion(moving()) is None
    found = find_impossible_motion(change(moving()))
    assert found is not None
    assert (found.actor, found.stamp_ns) == (actor, int(moving().stamps_ns[12]))
    assert quantity in found.problem


def test_pedestrians_are_slower_than_cars() -> None:
    log = moving()
    vx, x = log.vx_mps.copy(), log.x_m.copy()
    vx[:, 1], x[:, 1] = 20.0, 30.0 + 20.0 * TIMES
    fast = replace(log, vx_mps=vx, x_m=x)
    assert find_impossible_motion(fast) is None
    assert find_impossible_motion(replace(fast, categories=("ego", "pedestrian"))) is not None


def test_logs_are_the_same_to_a_micrometre_in_any_order_of_agents() -> None:
    log = moving()
    assert find_difference(log, log) is None
    assert find_difference(replace(log, x_m=log.x_m + 0.9e-6), log) is None
    turned = replace(log, yaw_rad=log.yaw_rad + 2.0 * math.pi)
    assert find_difference(turned, log) is None
    swapped = replace(
        log, **{name: getattr(log, name)[:, ::-1].copy() for name in ("x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps")},
        ids=log.ids[::-1], categories=log.categories[::-1], present=log.present[:, ::-1],
        length_m=log.length_m[::-1].copy(), width_m=log.width_m[::-1].copy(),
    )  # fmt: skip
    assert find_difference(swapped, log) is None
    for other, word in (
        (replace(log, x_m=log.x_m + 1.1e-6), "x_m of actor 'ego' differs by 1.1e-06 at instant 0"),
        (replace(log, stamps_ns=log.stamps_ns + 1), "instant 0"),
        (replace(log, ids=("ego", "other")), "actor 'agent1' is missing"),
        (replace(log, categories=("car", "bus")), "actor 'agent1' is a bus"),
        (replace(log, length_m=log.length_m * 0.9), "length_m"),
        (replace(log, rear_axle_to_center_m=0.0), "rear axle"),
    ):
        assert word in (find_difference(other, log) or "")
