"""Percepts against closed forms, the controller, the scenarios and the statistics of the closed-loop study."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from benchmarks.studies.closed_loop.declaration import load_declaration
from benchmarks.studies.closed_loop.driving import Controller, ControllerSettings
from benchmarks.studies.closed_loop.perception_images import PerceptionImages
from benchmarks.studies.closed_loop.percepts import Percept, perceive_exactly, scale, unscale
from benchmarks.studies.closed_loop.scenarios import Case, list_cases
from benchmarks.studies.closed_loop.statistics import Rollouts, balanced_accuracy, compare, intervals
from benchmarks.studies.closed_loop.train_perception import Training, augment, select, train_network
from hybridworldsim.simulator.ego.vehicle import EgoState, VehicleParameters, advance
from mirror.errors import UsageError

SIGHT_M = 40.0
CAR = VehicleParameters()


def settings() -> ControllerSettings:
    return ControllerSettings(**load_declaration().controller, sight_m=SIGHT_M)


def box(x: float, y: float, length: float = 4.0, width: float = 2.0) -> list[float]:
    return [x, y, 0.0, 0.0, 0.5 * length, 0.5 * width, 1.0]


def test_percepts_of_a_straight_lane_and_of_an_arc() -> None:
    line = np.column_stack([np.arange(0.0, 200.0, 0.5), np.zeros(400)])
    ego = EgoState(20.0, 0.7, 0.1, 5.0)
    front = 20.0 + CAR.rear_axle_to_center_m + 0.5 * CAR.length_m
    boxes = np.array([box(20.0, 0.7), box(front + 12.0 + 2.0, 0.3), box(front + 6.0, 4.0), box(5.0, 0.0)])
    found = perceive_exactly(line, ego, boxes, CAR, 8.0, SIGHT_M)
    assert (found.offset_m, found.heading_rad) == pytest.approx((0.7, -0.1), abs=1e-12)
    # Only the box in the lane ahead counts.
    assert found.lead_m == pytest.approx(12.0, abs=0.3)
    assert perceive_exactly(line, ego, boxes[[0, 2, 3]], CAR, 8.0, SIGHT_M).lead_m == SIGHT_M
    # On an arc of 100 m the lane 8 m ahead has turned by 8 / 100.
    turn = np.arange(0.0, 1.5, 0.5 / 100.0)
    arc = 100.0 * np.column_stack([np.sin(turn), 1.0 - np.cos(turn)])
    ego = EgoState(100.0 * math.sin(0.5), 100.0 * (1.0 - math.cos(0.5)), 0.5, 5.0)
    found = perceive_exactly(arc, ego, boxes[:1], CAR, 8.0, SIGHT_M)
    assert (found.offset_m, found.heading_rad) == pytest.approx((0.0, 0.08), abs=1e-3)


def test_scaled_percepts_are_restored() -> None:
    percepts = np.array([[0.7, -0.1, 3.0], [-1.5, 0.2, 0.0], [0.0, 0.0, SIGHT_M]])
    assert unscale(scale(percepts, SIGHT_M), SIGHT_M) == pytest.approx(percepts, abs=1e-12)
    assert np.abs(scale(percepts, SIGHT_M)).max() <= 3.0


def test_the_controller_returns_to_the_middle_and_stops_behind_a_standing_vehicle() -> None:
    route = np.column_stack([np.arange(0.0, 300.0, 0.5), np.zeros(600)])
    ego, controller = EgoState(10.0, 1.2, 0.08, 7.5), Controller(settings(), 0.2)
    standing = np.array([box(10.0, 1.2), box(90.0, 0.0)])
    for _ in range(90):
        percept = perceive_exactly(route, ego, standing, CAR, 8.0, SIGHT_M)
        ego = advance(CAR, ego, controller.act(percept, ego.speed_mps), 0.2)
    assert abs(ego.y_m) < 0.1 and ego.speed_mps < 0.1
    gap = 88.0 - (ego.x_m + CAR.rear_axle_to_center_m + 0.5 * CAR.length_m)
    assert 1.5 < gap < 4.0


def test_the_controller_cruises_without_a_lead() -> None:
    controller, ego = Controller(settings(), 0.2), EgoState(0.0, 0.0, 0.0, 3.0)
    for _ in range(100):
        ego = advance(CAR, ego, controller.act(Percept(0.0, 0.0, SIGHT_M), ego.speed_mps), 0.2)
    assert ego.speed_mps == pytest.approx(6.5, abs=0.2) and ego.y_m == 0.0


def test_cases_cover_both_streets_and_lights_evenly() -> None:
    cases = list_cases(("a", "b"), range(4), 2)
    assert len(set(cases)) == 8
    assert sorted((case.street, case.light) for case in cases) == sorted(
        2 * [(street, light) for street in (0, 1) for light in ("day", "night")]
    )
    assert cases[0] == Case("a", 0, 0, "day") and cases[1] == Case("b", 0, 1, "day")


def data(count: int = 40) -> PerceptionImages:
    rng = np.random.default_rng(0)
    percepts = np.column_stack(
        [rng.uniform(-1.5, 1.5, count), rng.uniform(-0.2, 0.2, count), rng.uniform(2, 60, count)]
    )
    percepts[:, 2] = percepts[:, 2].clip(max=SIGHT_M)
    light = np.where(np.arange(count) % 2 == 0, "day", "night")
    images = rng.integers(0, 256, (count, 27, 48, 3), np.uint8)
    return PerceptionImages(images, percepts, percepts[:, 1].copy(), np.arange(count) % 4, light)


def test_trainings_select_what_they_say() -> None:
    images, rng = data(), np.random.default_rng(1)
    assert (images[select(Training(lights=("day",)), images, SIGHT_M, rng)].light == "day").all()
    narrow = images[select(Training(offset_m=0.4, yaw_deg=3.0), images, SIGHT_M, rng)]
    assert np.abs(narrow.percepts[:, 0]).max() <= 0.4 and np.abs(narrow.turn_rad).max() <= math.radians(3.0)
    assert set(images[select(Training(streets=1), images, SIGHT_M, rng)].street) == {0}
    assert (images[select(Training(leads=0.0), images, SIGHT_M, rng)].percepts[:, 2] >= 0.95 * SIGHT_M).all()
    assert len(select(Training(images=7), images, SIGHT_M, rng)) == 7
    with pytest.raises(UsageError, match="no image is left"):
        select(Training(lights=("dusk",)), images, SIGHT_M, rng)
    with pytest.raises(UsageError, match="unknown light"):
        Training.declared({"light": ["day"]})


def test_training_repeats_and_declared_policies_are_known() -> None:
    for values in load_declaration().policies.values():
        Training.declared(values)
    values = {"steps": 3, "batch": 4, "learning_rate": 1e-3}
    first, second = (train_network(Training(augmentation="strong"), data(), values, SIGHT_M, 5) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(first.parameters(), second.parameters()))
    images = torch.rand(3, 3, 8, 8)
    assert augment(images, "none", np.random.default_rng(0)) is images
    changed = augment(images, "strong", np.random.default_rng(0))
    assert changed.shape == images.shape and 0.0 <= float(changed.min()) <= float(changed.max()) <= 1.0


def rollouts(score: np.ndarray) -> Rollouts:
    bad = score < 0.5
    return Rollouts(score, bad, ~bad, 3.0 * score, 0.1 * score, np.where(bad, np.nan, score))


def test_statistics_by_hand() -> None:
    assert balanced_accuracy(
        np.array([True, True, False, False, False]), np.array([True, False, False, False, True])
    ) == (pytest.approx(0.5 * (1 / 2 + 2 / 3)))
    assert math.isnan(balanced_accuracy(np.array([True, True]), np.array([True, False])))
    score = np.linspace(0.0, 1.0, 24).reshape(4, 3, 2)
    same = compare(rollouts(score), rollouts(score))
    assert (same["tau"], same["collision"], same["ttc_abs_s"]) == (1.0, 1.0, 0.0)
    # The order of two neighbours of four is changed: five of six pairs agree.
    swapped = score[[1, 0, 2, 3]]
    assert compare(rollouts(score), rollouts(swapped))["tau"] == pytest.approx(4 / 6)
    shifted = compare(rollouts(score), Rollouts(**{**vars(rollouts(score)), "least_ttc_s": 3.0 * score + 0.2}))
    assert (shifted["ttc_s"], shifted["tau"]) == pytest.approx((0.2, 1.0))
    ends = intervals(rollouts(score), rollouts(swapped), 50, 0.95)
    assert ends["tau"][0] - 1e-9 <= 4 / 6 <= ends["tau"][1] + 1e-9
