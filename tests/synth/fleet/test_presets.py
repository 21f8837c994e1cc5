"""Tests of the presets: numbers of scenes, variety, and feasible recipes."""

import math

import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.geometry import matrix_from_quaternion
from mirror.synth.driving.routes import ROUTES
from mirror.synth.fleet import PRESETS
from mirror.synth.fleet.drives import make_drive, make_drives
from mirror.synth.fleet.presets import cycle_recipes
from mirror.synth.rigs import VEHICLE_TYPES


def recipes(name: str):
    preset = PRESETS[name]
    return [recipe for site in preset.sites for recipe in cycle_recipes(site, preset.traversals)]


def test_paper_preset_has_ten_scenes_six_cities_seven_vehicle_types() -> None:
    rois = [site.roi for site in PRESETS["paper"].sites]
    assert len({roi.scene_id for roi in rois}) == 10
    assert len({roi.city for roi in rois}) == 6
    assert {roi.scene_type for roi in rois} == {"urban", "highway", "rural", "campus"}
    assert {recipe.vehicle for recipe in recipes("paper")} == set(VEHICLE_TYPES)
    area = sum(math.pi * roi.radius_m**2 for roi in rois) * 1e-6
    assert round(area, 3) == 1.257 and round(area / len(rois), 3) == 0.126
    assert PRESETS["paper"].on_demand


def test_benchmark_preset_has_four_scene_kinds_in_six_conditions() -> None:
    preset = PRESETS["benchmark"]
    assert [site.roi.scene_type for site in preset.sites] == ["urban", "highway", "rural", "campus"]
    assert len(recipes("benchmark")) == 32
    for site in preset.sites:
        mine = cycle_recipes(site, preset.traversals)
        assert len({(one.light, one.weather) for one in mine}) == 6
        assert {one.route for one in mine} >= {"along", "back"}
        assert len({one.vehicle for one in mine}) == 7
        assert len({one.date for one in mine}) >= 6


@pytest.mark.parametrize("name", PRESETS)
def test_every_recipe_names_a_known_route_and_vehicle(name: str) -> None:
    preset = PRESETS[name]
    for site in preset.sites:
        for recipe in (*site.recipes, *site.others):
            assert recipe.route in ROUTES
            assert recipe.vehicle in VEHICLE_TYPES
        others = [one.route for one in site.others]
        assert len(set(others)) == len(others)
    scenes = [site.roi for site in preset.sites]
    places = np.array([(roi.longitude_deg, roi.latitude_deg) for roi in scenes])
    apart = np.abs(places[:, None] - places).max(axis=2)[~np.eye(len(places), dtype=bool)]
    assert not len(apart) or apart.min() > 0.01


def test_a_drive_does_not_depend_on_the_number_of_drives() -> None:
    few, many = make_drives("demo", 3, traversals=2)[1], make_drives("demo", 3, traversals=9)[1]
    by_id = {drive.drive_id: drive for drive in many}
    assert len(by_id) == len(many)
    for drive in few:
        again = by_id[drive.drive_id]
        assert (again.condition, again.seed, again.recipe) == (drive.condition, drive.seed, drive.recipe)
        assert again.vehicle == drive.vehicle
    named = make_drive("demo", 3, "guangzhou-urban-09")
    assert (named.condition, named.seed) == (by_id[named.drive_id].condition, by_id[named.drive_id].seed)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_calibration_preset_has_a_bend_at_the_rate_that_tracking_needs(seed: int) -> None:
    preset, (drive,) = make_drives("calibration", seed)
    time_s = np.arange(0.0, drive.truth.duration_s, 1.0 / preset.image_hz)
    poses = drive.truth.poses(time_s)
    inside = np.linalg.norm(poses.translation[:, :2], axis=1) <= drive.roi.radius_m
    forward = matrix_from_quaternion(poses.rotation)[inside][:, :2, 0]
    way_m = np.linalg.norm(np.diff(poses.translation[inside], axis=0), axis=1)
    # The figures of docs/calibration.md hold for images 3.5 m or 12 degrees apart, and the check for 20 of them.
    assert inside.sum() >= 15 and way_m.sum() >= 60.0 and way_m.max() < 1.5 * 3.5
    cosines = np.clip((forward[:-1] * forward[1:]).sum(axis=1) / np.linalg.norm(forward[0]) ** 2, -1.0, 1.0)
    assert np.degrees(np.arccos(cosines)).max() < 1.5 * 12.0
    total = np.degrees(np.arccos(np.clip(forward[0] @ forward[-1], -1.0, 1.0)))
    assert total > 60.0


def test_repeated_recipes_have_different_dates() -> None:
    drives = make_drives("demo", 0, scenes=1, traversals=16)[1][:16]
    days = (drives[7].condition.start_ns - drives[0].condition.start_ns) / 86.4e12
    assert drives[7].recipe == drives[0].recipe
    assert days == pytest.approx(9.0, abs=0.01)
    assert len({drive.seed for drive in drives}) == 16


def test_vehicle_ids_of_a_scene_are_unique() -> None:
    seen = {}
    for drive in make_drives("benchmark", 0)[1]:
        assert seen.setdefault(drive.vehicle.vehicle_id, (drive.vehicle.kind.name, drive.roi.scene_id)) == (
            drive.vehicle.kind.name,
            drive.roi.scene_id,
        )
    assert len(seen) == 28


@pytest.mark.parametrize("drive_id", ["nowhere-01", "guangzhou-urban-corner", "guangzhou-urban-00", "guangzhou-urban"])
def test_unknown_drive_ids_are_refused(drive_id: str) -> None:
    with pytest.raises(UsageError, match="no drive"):
        make_drive("demo", 0, drive_id)
