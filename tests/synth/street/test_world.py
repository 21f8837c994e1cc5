"""Tests of worlds: houses on their lots, furniture beside the carriageways, lights by group."""

from __future__ import annotations

from functools import cache
from typing import Literal

import numpy as np
import pytest
import shapely

from mirror.schema.documents import Roi
from mirror.synth.model import Label, Material
from mirror.synth.street.world import World, build_world
from tests.synth.street.rays import corners_of

Kind = Literal["urban", "highway", "rural", "campus"]
KINDS: tuple[Kind, ...] = ("urban", "highway", "rural", "campus")
GROUND = (Label.ROAD, Label.PAVEMENT, Label.TERRAIN)


@cache
def world(kind: Kind) -> World:
    roi = Roi(scene_id="a", longitude_deg=8.0, latitude_deg=50.0, radius_m=200.0, scene_type=kind)
    return build_world(roi, 20.0, 1)


def middles(scene: World) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    count = scene.model.faces["count"]
    return np.add.reduceat(corners_of(scene.model), np.cumsum(count) - count) / count[:, None]


def test_urban_has_thousands_of_primitives() -> None:
    scene = world("urban")
    faces, places = scene.model.faces, middles(scene)
    counted = ~np.isin(faces["label"], GROUND) & (faces["material"] != Material.LEAVES)
    counted &= np.hypot(places[:, 0], places[:, 1]) < 200.0
    assert counted.sum() >= 3000
    assert len(scene.lamps) > 40
    assert len(scene.parked) > 20


@pytest.mark.parametrize("kind", KINDS)
def test_carriageways_are_free_of_objects(kind: Kind) -> None:
    scene = world(kind)
    corners, faces = corners_of(scene.model), scene.model.faces
    label = np.repeat(faces["label"], faces["count"])
    ground = np.isin(label, GROUND)
    near = np.hypot(corners[:, 0], corners[:, 1]) < 220.0
    places = corners[~ground & near]
    above = places[:, 2] - scene.height_m(places[:, 0], places[:, 1])
    low = places[(above > 0.05) & (above < 3.5)]
    on_road = shapely.contains_xy(scene.plan.carriageways.buffer(-0.25), low[:, 0], low[:, 1])
    assert on_road.sum() == 0


@pytest.mark.parametrize("kind", KINDS)
def test_houses_stand_on_the_ground(kind: Kind) -> None:
    scene = world(kind)
    for lot in scene.plan.lots[:25]:
        x, y = lot.origin[:2]
        assert abs(float(scene.height_m(x, y)) - lot.origin[2]) < 0.5


@pytest.mark.parametrize("kind", KINDS)
def test_the_horizon_is_closed_around_the_middle(kind: Kind) -> None:
    """In nearly every direction a distant object rises above eye height."""
    scene = world(kind)
    faces, places = scene.model.faces, middles(scene)
    far = (np.hypot(places[:, 0], places[:, 1]) > 220.0) & ~np.isin(faces["label"], GROUND)
    bearings = np.sort(np.arctan2(places[far, 1], places[far, 0]))
    assert np.diff(bearings).max() < 0.15


def test_signal_lamps_are_lit_by_group_and_time() -> None:
    scene = world("urban")
    network = scene.network
    assert len(scene.lights) >= 2
    assert set(scene.lights) <= set(range(len(network.green_s)))
    signals = set(np.flatnonzero(scene.model.faces["material"] == Material.SIGNAL).tolist())
    indices = {
        int(n) for light in scene.lights.values() for part in (light.red, light.amber, light.green) for n in part
    }
    assert indices == signals
    for group, light in scene.lights.items():
        start, end = network.green_s[group]
        for time, expected in (
            (start + 0.1, light.green),
            (end - 0.1, light.green),
            (end + 1.0, light.amber),
            (end + 4.0, light.red),
            (start + network.cycle_s + 0.5, light.green),
        ):
            burning = set(scene.find_lit_lamps(float(time)).tolist())
            own = burning & {int(n) for part in (light.red, light.amber, light.green) for n in part}
            assert own == set(expected.tolist())
    assert (scene.model.faces["lights"] == 0).all()


def test_signal_lamps_precede_the_leaves_among_the_faces() -> None:
    scene = world("urban")
    first = np.flatnonzero(scene.model.faces["material"] == Material.LEAVES)[0]
    assert max(int(light.red.max()) for light in scene.lights.values()) < first


def test_parked_vehicles_stand_on_parking_lanes() -> None:
    scene = world("urban")
    for user in scene.parked:
        place = user.motion.at(3.0)
        assert place == user.motion.at(0.0)
        assert abs(float(scene.height_m(place.x_m, place.y_m)) - place.z_m) < 0.08
        assert abs(place.pitch_rad) < 0.08
        assert abs(place.roll_rad) < 0.08
    places = np.array([(user.motion.at(0.0).x_m, user.motion.at(0.0).y_m) for user in scene.parked])
    apart = np.linalg.norm(places[:, None] - places[None], axis=2) + 100.0 * np.eye(len(places))
    assert apart.min() > 4.8


def test_same_seed_same_world() -> None:
    roi = Roi(scene_id="a", longitude_deg=8.0, latitude_deg=50.0, radius_m=90.0, scene_type="rural")
    one, other = build_world(roi, 5.0, 9), build_world(roi, 5.0, 9)
    assert one.model.faces.tobytes() == other.model.faces.tobytes()
    assert one.model.corners.tobytes() == other.model.corners.tobytes()
    assert one.model.rounds.tobytes() == other.model.rounds.tobytes()
    assert build_world(roi, 5.0, 10).model.corners.shape != one.model.corners.shape
