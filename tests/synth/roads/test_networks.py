"""Tests of lanes: positions, connections, right of way."""

import math

import numpy as np
import pytest
import shapely

from tests.synth.roads.scenes import KINDS, plan

WHEELS = ("drive", "turn", "cycle")


def heading(line, end):
    step = line[1, :2] - line[0, :2] if end == 0 else line[-1, :2] - line[-2, :2]
    return math.atan2(step[1], step[0])


@pytest.mark.parametrize("kind", KINDS)
def test_lanes_join_within_a_centimetre_and_two_degrees(kind):
    lanes = plan(kind).network.lanes
    joined = 0
    for lane in lanes.values():
        for name in lane.successors:
            after = lanes[name]
            assert np.hypot(*(after.line[0, :2] - lane.line[-1, :2])) < 0.01, (lane.lane_id, name)
            if lane.use in WHEELS and after.use in WHEELS:
                turn = heading(after.line, 0) - heading(lane.line, -1)
                turn = (turn + math.pi) % (2 * math.pi) - math.pi
                assert abs(turn) < math.radians(2.0), (lane.lane_id, name, math.degrees(turn))
                joined += 1
    assert joined > 8


@pytest.mark.parametrize("kind", KINDS)
def test_lanes_lie_on_the_ground_in_steps_of_a_metre(kind):
    scene = plan(kind)
    for lane in scene.network.lanes.values():
        assert np.diff(lane.along_m).max() <= 1.0, lane.lane_id
        assert np.diff(lane.along_m).min() > 0.05, lane.lane_id
        np.testing.assert_allclose(lane.line[:, 2], scene.height_m(*lane.line[:, :2].T), atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_vehicle_lanes_are_on_carriageways_and_walking_lanes_on_pavements(kind):
    scene = plan(kind)
    inner = scene.carriageways.buffer(-0.5)
    shapely.prepare(inner)
    pavement = shapely.difference(scene.roads, scene.carriageways).buffer(0.01)
    for lane in scene.network.lanes.values():
        line = shapely.LineString(lane.line[3:-3, :2]) if len(lane.line) > 8 else shapely.LineString(lane.line[:, :2])
        if lane.use in (*WHEELS, "park"):
            assert shapely.contains(inner, line), lane.lane_id
        elif lane.use == "walk":
            assert shapely.contains(pavement, line), lane.lane_id


@pytest.mark.parametrize("kind", KINDS)
def test_traffic_keeps_right(kind):
    scene = plan(kind)
    for street in scene.streets:
        for lane in scene.network.lanes.values():
            if lane.use == "drive" and lane.lane_id.startswith(street.name + ".") and len(street.section.tracks) > 1:
                station, offset = street.line.locate(lane.line[:, :2])
                assert (offset * (station[-1] - station[0]) < 0.0).all(), lane.lane_id


@pytest.mark.parametrize("kind", KINDS)
def test_named_lanes_exist_and_inner_lanes_have_successors(kind):
    scene = plan(kind)
    lanes = scene.network.lanes
    for name, lane in lanes.items():
        assert lane.lane_id == name
        for other in (*lane.successors, *lane.yields_to, *(n for n in (lane.left, lane.right) if n)):
            assert other in lanes
        if lane.left:
            assert lanes[lane.left].right == name
        if lane.stop_m is not None:
            assert 0.0 <= lane.stop_m < lane.length_m
        if lane.signal is not None:
            assert lane.signal < len(scene.network.green_s)
        if lane.use in WHEELS and np.hypot(*lane.line[-1, :2]) < 120.0:
            assert lane.successors, name


def test_urban_crossings_have_lights_turns_and_zebras():
    lanes = plan("urban").network.lanes
    arriving = [lane for lane in lanes.values() if lane.use == "drive" and lane.signal is not None]
    assert len(arriving) == 4
    for lane in arriving:
        turns = [lanes[name] for name in lane.successors]
        assert len(turns) == 3
        angles = sorted(
            (heading(turn.line, -1) - heading(turn.line, 0) + math.pi) % (2 * math.pi) - math.pi for turn in turns
        )
        np.testing.assert_allclose(angles, [-math.pi / 2, 0.0, math.pi / 2], atol=0.25)
        assert lane.stop_m is not None and 3.0 < lane.length_m - lane.stop_m < 8.0
    crosses = [lane for lane in lanes.values() if lane.use == "cross" and lane.signal is not None]
    assert len(crosses) == 8 and {lane.signal for lane in crosses} == {2, 3}
    assert {lane.use for lane in lanes.values()} == {"drive", "turn", "park", "cycle", "walk", "cross"}


def test_green_times_of_conflicting_groups_do_not_overlap():
    network = plan("urban").network
    main, cross, over_main, over_cross = network.green_s
    assert main[1] + 3.0 <= cross[0] and cross[1] + 3.0 <= network.cycle_s
    # Pedestrians cross the main street while its traffic waits.
    assert cross[0] <= over_main[0] and over_main[1] <= cross[1]
    assert main[0] <= over_cross[0] and over_cross[1] <= main[1]


def test_left_turns_and_minor_streets_yield():
    lanes = plan("urban").network.lanes
    left = next(
        lane for name, lane in lanes.items()
        if name.startswith("signals.main.") and "drive" in name and ">cross" in name and turn(lane) > 1.0
    )  # fmt: skip
    waits = [lanes[name] for name in left.yields_to]
    assert any(abs(turn(lane)) < 0.3 and lane.lane_id.startswith("signals.main") for lane in waits)
    assert any(lane.use == "cross" for lane in waits)
    straight = [lane for name, lane in lanes.items() if name.startswith("corner.main.") and abs(turn(lane)) < 0.3]
    assert straight and not any(lane.yields_to for lane in straight)
    minor = [lane for name, lane in lanes.items() if name.startswith("corner.edge.") and abs(turn(lane)) < 0.3]
    for lane in minor:
        assert {name for name in lane.yields_to if name.startswith("corner.main")}


def turn(lane):
    return (heading(lane.line, -1) - heading(lane.line, 0) + math.pi) % (2 * math.pi) - math.pi


def test_the_motorway_has_exit_and_entry_lanes():
    lanes = plan("highway").network.lanes
    before = next(lane for lane in lanes.values() if any(name.startswith("exit.") for name in lane.successors))
    assert before.lane_id.endswith("drive1+") and len(before.successors) == 2
    entry = next(lane for lane in lanes.values() if lane.lane_id.startswith("entry."))
    assert entry.successors and entry.yields_to
    assert lanes[entry.yields_to[0]].successors == entry.successors
    middle = next(lane for lane in lanes.values() if lane.lane_id == "main.1.drive2+")
    assert middle.left == "main.1.drive3+" and middle.right == "main.1.drive1+"
