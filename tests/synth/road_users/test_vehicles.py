"""Tests of vehicles: closed, planar, on the ground, within their boxes, symmetric, with readable plates."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mirror.arrays import Float64
from mirror.synth.model import Label, Material, Model
from mirror.synth.road_users import buses, cars, trucks, two_wheelers, vans
from mirror.synth.road_users.body import Body
from mirror.synth.road_users.coachwork.fittings import draw_car_paint
from mirror.synth.road_users.ego import EgoKind, Measures, make_ego_body
from mirror.synth.textures.catalogue import PLATES

Maker = Callable[[np.random.Generator], Body]

_CARS: list[Maker] = [
    cars.build_hatchback,
    cars.build_saloon,
    cars.build_estate,
    cars.build_suv,
    cars.build_city_car,
    cars.build_coupe,
    cars.build_pickup,
    cars.build_taxi,
    vans.build_delivery_van,
    vans.build_compact_van,
    vans.build_minibus,
]
_LARGE: list[Maker] = [
    buses.build_city_bus,
    buses.build_coach,
    trucks.build_box_truck,
    trucks.build_tipper,
    trucks.build_articulated_truck,
]
_TWO: list[Maker] = [
    two_wheelers.build_roadster,
    two_wheelers.build_scooter,
    two_wheelers.build_city_bicycle,
    two_wheelers.build_cargo_bike,
]
_SEEDS = range(6)

every = pytest.mark.parametrize("make", [*_CARS, *_LARGE, *_TWO], ids=lambda make: make.__name__)
four_wheeled = pytest.mark.parametrize("make", [*_CARS, *_LARGE], ids=lambda make: make.__name__)


def _corners(model: Model, index: int | np.integer[Any]) -> Float64:
    one = model.faces[index]
    return model.corners[one["first"] : one["first"] + one["count"]]


def _convex(corners: Float64, normal: Float64) -> bool:
    edges = np.roll(corners, -1, axis=0) - corners
    turns = np.cross(edges, np.roll(edges, -1, axis=0)) @ normal
    return bool((turns > -1e-9).all())


@every
def test_model_fills_its_box(make: Maker) -> None:
    for seed in _SEEDS:
        body = make(np.random.default_rng(seed))
        low, high = body.model.bounds()
        length, width, height = body.size_m
        assert_allclose([low[0], high[0]], [-0.5 * length, 0.5 * length], atol=1e-9)
        assert max(-low[1], high[1]) == pytest.approx(0.5 * width, abs=1e-9)
        assert high[2] == pytest.approx(height, abs=1e-9)
        assert low[2] > -1e-3


@every
def test_faces_are_planar_and_convex(make: Maker) -> None:
    for seed in _SEEDS:
        model = make(np.random.default_rng(seed)).model
        for index, one in enumerate(model.faces):
            corners = _corners(model, index)
            assert_allclose(corners @ one["normal"], one["offset"], atol=1e-9)
            assert _convex(corners, one["normal"]), f"face {index}: {corners.tolist()}"


@every
def test_same_seed_same_vehicle(make: Maker) -> None:
    one, other = make(np.random.default_rng(7)), make(np.random.default_rng(7))
    assert one.size_m == other.size_m
    assert one.model.faces.tobytes() == other.model.faces.tobytes()
    assert one.model.corners.tobytes() == other.model.corners.tobytes()
    assert one.model.rounds.tobytes() == other.model.rounds.tobytes()


@pytest.mark.parametrize("make", _CARS, ids=lambda make: make.__name__)
def test_cars_have_few_primitives(make: Maker) -> None:
    assert max(len(make(np.random.default_rng(seed)).model) for seed in range(20)) <= 90


@pytest.mark.parametrize("make", [*_LARGE, *_TWO], ids=lambda make: make.__name__)
def test_other_vehicles_have_few_primitives(make: Maker) -> None:
    assert max(len(make(np.random.default_rng(seed)).model) for seed in range(20)) <= 150


@four_wheeled
def test_wheels_stand_on_the_ground(make: Maker) -> None:
    model = make(np.random.default_rng(3)).model
    rims = [index for index, one in enumerate(model.faces) if one["material"] == Material.RIM]
    assert len(rims) >= 4
    for index in rims:
        corners = _corners(model, index)
        assert corners[:, 2].min() == pytest.approx(0.0, abs=1e-9)
        # The rim of a wheel faces outwards.
        assert np.sign(corners[0, 1]) == model.faces[index]["normal"][1]


@four_wheeled
def test_plates_are_upright_and_face_out(make: Maker) -> None:
    for seed in _SEEDS:
        body = make(np.random.default_rng(seed))
        faces = body.model.faces
        plates = faces[(faces["material"] == Material.IMAGE) & np.isin(faces["image"], list(PLATES))]
        assert_array_equal(np.sort(plates["normal"][:, 0]), [-1.0, 1.0])
        assert plates["image"][0] == plates["image"][1]
        for one in plates:
            assert_allclose(2.0 * one["half"], [0.52, 0.11], atol=1e-9)
            assert_allclose(one["v_axis"], [0.0, 0.0, 1.0], atol=1e-12)
            assert_allclose(one["u_axis"], [0.0, one["normal"][0], 0.0], atol=1e-12)


@four_wheeled
def test_plates_are_not_hidden(make: Maker) -> None:
    """Rays from 2 m in front of the plate's corners and middle hit the plate first."""
    for seed in (0, 1):
        model = make(np.random.default_rng(seed)).model
        for index in np.flatnonzero(np.isin(model.faces["image"], list(PLATES))):
            plate = _corners(model, index)
            middle = plate.mean(axis=0)
            for target in (middle, *(middle + 0.9 * (plate - middle))):
                start = target + 2.0 * model.faces[index]["normal"]
                assert _first(model, start, target - start) == index


def _first(model: Model, start: Float64, way: Float64) -> int:
    nearest, found = np.inf, -1
    for index, one in enumerate(model.faces):
        along = one["normal"] @ way
        if along >= 0.0 and not one["two_sided"]:
            continue
        if abs(along) < 1e-12:
            continue
        t = (one["offset"] - one["normal"] @ start) / along
        if not 1e-9 < t < nearest:
            continue
        corners, at = _corners(model, index), start + t * way
        sides = np.cross(np.roll(corners, -1, axis=0) - corners, at - corners) @ one["normal"]
        if (sides >= 0.0).all():
            nearest, found = t, index
    return found


@pytest.mark.parametrize("make", [*_CARS, *_LARGE], ids=lambda make: make.__name__)
def test_bodies_have_no_holes(make: Maker) -> None:
    """Horizontal rays at bonnet height and above, from all directions, hit an outer side first."""
    rng = np.random.default_rng(1)
    body = make(np.random.default_rng(2))
    length, width, _height = body.size_m
    for _ in range(30):
        angle = rng.uniform(0.0, 2.0 * np.pi)
        target = np.array([rng.uniform(-0.36, 0.36) * length, rng.uniform(-0.28, 0.28) * width, 0.62])
        start = target + 12.0 * np.array([np.cos(angle), np.sin(angle), 0.02])
        found = _first(body.model, start, target - start)
        assert found >= 0, f"from {start.tolist()} to {target.tolist()}"


def _mirrored(model: Model, name: str) -> set[tuple[float, ...]]:
    values = np.round(model.faces[name] * (1.0, -1.0, 1.0), 9) + 0.0
    return {tuple(row) for row in values.tolist()}


@pytest.mark.parametrize("make", _CARS, ids=lambda make: make.__name__)
def test_bodies_are_symmetric(make: Maker) -> None:
    model = make(np.random.default_rng(4)).model
    there = {tuple(row) for row in (np.round(model.faces["normal"], 9) + 0.0).tolist()}
    assert _mirrored(model, "normal") == there
    places = {tuple(row) for row in (np.round(model.corners, 9) + 0.0).tolist()}
    assert {tuple(row) for row in (np.round(model.corners * (1.0, -1.0, 1.0), 9) + 0.0).tolist()} == places


@pytest.mark.parametrize("make", [*_CARS, *_LARGE], ids=lambda make: make.__name__)
def test_lamps_are_pairs_at_the_front_and_back(make: Maker) -> None:
    body = make(np.random.default_rng(5))
    faces, half = body.model.faces, 0.5 * body.size_m[0]
    for material, sign in ((Material.HEADLIGHT, 1.0), (Material.TAIL_LIGHT, -1.0)):
        lamps = np.flatnonzero(faces["material"] == material)
        assert len(lamps) >= 2
        assert len(lamps) % 2 == 0
        for index in lamps:
            assert sign * _corners(body.model, index)[:, 0].mean() > half - 0.75
            assert sign * faces["normal"][index, 0] > 0.3


def test_every_body_has_its_category_and_label() -> None:
    classes = {
        "car": (Label.CAR, [cars.build_car]),
        "van": (Label.VAN, [vans.build_van]),
        "truck": (Label.TRUCK, [trucks.build_truck]),
        "bus": (Label.BUS, [buses.build_bus]),
    }
    for category, (label, makers) in classes.items():
        for make in makers:
            for seed in _SEEDS:
                body = make(np.random.default_rng(seed))
                assert body.category == category
                assert set(body.model.faces["label"]) == {label}


def test_two_wheelers_are_ridden_or_parked() -> None:
    for make in (two_wheelers.build_city_bicycle, two_wheelers.build_cargo_bike):
        ridden, parked = make(np.random.default_rng(1)), make(np.random.default_rng(1), ridden=False)
        assert (ridden.category, parked.category) == ("cyclist", "bicycle")
        assert Label.RIDER in ridden.model.rounds["label"]
        assert Label.RIDER not in parked.model.rounds["label"]
        assert parked.size_m[2] < 1.2 < ridden.size_m[2]


def test_paints_have_realistic_shares() -> None:
    rng = np.random.default_rng(0)
    colours = np.array([draw_car_paint(rng).colour for _ in range(600)])
    grey = colours.max(axis=1) - colours.min(axis=1) < 0.05
    assert 0.72 < grey.mean() < 0.92
    assert (colours > 0.0).all()
    assert (colours < 0.8).all()


@pytest.mark.parametrize("kind", ["saloon", "hatchback", "estate", "suv", "van", "truck", "bus"])
def test_ego_body_is_placed_about_the_rear_axle(kind: EgoKind) -> None:
    measures = {
        "van": Measures(5.53, 2.02, 2.36, 3.40, 1.05), "truck": Measures(8.40, 2.50, 3.40, 4.90, 2.05),
        "bus": Measures(12.00, 2.55, 3.10, 5.90, 3.40),
    }.get(kind, Measures(4.60, 1.85, 1.50, 2.75, 0.95))  # fmt: skip
    model = make_ego_body(kind, measures)
    low, high = model.bounds()
    assert_allclose([low[0], high[0]], [-measures.rear, measures.length - measures.rear], atol=0.02)
    assert_allclose([low[1], high[1]], [-0.5 * measures.width, 0.5 * measures.width], atol=0.05)
    assert high[2] == pytest.approx(measures.height, abs=0.02)
    assert set(model.faces["label"]) == {Label.EGO}
