"""Boxes against rays through every pixel, convex hulls by Qhull, and definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from mirror.errors import UsageError
from mirror.geometry import Camera, Poses, convex_hull, corners, points_in_boxes, project_boxes, rotate
from mirror.geometry.boxes import CORNER_SIGNS, EDGES, FACES
from tests.draws import draws
from tests.geometry.cameras import CAMERAS, each_model

NEAR_M = 0.1
# Turns back within its own image: pixels near the corners see nothing.
NARROW_RANGE = Camera("brown_conrady", 1920, 1080, 700.0, 700.0, 960.0, 540.0, (-0.3, 0.0, 2e-3, -1e-3, 0.0))
ALL_CAMERAS = {**CAMERAS, "narrow_range": NARROW_RANGE}


def random_boxes(count: int, seed: int = 0) -> tuple[Poses, np.ndarray]:
    """Boxes all round the camera: before it, behind it, across the near plane, and around it."""
    generator = np.random.default_rng(seed)
    centre = generator.normal(size=(count, 3)) * (8, 4, 8) + (0, 0, 6)
    return Poses(generator.normal(size=(count, 4)), centre), np.exp(generator.uniform(-0.5, 2.7, (count, 3)))


def bounds_by_rays(camera: Camera, camera_SE3_box: Poses, lwh: np.ndarray, near: float) -> np.ndarray:
    """Least and greatest pixel centres whose ray meets each box (slabs, Kay and Kajiya 1986)."""
    rays = camera.rays()
    direction = rays.direction[rays.valid]
    pixel = np.argwhere(rays.valid)[:, ::-1] + 0.5
    start = near / direction[:, 2] if camera.lens.forward_only else np.zeros(len(direction))
    bounds = np.full((len(lwh), 4), np.nan)
    for row, (matrix, size) in enumerate(zip(camera_SE3_box.matrix(), lwh)):
        turned, origin = direction @ matrix[:3, :3], -matrix[:3, 3] @ matrix[:3, :3]
        sides = (np.array([[-0.5], [0.5]]) * size - origin)[:, None] / turned
        enter, leave = sides.min(axis=0).max(axis=1), sides.max(axis=0).min(axis=1)
        hit = pixel[(leave >= enter) & (leave >= start)]
        if len(hit):
            bounds[row] = (*hit.min(axis=0), *hit.max(axis=0))
    return bounds


@pytest.mark.parametrize("camera", ALL_CAMERAS.values(), ids=ALL_CAMERAS)
def test_bounds_are_those_of_the_pixels_that_see_the_box(camera: Camera) -> None:
    small = camera.scaled(0.2)
    poses, lwh = random_boxes(60)
    ours = project_boxes(small, poses, lwh, near_m=NEAR_M)
    truth = bounds_by_rays(small, poses, lwh, NEAR_M)
    seen = np.isfinite(truth[:, 0])
    assert seen.sum() > 20
    assert ours.visible[seen].all()
    # Nothing that a pixel sees is left out, and little is added: a pixel's centre may miss a pointed corner.
    excess = np.concatenate((truth[seen, :2] - ours.bounds_px[seen, :2], ours.bounds_px[seen, 2:] - truth[seen, 2:]))
    assert excess.min() > -0.02
    assert np.median(excess) < 0.7
    assert np.quantile(excess, 0.9) < 2.0
    assert excess.max() < 8.0
    assert (~seen & ours.visible).sum() <= 2
    assert np.isnan(ours.bounds_px[~ours.visible]).all()
    assert (ours.bounds_px[ours.visible] >= 0).all()
    assert (ours.bounds_px[ours.visible] <= (384, 216, 384, 216)).all()


@each_model
def test_a_batch_gives_what_single_boxes_give(camera: Camera) -> None:
    poses, lwh = random_boxes(20, 1)
    together = project_boxes(camera, poses, lwh)
    for row in range(20):
        alone = project_boxes(camera, poses[row], lwh[row])
        assert alone.visible[0] == together.visible[row]
        assert np.allclose(alone.bounds_px[0], together.bounds_px[row], rtol=0, atol=1e-9, equal_nan=True)
        assert np.allclose(alone.hull(0), together.hull(row), rtol=1e-9, atol=1e-9)


def test_the_hull_of_a_pinhole_is_the_hull_of_the_corners() -> None:
    camera = CAMERAS["pinhole"]
    generator = np.random.default_rng(0)
    poses = Poses(generator.normal(size=(50, 4)), generator.uniform((-5, -3, 8), (5, 3, 40), (50, 3)))
    lwh = generator.uniform(0.5, 4.0, (50, 3))
    ours = project_boxes(camera, poses, lwh)
    pixels = camera.project(corners(poses, lwh)).uv_px
    for row in range(50):
        hull = ours.hull(row)
        expected = pixels[row][ConvexHull(pixels[row]).vertices]
        assert sorted(hull.tolist()) == sorted(expected.tolist())
        x, y = hull.T
        assert (np.roll(x, -1) - x) @ (np.roll(y, -1) + y) < 0


def test_the_hull_follows_the_distortion() -> None:
    camera = NARROW_RANGE
    # A wide plank across the view: its straight upper edge bulges upwards in the image, away from the corners' chord.
    plank = Poses([1.0, 0, 0, 0], [0.0, -1.0, 3.0])
    result = project_boxes(camera, plank, [4.0, 0.2, 0.2])
    edge = camera.project(np.stack((np.linspace(-2, 2, 2001), np.full(2001, -1.1), np.full(2001, 2.9)), axis=-1)).uv_px
    assert edge[:, 1].min() < edge[[0, -1], 1].min() - 10
    assert result.hull(0)[:, 1].min() == pytest.approx(edge[:, 1].min(), abs=0.05)
    assert result.bounds_px[0, 1] == pytest.approx(edge[:, 1].min(), abs=0.05)


def test_the_near_plane_cuts_where_it_says() -> None:
    camera = Camera("pinhole", 1000, 1000, 100.0, 100.0, 500.0, 500.0)
    road = Poses([1.0, 0, 0, 0], [0.0, 2.0, 0.0])
    for near in (0.5, 1.0):
        result = project_boxes(camera, road, [2.0, 1.0, 40.0], near_m=near)
        hull = result.hull(0)
        # The lower edge of the cut: y = 2.5 at z = near.
        assert hull[:, 1].max() == pytest.approx(500 + 100 * 2.5 / near)
        assert hull[:, 0].max() == pytest.approx(500 + 100 * 1.0 / near)
        assert hull[:, 1].min() == pytest.approx(500 + 100 * 1.5 / 20)
        assert result.bounds_px[0] == pytest.approx(
            [max(0.0, 500 - 100 / near), 507.5, min(1000.0, 500 + 100 / near), min(1000.0, 500 + 250 / near)]
        )


@each_model
def test_around_and_behind_the_camera(camera: Camera) -> None:
    around = project_boxes(camera, Poses.identity(), [[4.0, 4.0, 4.0]])
    assert around.bounds_px[0] == pytest.approx([0, 0, camera.width_px, camera.height_px], abs=1e-6)
    behind = project_boxes(camera, Poses([1.0, 0, 0, 0], [0.0, 0, -30.0]), [[1.0, 1.0, 1.0]])
    assert not behind.visible[0]
    if camera.lens.forward_only:
        assert behind.hull(0).shape == (0, 2)


def test_a_wall_behind_a_fisheye_is_seen_all_round_its_edge() -> None:
    camera = Camera("f_theta", 2000, 2000, 1.0, 1.0, 1000.0, 1000.0, (0.0, 300.0))
    wall = project_boxes(camera, Poses([1.0, 0, 0, 0], [0.0, 0, -2.0]), [[10.0, 10.0, 0.1]])
    assert wall.bounds_px[0] == pytest.approx(
        [1000 - 300 * np.pi, 1000 - 300 * np.pi, 1000 + 300 * np.pi, 1000 + 300 * np.pi], abs=1e-5
    )


@each_model
def test_flat_boxes_points_and_none(camera: Camera) -> None:
    ahead = Poses([1.0, 0, 0, 0], [0.1, 0.2, 10.0])
    point = project_boxes(camera, ahead, [0.0, 0.0, 0.0])
    pixel = camera.project([0.1, 0.2, 10.0]).uv_px
    assert point.visible[0]
    assert point.bounds_px[0] == pytest.approx([*pixel, *pixel], abs=1e-9)
    plate = project_boxes(camera, ahead, [2.0, 1.0, 0.0])
    assert plate.visible[0]
    assert len(plate.hull(0)) >= 4
    none = project_boxes(camera, ahead[:0], np.empty((0, 3)))
    assert none.bounds_px.shape == (0, 4)
    assert len(none) == 0


def test_bad_sizes_and_planes() -> None:
    poses = Poses.identity(2)
    for lwh, words in (
        ([[1.0, 1, 1]], "2 boxes"),
        ([[1.0, 1, 1], [1, -1, 1]], "row 1"),
        ([[np.nan, 1, 1], [1, 1, 1]], "row 0"),
    ):
        with pytest.raises(UsageError, match=words):
            corners(poses, lwh)
    with pytest.raises(UsageError, match="above 0"):
        project_boxes(CAMERAS["pinhole"], poses, np.ones((2, 3)), near_m=0.0)


def test_corner_and_edge_order() -> None:
    assert (corners(Poses.identity(), [2.0, 4.0, 6.0])[0] == CORNER_SIGNS * (1, 2, 3)).all()
    assert len(np.unique(CORNER_SIGNS, axis=0)) == 8
    differing = (CORNER_SIGNS[EDGES[:, 0]] != CORNER_SIGNS[EDGES[:, 1]]).sum(axis=1)
    assert (differing == 1).all()
    assert len(np.unique(np.sort(EDGES, axis=1), axis=0)) == 12
    for face in FACES:
        shared = CORNER_SIGNS[EDGES[face]].reshape(-1, 3)
        assert ((shared == shared[0]).all(axis=0)).sum() == 1
        assert len(np.unique(EDGES[face])) == 4
    assert (np.bincount(FACES.ravel()) == 2).all()


def test_points_in_boxes_agree_with_every_pair() -> None:
    generator = np.random.default_rng(0)
    poses, lwh = random_boxes(30)
    points = generator.normal(size=(2000, 3)) * 10
    points[:3] = np.nan, np.inf, -np.inf
    ours = points_in_boxes(points, poses, lwh)
    inverse = poses.inverse()
    with np.errstate(invalid="ignore"):
        expected = np.stack(
            [
                (np.abs(rotate(q, points) + t) <= size / 2).all(axis=1)
                for q, t, size in zip(inverse.rotation, inverse.translation, lwh)
            ]
        )
    assert (ours == expected).all()
    assert ours.any()
    assert points_in_boxes(np.empty((0, 3)), poses, lwh).shape == (30, 0)
    assert points_in_boxes(points, poses[:0], np.empty((0, 3))).shape == (0, 2000)


def test_points_far_from_the_origin_and_on_the_surface() -> None:
    far = np.array([5e6, 4e6, 100.0])
    box = Poses([1.0, 0, 0, 0], far)
    offsets = np.array([[1.0, 0, 0], [1.0 + 1e-8, 0, 0], [-1.0, -0.5, 0.25], [0, 0.5 + 1e-8, 0]])
    assert points_in_boxes(far + offsets, box, [2.0, 1.0, 0.5])[0].tolist() == [True, False, True, False]


@given(st.lists(st.tuples(st.integers(-5, 5), st.integers(-5, 5)), max_size=30))
@settings(max_examples=draws(100))
def test_convex_hull_is_convex_and_holds_every_point(points: list[tuple[int, int]]) -> None:
    hull = convex_hull(np.array(points, dtype=np.float64).reshape(-1, 2))
    assert {tuple(corner) for corner in hull.tolist()} <= {(float(x), float(y)) for x, y in points}
    if len(hull) < 3:
        assert len(hull) == min(len(set(points)), 2)
        return
    edge = np.roll(hull, -1, axis=0) - hull
    after = np.roll(edge, -1, axis=0)
    assert (edge[:, 0] * after[:, 1] - edge[:, 1] * after[:, 0] > 0).all()
    for point in points:
        to = np.array(point) - hull
        assert (edge[:, 0] * to[:, 1] - edge[:, 1] * to[:, 0] >= 0).all()


def test_convex_hull_leaves_out_what_is_not_finite() -> None:
    hull = convex_hull([[0.0, 0], [1, 0], [np.nan, 5], [1, 1], [np.inf, 1], [0, 1], [0.5, 0.5]])
    assert hull.tolist() == [[0, 0], [1, 0], [1, 1], [0, 1]]
