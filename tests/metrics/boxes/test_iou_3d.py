"""Overlaps in space against 60 digits, Qhull, closed forms and properties."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from mirror.errors import UsageError
from mirror.geometry import Poses, quaternion_multiply
from mirror.metrics.boxes import box_iou_3d, box_iou_3d_matrix
from tests.draws import draws
from tests.metrics.boxes.reference import exact_iou


def yaws(angles: np.ndarray) -> np.ndarray:
    zero = np.zeros_like(angles)
    return np.stack((np.cos(angles / 2), zero, zero, np.sin(angles / 2)), axis=-1)


def upright(count: int, seed: int = 0, spread: float = 3.0) -> tuple[Poses, np.ndarray]:
    generator = np.random.default_rng(seed)
    rotation = yaws(generator.uniform(-np.pi, np.pi, count))
    return Poses(rotation, generator.normal(size=(count, 3)) * (spread, spread, 0.5)), np.exp(
        generator.uniform(-0.5, 1.8, (count, 3))
    )


def tilted(count: int, seed: int = 0) -> tuple[Poses, np.ndarray]:
    generator = np.random.default_rng(seed)
    rotation, centre = generator.normal(size=(count, 4)), generator.normal(size=(count, 3))
    return Poses(rotation, centre), np.exp(generator.uniform(-0.5, 1.5, (count, 3)))


def test_upright_boxes_agree_with_sixty_digits() -> None:
    (pose, lwh), (pose2, lwh2) = upright(150, 1, 2.0), upright(150, 2, 2.0)
    ours = box_iou_3d(pose, lwh, pose2, lwh2)
    exact = [exact_iou(pose[[row]], lwh[[row]], pose2[[row]], lwh2[[row]]) for row in range(len(pose))]
    assert np.mean(np.array(exact) > 0) > 0.2
    np.testing.assert_allclose(ours, exact, rtol=0, atol=1e-14)


@pytest.mark.parametrize("offset", [1e4, 1e6, 1e8])
def test_far_from_the_origin(offset: float) -> None:
    (pose, lwh), (pose2, lwh2) = upright(60, 3), upright(60, 4)
    far, far2 = (Poses(p.rotation, p.translation + offset) for p in (pose, pose2))
    exact = [exact_iou(far[[row]], lwh[[row]], far2[[row]], lwh2[[row]]) for row in range(60)]
    np.testing.assert_allclose(box_iou_3d(far, lwh, far2, lwh2), exact, rtol=0, atol=1e-13)


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1e6, 1e30])
def test_tiny_and_huge(scale: float) -> None:
    (pose, lwh), (pose2, lwh2) = tilted(40, 3), tilted(40, 4)
    (scaled, scaled2) = (Poses(p.rotation, p.translation * scale) for p in (pose, pose2))
    expected = box_iou_3d(pose, lwh, pose2, lwh2)
    np.testing.assert_allclose(box_iou_3d(scaled, lwh * scale, scaled2, lwh2 * scale), expected, rtol=0, atol=1e-13)


def volume_by_qhull(pose: Poses, lwh: np.ndarray, pose2: Poses, lwh2: np.ndarray) -> float:
    planes = []
    for one, size in ((pose, lwh[0]), (pose2, lwh2[0])):
        axes = one.matrix()[0, :3, :3]
        for axis in range(3):
            for sign in (1, -1):
                normal = sign * axes[:, axis]
                planes.append([*normal, -normal @ one.translation[0] - size[axis] / 2])
    from scipy.optimize import linprog

    halfspaces = np.array(planes)
    bounds = [(None, None)] * 3 + [(0, None)]
    deepest = linprog([0, 0, 0, -1], np.c_[halfspaces[:, :3], np.ones(12)], -halfspaces[:, 3], bounds=bounds)
    if deepest.status != 0 or deepest.x[3] < 1e-6:
        return 0.0
    return ConvexHull(HalfspaceIntersection(halfspaces, deepest.x[:3]).intersections).volume


def test_tilted_boxes_agree_with_qhull() -> None:
    (pose, lwh), (pose2, lwh2) = tilted(60, 1), tilted(60, 2)
    ours = box_iou_3d(pose, lwh, pose2, lwh2)
    for row in range(len(pose)):
        one = [row]
        try:
            shared = volume_by_qhull(pose[one], lwh[one], pose2[one], lwh2[one])
        except QhullError:
            continue
        union = lwh[row].prod() + lwh2[row].prod() - shared
        assert ours[row] == pytest.approx(shared / union, abs=1e-9)


def test_two_ways_to_one_overlap() -> None:
    """Sizes in another order with a turn that undoes it: the same boxes, but their z axes no longer agree."""
    (pose, lwh), (pose2, lwh2) = upright(300, 5, 2.0), upright(300, 6, 2.0)
    # New x is old y, new y is old z, new z is old x.
    permuted = Poses(quaternion_multiply(pose2.rotation, [0.5, 0.5, 0.5, 0.5]), pose2.translation)
    np.testing.assert_allclose(
        box_iou_3d(pose, lwh, permuted, lwh2[:, [1, 2, 0]]), box_iou_3d(pose, lwh, pose2, lwh2), rtol=0, atol=1e-14
    )


def turned(axis: list[float], angle: float, centre: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Poses:
    return Poses([[np.cos(angle / 2), *(np.sin(angle / 2) * np.array(axis))]], [centre])


@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
def test_closed_forms(axis: list[float]) -> None:
    cube, identity = [[1.0, 1.0, 1.0]], turned([0.0, 0.0, 1.0], 0.0)
    octagon = 2.0 * np.sqrt(2.0) - 2.0
    assert box_iou_3d(identity, cube, turned(axis, np.pi / 4), cube)[0] == pytest.approx(
        octagon / (2.0 - octagon), abs=1e-14
    )
    for quarter in range(5):
        assert box_iou_3d(identity, cube, turned(axis, quarter * np.pi / 2), cube)[0] == pytest.approx(1.0, abs=1e-14)
    # One holds the other, whatever the other's orientation.
    held = box_iou_3d(identity, [[9.0, 9.0, 9.0]], turned(axis, 0.7, (0.5, -0.4, 0.3)), [[1.0, 2.0, 3.0]])
    assert held[0] == pytest.approx(6.0 / 729.0, abs=1e-16)
    # Half along an axis: a third.
    shifted = turned(axis, 0.0, tuple(0.5 * np.array(axis)))
    assert box_iou_3d(identity, cube, shifted, cube)[0] == pytest.approx(1 / 3, abs=1e-16)


def test_a_cube_on_its_corner() -> None:
    """Turned by 60 degrees about its diagonal a cube shares 3/4 of its volume: a double pyramid on a hexagon."""
    diagonal = [1 / np.sqrt(3)] * 3
    result = box_iou_3d(turned([0, 0, 1], 0.0), [[1.0] * 3], turned(diagonal, np.pi / 3), [[1.0] * 3])[0]
    assert result == pytest.approx(0.75 / 1.25, abs=1e-14)


@given(st.integers(0, 10_000), st.sampled_from([1e-6, 1.0, 1e6]), st.sampled_from([0.0, 1.0, 1e6, 1e8]))
@settings(max_examples=draws(60), deadline=None)
def test_a_box_has_exactly_one_with_itself(seed: int, scale: float, offset: float) -> None:
    for pose, lwh in (upright(20, seed), tilted(20, seed)):
        moved = Poses(pose.rotation, pose.translation + offset)
        np.testing.assert_array_equal(box_iou_3d(moved, lwh * scale, moved, lwh * scale), np.ones(20))


@pytest.mark.parametrize("shift", [1e-15, 1e-12, 1e-9, 1e-6])
def test_all_but_equal_boxes(shift: float) -> None:
    for pose, lwh in (upright(50, 7), tilted(50, 7)):
        generator = np.random.default_rng(8)
        other = Poses(
            pose.rotation + shift * generator.normal(size=(50, 4)),
            pose.translation + shift * generator.normal(size=(50, 3)),
        )
        value = box_iou_3d(pose, lwh, other, lwh * (1.0 + shift))
        assert (value <= 1.0).all()
        np.testing.assert_allclose(value, 1.0, rtol=0, atol=1e-13 + 200.0 * shift)


def test_touching_apart_and_without_volume() -> None:
    identity, cube = turned([0, 0, 1], 0.0), [[1.0, 1.0, 1.0]]
    for axis in range(3):
        centre = np.eye(3)[axis]
        assert box_iou_3d(identity, cube, turned([0, 0, 1], 0.0, tuple(centre)), cube)[0] == 0.0
        # Edge to face, tilted.
        touching = turned([0, 1, 0], np.pi / 4, (0.5 + np.sqrt(0.5), 0.0, 0.0))
        assert box_iou_3d(identity, cube, touching, cube)[0] == pytest.approx(0.0, abs=1e-15)
        assert box_iou_3d(identity, cube, turned([0, 1, 0], 0.3, tuple(centre * 1e9)), cube)[0] == 0.0
        flat = np.ones((1, 3))
        flat[0, axis] = 0.0
        assert box_iou_3d(identity, flat, identity, cube)[0] == 0.0
        assert np.isnan(box_iou_3d(identity, flat, identity, flat)[0])
    assert np.isnan(box_iou_3d(identity, np.zeros((1, 3)), identity, np.zeros((1, 3)))[0])
    # A sheet of paper keeps its digits.
    thin = [[1.0, 1.0, 1e-12]]
    assert box_iou_3d(identity, thin, turned([0, 0, 1], 0.0, (0.5, 0.0, 0.0)), thin)[0] == pytest.approx(
        1 / 3, rel=1e-14
    )


@given(st.integers(0, 10_000))
@settings(max_examples=draws(40), deadline=None)
def test_symmetric_bounded_and_unmoved_by_a_change_of_frame(seed: int) -> None:
    frame, _ = tilted(1, seed + 1)
    for make in (upright, tilted):
        (pose, lwh), (pose2, lwh2) = make(10, seed), make(10, seed + 1)
        value = box_iou_3d(pose, lwh, pose2, lwh2)
        assert ((value >= 0.0) & (value <= 1.0)).all()
        np.testing.assert_allclose(box_iou_3d(pose2, lwh2, pose, lwh), value, rtol=0, atol=1e-13)
        whole = frame[np.zeros(10, dtype=np.int64)]
        moved = box_iou_3d(whole.compose(pose), lwh, whole.compose(pose2), lwh2)
        np.testing.assert_allclose(moved, value, rtol=0, atol=1e-12)


def test_each_with_each() -> None:
    (pose, lwh), (pose2, lwh2) = upright(4, 1), upright(3, 2)
    matrix = box_iou_3d_matrix(pose, lwh, pose2, lwh2)
    assert matrix.shape == (4, 3)
    for row in range(4):
        for column in range(3):
            pair = box_iou_3d(pose[[row]], lwh[[row]], pose2[[column]], lwh2[[column]])
            assert matrix[row, column] == pair[0]
    none = Poses(np.empty((0, 4)), np.empty((0, 3)))
    assert box_iou_3d_matrix(none, np.empty((0, 3)), pose, lwh).shape == (0, 4)


def test_what_cannot_be_compared() -> None:
    pose, lwh = upright(3)
    with pytest.raises(UsageError, match="3 boxes with 2"):
        box_iou_3d(pose, lwh, pose[:2], lwh[:2])
    for wrong in (np.nan, np.inf, -1.0):
        broken = lwh.copy()
        broken[2, 1] = wrong
        with pytest.raises(UsageError, match="row 2"):
            box_iou_3d(pose, lwh, pose, broken)
