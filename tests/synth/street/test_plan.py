"""Tests of plans: positions of lots and spots, reproducibility."""

import itertools

import numpy as np
import pytest
import shapely

from mirror.errors import UsageError
from mirror.synth.roads.schemes import EDGE, SCHEMES
from mirror.synth.street.plan import plan_scene
from tests.synth.roads.scenes import KINDS, plan, roi


@pytest.mark.parametrize("kind", KINDS)
def test_lots_do_not_overlap_each_other_or_roads(kind):
    scene = plan(kind)
    outlines = np.array([lot.outline() for lot in scene.lots])
    tree = shapely.STRtree(outlines)
    first, second = tree.query(outlines, predicate="intersects")
    shared = [shapely.intersection(outlines[a], outlines[b]).area for a, b in zip(first, second) if a < b]
    assert max(shared, default=0.0) < 1e-9
    assert shapely.intersection(scene.roads, shapely.union_all(outlines)).area < 1e-6


@pytest.mark.parametrize("kind", KINDS)
def test_fronts_of_lots_face_a_street(kind):
    scene = plan(kind)
    for lot in scene.lots:
        away = np.array([-np.sin(lot.yaw_rad), np.cos(lot.yaw_rad)])
        nearest = min(abs(street.line.locate(lot.origin[None, :2])[1][0]) for street in scene.streets)
        stations = [street.line.locate(lot.origin[None, :2] + 2.0 * away)[1][0] for street in scene.streets]
        assert min(abs(offset) for offset in stations) > nearest - 1e-6 or len(scene.streets) > 1
        assert float(scene.height_m(*lot.origin[:2])) == pytest.approx(lot.origin[2], abs=1e-9)
        assert lot.length_m > 8.0 and lot.depth_m > 6.0


def test_an_urban_street_is_built_up_on_both_sides():
    scene = plan("urban", 200.0)
    assert len(scene.lots) > 150
    assert {"front", "corner", "yard"} == {lot.kind for lot in scene.lots}
    main = scene.streets[0]
    lot_area = 0.0
    for lot in scene.lots:
        _, offset = main.line.locate(lot.origin[None, :2])
        if abs(offset[0]) < main.section.half_m + main.section.pavement_m + 3.0:
            lot_area += lot.length_m
    assert lot_area > 0.6 * 2 * (main.line.last_m - main.line.first_m)


@pytest.mark.parametrize("kind", KINDS)
def test_spots_are_beside_the_carriageway_and_face_the_right_way(kind):
    scene = plan(kind)
    places = shapely.points([spot.place[:2] for spot in scene.spots])
    assert shapely.distance(scene.carriageways, places).min() > 0.3
    kinds = {spot.kind for spot in scene.spots}
    assert {"urban": {"lamp", "tree", "signal", "yield", "sign", "furniture"}, "campus": {"lamp", "tree", "crosswalk"},
            "rural": {"tree", "pole", "yield"}, "highway": {"gantry", "tree"}}[kind] <= kinds  # fmt: skip
    for spot in scene.spots:
        towards = spot.place[:2] + spot.reach_m * np.array([np.cos(spot.yaw_rad), np.sin(spot.yaw_rad)])
        if spot.kind != "gantry":
            assert shapely.contains_xy(scene.carriageways, *towards), spot
        # Traffic on this side drives against the facing direction.
        near = [
            lane for lane in scene.network.lanes.values()
            if lane.use == "drive" and np.hypot(*(lane.line[:, :2] - towards).T).min() < 1.0
        ]  # fmt: skip
        if spot.kind in ("signal", "yield", "crosswalk"):
            assert near
            for lane in near:
                k = min(int(np.argmin(np.hypot(*(lane.line[:, :2] - towards).T))), len(lane.line) - 2)
                step = lane.line[k + 1, :2] - lane.line[k, :2]
                facing = np.array([np.cos(spot.facing_rad), np.sin(spot.facing_rad)])
                assert step @ facing < -0.9 * np.hypot(*step)
    if kind == "urban":
        assert {spot.group for spot in scene.spots if spot.kind == "signal"} == {0, 1}


def test_guard_rails_run_along_the_motorway_and_leave_its_slip_roads_open():
    scene = plan("highway")
    assert len(scene.rails) >= 5
    for rail in scene.rails:
        line = shapely.LineString(rail.line)
        assert shapely.distance(scene.carriageways, line) > 0.2


@pytest.mark.parametrize("kind", KINDS)
def test_free_land_is_clear_of_roads_and_lots(kind):
    scene = plan(kind)
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-150, 150, (2, 400))
    free = scene.is_free(x, y, 3.0)
    everything = shapely.union_all([scene.roads, scene.lot_area]).buffer(3.0, quad_segs=32)
    held = shapely.contains_xy(everything, x, y)
    assert (free == ~held).mean() > 0.995
    assert free.any() and not free.all()


@pytest.mark.parametrize("kind", ["urban", "campus", "rural"])
def test_one_street_passes_the_edge_of_the_roi(kind):
    scene = plan(kind)
    edge = next(street for street in scene.streets if street.name == "edge")
    distance = np.hypot(*edge.line.points.T)
    assert distance.min() == pytest.approx(EDGE * 120.0, abs=0.3)
    ends = np.hypot(*edge.line.at(np.array([edge.line.first_m, edge.line.last_m])).T)
    assert (ends > 180.0).all()


@pytest.mark.parametrize("kind", KINDS)
def test_streets_continue_outside_the_roi(kind):
    for street in plan(kind).streets:
        ends = np.hypot(*street.line.at(np.array([street.line.first_m, street.line.last_m])).T)
        assert ends.max() > 200.0
        bends = np.abs(np.gradient(street.line.headings, street.line.stations))
        assert bends.max() < 1 / 25.0


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(4))
def test_streets_meet_only_at_crossings(kind, seed):
    for radius in (55.0, 120.0, 200.0):
        scheme = SCHEMES[kind](radius, 1.0, np.random.default_rng(seed))
        bands = {
            street.name: shapely.LineString(street.line.points[::10]).buffer(
                street.section.half_m + street.section.pavement_m, cap_style="flat"
            )
            for street in scheme.streets
        }
        met = {frozenset(arm.street.name for arm in crossing.arms) for crossing in scheme.crossings}
        for first, second in itertools.combinations(bands, 2):
            shared = shapely.intersection(bands[first], bands[second])
            count = len(shapely.get_parts(shared)) if not shared.is_empty else 0
            assert count == ({first, second} in met), (first, second, radius)


def test_plans_repeat_with_the_seed_and_differ_without():
    first, again, other = (plan_scene(roi("urban", 62.0), 10.0, seed) for seed in (1, 1, 2))
    assert first.ground.faces.tobytes() == again.ground.faces.tobytes()
    assert first.ground.corners.tobytes() == again.ground.corners.tobytes()
    assert [lot.origin.tobytes() for lot in first.lots] == [lot.origin.tobytes() for lot in again.lots]
    assert [spot.place.tobytes() for spot in first.spots] == [spot.place.tobytes() for spot in again.spots]
    assert {name: lane.line.tobytes() for name, lane in first.network.lanes.items()} == {
        name: lane.line.tobytes() for name, lane in again.network.lanes.items()
    }
    assert first.ground.corners.tobytes() != other.ground.corners.tobytes()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [0, 7])
def test_small_scenes_can_be_planned(kind, seed):
    scene = plan_scene(roi(kind, 50.0), -61.0, seed)
    assert len(scene.network.lanes) >= 6
    assert len(scene.lots) > 3


@pytest.mark.parametrize("radius", [1.0, 49.0, 5000.0])
def test_radii_out_of_range_are_refused(radius):
    with pytest.raises(UsageError, match="ROI"):
        plan_scene(roi("urban", radius), 0.0, 0)
