"""Tests plane-sweep stereo against planes in closed form and a plain float64 reference."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest

from hybridworldsim.mvs.estimator import StereoImage
from hybridworldsim.mvs.plane_sweep import PlaneSweep, to_grey
from hybridworldsim.mvs.sweep.correlation import COSTS, RADIUS, UNKNOWN, compute_cost_volume
from hybridworldsim.mvs.sweep.path_costs import smooth_costs
from hybridworldsim.mvs.sweep.planes import make_facing_planes, make_road_planes, make_upright_planes
from mirror.errors import UsageError
from mirror.geometry.poses import Poses
from tests.mvs.images import SIZE, Wall, compute_depth, make_image

SWEEP = PlaneSweep(planes=64, road_planes=0)
SOURCE_X_M = (-1.0, 1.0, 0.5, -0.5)


def run_sweep(wall: Wall, sweep: PlaneSweep = SWEEP, **options: object) -> tuple[np.ndarray, np.ndarray]:
    result = sweep(make_image(wall, 0.0), [make_image(wall, x, **options) for x in SOURCE_X_M], 2.0, 50.0)
    return result.depth_m, compute_depth(wall, 0.0)


@pytest.mark.parametrize(
    "wall", [Wall(), Wall(offset_m=20.0), Wall((0.3, 0.0, 0.95), 9.0), Wall((0.0, 0.35, 0.93), 7.0, seed=3)]
)
def test_depth_of_a_plane(wall: Wall) -> None:
    depth, true = run_sweep(wall)
    known = np.isfinite(depth)
    error = np.abs(depth - true)[known] / true[known]
    assert known.mean() > 0.6
    assert np.median(error) < 0.02 and (error < 0.05).mean() > 0.9


def test_exposure_does_not_change_the_depth() -> None:
    depth, true = run_sweep(Wall(), gain=0.5, shift=25.0)
    known = np.isfinite(depth)
    assert known.mean() > 0.5 and np.median(np.abs(depth - true)[known] / true[known]) < 0.02


def test_costs_equal_a_float64_reference() -> None:
    wall = Wall((0.2, 0.1, 0.95), 8.0)
    valid = np.ones(SIZE[::-1], np.bool_)
    valid[10:14, 20:26] = False
    reference, source = make_image(wall, 0.0, valid=valid), make_image(wall, 0.7)
    planes = make_facing_planes(7, 4.0, 20.0)
    volume = compute_cost_volume(
        to_grey(reference), [to_grey(source)], planes.compute_homographies(reference, source)[None],
        planes.compute_inverse_depth(reference.K), (1 / 20.0, 1 / 4.0), 7, best=2, deviation=0.01,
    )  # fmt: skip
    expected = compute_costs_by_loops(reference, source, np.linspace(1 / 20.0, 1 / 4.0, 7), 0.01)
    assert ((volume == UNKNOWN) == np.isnan(expected)).mean() > 0.999
    both = (volume != UNKNOWN) & ~np.isnan(expected)
    assert both.mean() > 0.5
    # Single precision differs from double precision by a step at most, in rare pixels.
    assert np.abs(volume[both] - expected[both]).max() <= 2.0


def compute_costs_by_loops(
    reference: StereoImage, source: StereoImage, inverse: np.ndarray, deviation: float
) -> np.ndarray:
    """Compute the cost of each pixel and depth in double precision, window by window."""
    height, width = reference.valid.shape
    reference_grey = np.where(reference.valid, to_grey(reference).astype(np.float64), np.nan)
    other = np.where(source.valid, to_grey(source).astype(np.float64), np.nan)
    motion = (source.world_SE3_camera.inverse() @ reference.world_SE3_camera).matrix()[0]
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(reference.K).T
    costs = np.full((height, width, len(inverse)), np.nan)
    for index, value in enumerate(inverse):
        point = rays / value @ motion[:3, :3].T + motion[:3, 3]
        pixel = point @ source.K.T
        x, y = pixel[..., 0] / pixel[..., 2] - 0.5, pixel[..., 1] / pixel[..., 2] - 0.5
        slack = 1e-3
        inside = (x >= -slack) & (y >= -slack) & (x <= width - 1 + slack) & (y <= height - 1 + slack)
        x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
        left = np.clip(np.floor(x).astype(int), 0, width - 2)
        top = np.clip(np.floor(y).astype(int), 0, height - 2)
        a, b = x - left, y - top
        warped = (1 - b) * ((1 - a) * other[top, left] + a * other[top, left + 1]) + b * (
            (1 - a) * other[top + 1, left] + a * other[top + 1, left + 1]
        )
        warped[~inside] = np.nan
        for row in range(RADIUS, height - RADIUS):
            for column in range(RADIUS, width - RADIUS):
                window = np.s_[row - RADIUS : row + RADIUS + 1, column - RADIUS : column + RADIUS + 1]
                first, second = reference_grey[window].ravel(), warped[window].ravel()
                if first.std() > deviation and second.std() > deviation:
                    score = np.mean((first - first.mean()) * (second - second.mean())) / first.std() / second.std()
                    costs[row, column, index] = (1.0 - score) * COSTS / 2.0
    return costs


def test_smoothing_equals_a_plain_reference() -> None:
    rng = np.random.default_rng(1)
    volume = rng.integers(0, 255, (5, 6, 7)).astype(np.uint8)
    volume[2, 3] = UNKNOWN
    image = rng.uniform(-0.5, 0.5, (5, 6)).astype(np.float32)
    total = smooth_costs(volume, image, step=8, jump=48, neutral=100, contrast=0.05)
    costs = np.where(volume == UNKNOWN, 100, volume).astype(int)
    expected = np.zeros(volume.shape, int)
    for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        path = np.zeros(volume.shape, int)
        for row in range(5)[:: dy or 1]:
            for column in range(6)[:: dx or 1]:
                r, c = row - dy, column - dx
                reference_grey = costs[row, column]
                if not (0 <= r < 5 and 0 <= c < 6):
                    path[row, column] = reference_grey
                    continue
                before = path[r, c]
                change = abs(float(image[row, column]) - float(image[r, c]))
                leap = max(int(48 / (1 + change / 0.05)), 9)
                padded = np.pad(before, 1, constant_values=1 << 20)
                near = np.minimum(padded[:-2], padded[2:]) + 8
                path[row, column] = (
                    reference_grey + np.minimum(np.minimum(before, near), before.min() + leap) - before.min()
                )
        expected += path
    assert np.abs(total.astype(int) - expected).max() <= 4


def test_masked_pixels_get_no_depth_and_give_no_evidence() -> None:
    wall = Wall()
    valid = np.ones(SIZE[::-1], np.bool_)
    valid[:, :30] = False
    masked = make_image(wall, 0.0, valid=valid)
    result = SWEEP(masked, [make_image(wall, x) for x in SOURCE_X_M], 2.0, 50.0)
    assert np.isnan(result.depth_m[:, :30]).all() and np.isfinite(result.depth_m[:, 40:]).any()
    changed = replace(masked, rgb=np.where(valid[..., None], masked.rgb, 17).astype(np.uint8))
    second = SWEEP(changed, [make_image(wall, x) for x in SOURCE_X_M], 2.0, 50.0)
    np.testing.assert_array_equal(result.depth_m, second.depth_m)


@pytest.mark.parametrize(
    "case", ["no source", "flat", "black", "saturated", "same place", "all masked", "sources masked"]
)
def test_no_depth_without_evidence(case: str) -> None:
    wall, nowhere = Wall(), np.zeros(SIZE[::-1], np.bool_)
    reference, sources = make_image(wall, 0.0), [make_image(wall, x) for x in SOURCE_X_M]
    if case == "no source":
        sources = []
    elif case in ("flat", "black", "saturated"):
        value = {"flat": 90, "black": 0, "saturated": 255}[case]
        sources = [replace(image, rgb=np.full_like(image.rgb, value)) for image in sources]
    elif case == "same place":
        # All depths have the same cost, without a margin.
        sources = [reference, reference]
    elif case == "all masked":
        reference = replace(reference, valid=nowhere)
    else:
        sources = [replace(image, valid=nowhere) for image in sources]
    result = SWEEP(reference, sources, 2.0, 50.0)
    assert np.isnan(result.depth_m).all() and not result.confidence.any()


def test_tiny_images() -> None:
    for shape in ((1, 1), (1, 9), (3, 2)):
        image = StereoImage(
            np.full((*shape, 3), 9, np.uint8), np.diag([5.0, 5.0, 1.0]), Poses.identity(), np.ones(shape, np.bool_)
        )
        result = SWEEP(image, [image], 1.0, 5.0)
        assert result.depth_m.shape == shape and np.isnan(result.depth_m).all()


@pytest.mark.parametrize(("near", "far"), [(0.0, 5.0), (5.0, 5.0), (6.0, 5.0), (1.0, np.inf), (np.nan, 5.0)])
def test_invalid_depth_ranges_are_refused(near: float, far: float) -> None:
    image = make_image(Wall(), 0.0)
    with pytest.raises(UsageError, match="depths from"):
        SWEEP(image, [image], near, far)


def test_invalid_poses_and_images_are_refused() -> None:
    with pytest.raises(UsageError, match="not finite"):
        Poses(np.array([[1.0, 0, 0, 0]]), np.array([[np.nan, 0, 0]]))
    good = make_image(Wall(), 0.0)
    for change in ({"rgb": good.rgb[..., 0]}, {"valid": good.valid[:3]}, {"K": np.full((3, 3), np.nan)}):
        with pytest.raises(UsageError):
            replace(good, **change)


def test_result_does_not_depend_on_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    results = []
    for threads in (1, 2):
        monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", threads)
        results.append(run_sweep(Wall((0.2, 0.1, 0.9), 8.0))[0])
    np.testing.assert_array_equal(*results)


def test_result_does_not_depend_on_the_origin() -> None:
    wall = Wall()
    far = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[4.0e5, -3.0e5, 100.0]]))
    images = [make_image(wall, x) for x in (0.0, *SOURCE_X_M)]
    moved = [replace(image, world_SE3_camera=far @ image.world_SE3_camera) for image in images]
    here = SWEEP(images[0], images[1:], 2.0, 50.0).depth_m
    there = SWEEP(moved[0], moved[1:], 2.0, 50.0).depth_m
    assert (np.isfinite(here) == np.isfinite(there)).mean() > 0.999
    both = np.isfinite(here) & np.isfinite(there)
    np.testing.assert_allclose(here[both], there[both], rtol=1e-3)


def test_positions_of_planes() -> None:
    # A level camera that faces north: x east, y down, z north.
    level = Poses.from_matrix(np.array([[1.0, 0, 0, 3], [0, 0, 1, 4], [0, -1, 0, 1.5], [0, 0, 0, 1]]))
    road = make_road_planes(4, level)
    np.testing.assert_allclose(road.normal, np.tile([0.0, 1.0, 0.0], (4, 1)), atol=1e-12)
    ahead = Poses(level.rotation, level.translation + np.array([0.0, 2.0, 0.0]))
    left, right = make_upright_planes(4, level, [ahead], 2.0)
    np.testing.assert_allclose(left.normal[0], [-1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(right.normal[0], [1.0, 0.0, 0.0], atol=1e-12)
    assert make_upright_planes(4, level, [level], 2.0) == []
