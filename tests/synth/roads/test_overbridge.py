"""Tests of the bridge over the motorway: height, clearance from the lanes, position."""

import numpy as np
import pytest
import shapely

from mirror.synth.model import FACE, Label, Model
from mirror.synth.roads.overbridge import build_overbridge
from tests.synth.roads.scenes import plan


@pytest.fixture(scope="module")
def bridge() -> Model:
    scene = plan("highway")
    return build_overbridge(scene.streets[0], -9.6, float(scene.height_m(*scene.streets[0].line.at(-9.6)))).model


def test_normals_point_out_of_the_bridge(bridge):
    for face in bridge.faces[bridge.faces["label"] != Label.WALL]:
        if face["label"] == Label.TERRAIN or face["label"] == Label.ROAD:
            assert face["normal"][2] > 0.3
    assert bridge.faces.dtype == FACE


def test_vehicles_fit_under_the_bridge(bridge):
    scene = plan("highway")
    lanes = [lane for lane in scene.network.lanes.values() if lane.lane_id.startswith("main.")]
    for face in bridge.faces:
        corners = bridge.corners[face["first"] : face["first"] + face["count"]]
        outline = shapely.convex_hull(shapely.multipoints(corners[:, :2]))
        for lane in lanes:
            near = shapely.distance(outline, shapely.points(lane.line[:, :2])) < 0.5 * lane.width_m
            if not near.any():
                continue
            if face["normal"][2] < -0.99:
                # The underside is high enough.
                assert corners[:, 2].min() - lane.line[near, 2].max() > 4.5
            else:
                # Slopes continue below the ground; the other faces are above it.
                plane = (face["offset"] - lane.line[near][:, :2] @ face["normal"][:2]) / max(face["normal"][2], 1e-9)
                over = corners[:, 2].min() - lane.line[near, 2].max() > 4.5
                assert over or (plane < lane.line[near, 2]).all()


def test_no_lot_or_spot_is_in_the_bridges_way():
    scene = plan("highway")
    outline = build_overbridge(scene.streets[0], -9.6, 0.0).outline
    assert not any(shapely.intersects(outline, lot.outline()) for lot in scene.lots)
    inside = [spot.kind for spot in scene.spots if shapely.contains_xy(outline, *spot.place[:2])]
    assert not inside
    middle = np.array(outline.centroid.coords[0])
    assert not scene.is_free(*middle)


def test_edge_lines_are_broken_only_beside_slip_roads():
    scene = plan("highway")
    faces = scene.ground.faces
    edge = [
        [mark for mark in scene.layouts[row] if mark["strength"] == 1.0 and mark["v_high"] - mark["v_low"] > 0.25]
        for row in range(len(scene.layouts))
    ]
    broken = [row for row, marks in enumerate(edge) if any(mark["u_period"] > 0.0 for mark in marks)]
    assert len(broken) == 2
    for row in broken:
        mine = faces[faces["layout"] == row]
        corners = scene.ground.corners[mine["first"][:, None] + np.arange(3)].reshape(-1, 3)
        station, _ = scene.streets[0].line.locate(corners[:, :2])
        assert 40.0 < np.ptp(station) < 160.0
