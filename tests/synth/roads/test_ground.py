"""Tests of the ground: no gaps, crowns, kerbs, gentle slopes, and height queries."""

import numpy as np
import pytest
import shapely

from mirror.errors import UsageError
from mirror.synth.model import Label, Material
from mirror.synth.roads.ground_index import build_ground_index
from tests.synth.roads.scenes import KINDS, plan


def level_faces(scene):
    """Indices (T,) of the ground's faces, without the kerbs' upright faces and bridges."""
    return np.flatnonzero(scene.ground.faces["count"] == 3)[: len(scene.ground_index.triangles)]


def triangles_of(scene):
    """Corners (T, 3, 3) of the faces from `level_faces`."""
    return scene.ground.corners[scene.ground.faces["first"][level_faces(scene)][:, None] + np.arange(3)]


def crossed(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def hits(triangles, x, y):
    """Heights at which a vertical ray hits the triangles, tested one by one."""
    a, b, c = (triangles[:, k, :2] for k in range(3))
    p = np.array([x, y])
    area = crossed(b - a, c - a)
    s, t = crossed(p - a, c - a) / area, crossed(b - a, p - a) / area
    inside = (s >= 0) & (t >= 0) & (s + t <= 1)
    z = (
        triangles[:, 0, 2]
        + s * (triangles[:, 1, 2] - triangles[:, 0, 2])
        + t * (triangles[:, 2, 2] - triangles[:, 0, 2])
    )
    return z[inside]


@pytest.mark.parametrize("kind", KINDS)
def test_vertical_rays_hit_the_ground_once_at_its_height(kind):
    scene = plan(kind)
    triangles = triangles_of(scene)
    rng = np.random.default_rng(5)
    points = rng.uniform(-330.0, 330.0, (250, 2)) * np.where(rng.random((250, 1)) < 0.5, 1.0, 0.3)
    heights = scene.height_m(points[:, 0], points[:, 1])
    for (x, y), height in zip(points, heights):
        met = hits(triangles, x, y)
        assert len(met) == 1, (x, y)
        assert met[0] == pytest.approx(height, abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_the_ground_is_watertight_apart_from_its_rim(kind):
    scene = plan(kind)
    triangles = triangles_of(scene)
    names = np.round(triangles[..., :2] * 1000).astype(np.int64)
    sides = {}
    for triangle, corners in zip(triangles, names):
        for k in range(3):
            a, b = tuple(corners[k]), tuple(corners[(k + 1) % 3])
            ends = (triangle[k, 2], triangle[(k + 1) % 3, 2])
            assert (a, b) not in sides, "two triangles lie upon each other"
            sides[a, b] = ends
    rim, steps = [], 0
    for (a, b), (za, zb) in sides.items():
        other = sides.get((b, a))
        if other is None:
            rim.append((a, b))
        elif abs(other[1] - za) > 1e-9 or abs(other[0] - zb) > 1e-9:
            steps += 1
    # Only the rim is open: it is one ring, and its area is the sum of all triangles.
    around = shapely.get_parts(shapely.polygonize([shapely.LineString(np.array(edge) / 1000.0) for edge in rim]))
    edge, other = (triangles[:, k, :2] - triangles[:, 0, :2] for k in (1, 2))
    areas = 0.5 * (edge[:, 0] * other[:, 1] - edge[:, 1] * other[:, 0])
    assert (areas > 0.0).all()
    assert len(around) == 1 and areas.sum() == pytest.approx(around[0].area, rel=1e-9)
    assert np.abs(np.array(around[0].bounds)).min() > 300.0
    upright = scene.ground.faces["normal"][:, 2] ** 2 < 1e-12
    upright &= scene.ground.faces["material"] == Material.KERB
    assert steps == 2 * int(upright.sum())
    assert (upright.sum() > 400) == (kind in ("urban", "campus"))


def test_kerbs_face_the_carriageway_and_have_the_right_height():
    scene = plan("urban")
    faces = scene.ground.faces
    kerbs = faces[faces["count"] == 4]
    corners = scene.ground.corners[kerbs["first"][:, None] + np.arange(4)]
    middle = corners.mean(axis=1)
    front, behind = middle + 0.03 * kerbs["normal"], middle - 0.03 * kerbs["normal"]
    low, high = scene.height_m(front[:, 0], front[:, 1]), scene.height_m(behind[:, 0], behind[:, 1])
    wide = np.hypot(*(corners[:, 1, :2] - corners[:, 0, :2]).T) > 0.2
    assert (low < high)[wide].all()
    heights = np.r_[corners[:, 3, 2] - corners[:, 0, 2], corners[:, 2, 2] - corners[:, 1, 2]]
    assert heights.max() == pytest.approx(0.12, abs=1e-6) and heights.min() == pytest.approx(0.02, abs=1e-6)
    np.testing.assert_allclose(kerbs["normal"][:, 2], 0.0, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_ground_faces_point_up_and_have_valid_attributes(kind):
    level = level_faces(plan(kind))
    faces = plan(kind).ground.faces
    assert (faces["normal"][level][:, 2] > 0.0).all()
    # Slivers between lines at a small angle may be steep.
    triangles = triangles_of(plan(kind))
    edges = triangles - np.roll(triangles, 1, axis=1)
    width = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / np.linalg.norm(edges, axis=2).max(axis=1)
    assert (faces["normal"][level][width > 0.02, 2] > 0.92).all()
    assert (width > 0.02).mean() > 0.98
    assert set(faces["label"][level]) <= {Label.ROAD, Label.PAVEMENT, Label.TERRAIN}
    assert ((faces["material"] == Material.ASPHALT) | (faces["layout"] == 0)).all()
    assert faces["layout"].max() < len(plan(kind).layouts)
    assert len(faces) < 9000


@pytest.mark.parametrize(("kind", "street"), [("urban", 0), ("urban", 1), ("campus", 0), ("rural", 0)])
def test_carriageways_have_a_crown_and_gentle_slopes(kind, street):
    scene = plan(kind)
    road = scene.streets[street]
    stations = np.arange(road.line.first_m + 5.0, road.line.last_m - 5.0, 3.0)
    middles = np.array([arm.station_m for crossing in scene.crossings for arm in crossing.arms if arm.street is road])
    away = np.abs(stations[:, None] - middles).min(axis=1) > 40.0
    aside = 0.9 * road.section.half_m
    left, middle, right = (scene.height_m(*road.line.at(stations, offset).T) for offset in (aside, 0.0, -aside))
    drop = middle - 0.5 * (left + right)
    np.testing.assert_allclose(drop[away], road.section.crossfall * aside, atol=0.012)
    slope = np.diff(middle) / 3.0
    assert np.abs(slope).max() < 0.07
    assert np.abs(slope).max() > 0.003
    # Inside crossings there is no crown.
    level = scene.height_m(*road.line.at(middles, 1.5).T) - scene.height_m(*road.line.at(middles, -1.5).T)
    assert np.abs(level).max() < 0.15


@pytest.mark.parametrize("kind", KINDS)
def test_heights_are_smooth_except_at_kerbs(kind):
    scene = plan(kind)
    rng = np.random.default_rng(2)
    start = rng.uniform(-250.0, 250.0, (4000, 2))
    angle = rng.uniform(0.0, 6.3, 4000)
    end = start + 0.02 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    change = np.abs(scene.height_m(*end.T) - scene.height_m(*start.T))
    shapely.prepare(scene.carriageways)
    same = shapely.contains_xy(scene.carriageways, *start.T) == shapely.contains_xy(scene.carriageways, *end.T)
    # Ramps at dropped kerbs have the largest slope.
    assert change[same].max() < 0.02 * 0.2
    assert change.max() < 0.13
    assert abs(float(scene.height_m(0.0, 0.0))) < 0.2


def test_texture_runs_along_the_street_in_metres():
    scene = plan("urban")
    faces = scene.ground.faces
    main = scene.streets[0]
    mine = (faces["material"] == Material.ASPHALT) & (faces["seed"] == 0) & (faces["layout"] > 0)
    rng = np.random.default_rng(0)
    for number in rng.choice(np.flatnonzero(mine), 60, replace=False):
        face = faces[number]
        corners = scene.ground.corners[face["first"] : face["first"] + 3]
        station, offset = main.line.locate(corners[:, :2])
        np.testing.assert_allclose(corners @ face["u_axis"] + face["u0"], station, atol=1e-6)
        np.testing.assert_allclose(corners @ face["v_axis"] + face["v0"], offset, atol=1e-6)


def test_positions_outside_the_ground_are_refused():
    scene = plan("rural")
    for x in (5000.0, np.nan, np.inf):
        with pytest.raises(UsageError, match="no triangle at this position"):
            scene.height_m(x, 0.0)
    assert scene.height_m(np.zeros((0,)), np.zeros((0,))).shape == (0,)
    assert scene.height_m(np.zeros((2, 3)), 1.0).shape == (2, 3)


def test_heights_on_one_triangle_and_its_edges():
    triangle = np.array([[[0.0, 0.0, 1.0], [10.0, 0.0, 2.0], [0.0, 10.0, 3.0]]])
    index = build_ground_index(triangle)
    np.testing.assert_allclose(
        index.height_m([0.0, 10.0, 0.0, 5.0, 2.0], [0.0, 0.0, 10.0, 5.0, 3.0]), [1, 2, 3, 2.5, 1.8]
    )
    with pytest.raises(UsageError):
        index.height_m(6.0, 6.0)


def test_the_higher_side_counts_at_a_kerb():
    low = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
    high = np.array([[4.0, 0.0, 0.1], [4.0, 4.0, 0.1], [0.0, 4.0, 0.1]])
    index = build_ground_index(np.stack([low, high]))
    np.testing.assert_allclose(index.height_m([2.0, 1.9, 2.1], [2.0, 1.9, 2.1]), [0.1, 0.0, 0.1])
