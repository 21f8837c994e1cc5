"""Rasters of the layout against a slow reference: pixel by pixel, without clipping or windows."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybridworldsim.generation.clips.clip import CATEGORIES
from hybridworldsim.generation.clips.map_lines import MapLine
from hybridworldsim.generation.layout.boxes import (
    COLOURS,
    OPENDWM_STYLE,
    OWN_STYLE,
    BoxStyle,
    draw_boxes,
    draw_inverse_depth,
)
from hybridworldsim.generation.layout.images import draw_layout
from hybridworldsim.generation.layout.lines import NEAR_M, draw_lines
from hybridworldsim.generation.layout.map_lines import draw_map
from mirror.errors import UsageError
from tests.draws import draws
from tests.generation.clips import make_clip

LENS = np.array([[30.0, 0.0, 20.0], [0.0, 31.0, 12.0], [0.0, 0.0, 1.0]])
SIZE = (24, 40)


def reference_lines(segments: np.ndarray, colours: np.ndarray, width_px: float) -> np.ndarray:
    """All pixels, all segments, in Python floats; a line behind the camera is walked back to the near plane."""
    image = np.zeros((3, *SIZE))
    for (start, end), colour in zip(segments.tolist(), colours.tolist()):
        if start[2] < NEAR_M and end[2] < NEAR_M:
            continue
        ends = []
        for point, other in ((start, end), (end, start)):
            if point[2] < NEAR_M:
                share = (NEAR_M - other[2]) / (point[2] - other[2])
                point = [b + share * (a - b) for a, b in zip(point, other)]
                point[2] = NEAR_M
            ends.append((30.0 * point[0] / point[2] + 20.0, 31.0 * point[1] / point[2] + 12.0))
        (ax, ay), (bx, by) = ends
        length = (bx - ax) ** 2 + (by - ay) ** 2
        for row, column in itertools.product(range(SIZE[0]), range(SIZE[1])):
            x, y = column + 0.5, row + 0.5
            along = ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length if length else 0.0
            along = min(max(along, 0.0), 1.0)
            distance = ((x - ax - along * (bx - ax)) ** 2 + (y - ay - along * (by - ay)) ** 2) ** 0.5
            share = min(max(0.5 * width_px + 0.5 - distance, 0.0), 1.0)
            image[:, row, column] = (1.0 - share) * image[:, row, column] + share * np.array(colour)
    return image


def reference_depth(poses: np.ndarray, sizes: np.ndarray, depth_m: float) -> np.ndarray:
    """The depth at which a ray meets a face of a box, face by face; or the near plane, where it starts within a box."""
    image = np.zeros(SIZE)
    for row, column in itertools.product(range(SIZE[0]), range(SIZE[1])):
        ray = np.array([(column + 0.5 - 20.0) / 30.0, (row + 0.5 - 12.0) / 31.0, 1.0])
        depths = []
        for pose, size in zip(poses, sizes):
            back = np.linalg.inv(pose)
            at_near = back[:3, :3] @ (NEAR_M * ray) + back[:3, 3]
            if (np.abs(at_near) <= 0.5 * size).all():
                depths.append(NEAR_M)
            for axis, side in itertools.product(range(3), (-0.5, 0.5)):
                # Where n . (z ray - centre) = side * size, with n the axis of the box in the camera frame.
                normal = pose[:3, axis]
                z = (side * size[axis] + normal @ pose[:3, 3]) / (normal @ ray)
                point = back[:3, :3] @ (z * ray) + back[:3, 3]
                others = [other for other in range(3) if other != axis]
                if z >= NEAR_M and (np.abs(point[others]) <= 0.5 * size[others]).all():
                    depths.append(z)
        if depths:
            image[row, column] = min(depth_m / min(depths), 1.0)
    return image


def random_boxes(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Boxes in front of, around and behind the camera."""
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    for pose in poses:
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        pose[:3, :3] = turn * np.linalg.det(turn)
        pose[:3, 3] = rng.uniform((-6.0, -4.0, -2.0), (6.0, 4.0, 15.0))
    return poses, rng.uniform(0.5, 5.0, (count, 3)), rng.integers(0, len(COLOURS), count)


@pytest.mark.parametrize("width_px", [1.0, 2.5])
def test_lines_agree_with_the_reference(width_px: float) -> None:
    rng = np.random.default_rng(0)
    segments = rng.uniform((-5.0, -4.0, -1.0), (5.0, 4.0, 8.0), (12, 2, 3))
    segments[0, 1] = segments[0, 0]
    colours = rng.uniform(size=(12, 3))
    drawn = draw_lines(segments, colours, LENS, SIZE, width_px)
    assert (drawn > 0.0).any()
    np.testing.assert_allclose(drawn, reference_lines(segments, colours, width_px), atol=1e-6)


@pytest.mark.parametrize("style", [OWN_STYLE, OPENDWM_STYLE])
def test_boxes_agree_with_the_reference(style: BoxStyle) -> None:
    poses, sizes, category = random_boxes(4, seed=1)
    drawn = draw_boxes(poses, sizes, category, LENS, SIZE, style)
    signs = np.array(list(itertools.product((0.5, -0.5), repeat=3)))
    segments, colours = [], []
    front = [0, 1, 2, 3]  # (+, +-, +-) in the order of `signs`: upper left, lower left, upper right, lower right
    crosses = [(0, 3), (1, 2)] if style is OWN_STYLE else [(1, 2), (1, 4)]
    assert all(signs[corner][0] > 0 for corner in front)
    for place in np.argsort(-poses[:, 2, 3]):
        corners = (poses[place, :3, :3] @ (signs * sizes[place]).T).T + poses[place, :3, 3]
        edges = [(a, b) for a, b in itertools.combinations(range(8), 2) if (signs[a] != signs[b]).sum() == 1]
        # Which edge of one box is drawn first does not matter: all have one colour, up to smooth borders.
        for a, b in [*edges, *crosses]:
            segments.append((corners[a], corners[b]))
            colours.append(COLOURS[category[place]])
    expected = reference_lines(np.array(segments), np.array(colours), style.width_px)
    np.testing.assert_allclose(drawn[:3], expected, atol=1e-6)
    if style.depth:
        np.testing.assert_allclose(drawn[3], reference_depth(poses, sizes, style.depth_m), atol=1e-6)


@settings(max_examples=draws(6), deadline=None)
@given(st.integers(0, 10_000))
def test_depth_agrees_with_the_reference(seed: int) -> None:
    poses, sizes, _ = random_boxes(2, seed)
    expected = reference_depth(poses, sizes, 4.0)
    np.testing.assert_allclose(draw_inverse_depth(poses, sizes, LENS, SIZE, 4.0), expected, atol=1e-6)


def test_a_nearer_box_is_drawn_over_a_farther_one() -> None:
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, 2, 3] = 5.0, 9.0
    sizes = np.array([[2.0, 2.0, 2.0], [4.0, 4.0, 2.0]])
    # Faces at 4 m and at 8 m: the left edges of both are at column 12.5.
    for order in ([0, 1], [1, 0]):
        drawn = draw_boxes(poses[order], sizes[order], np.array([0, 6])[order], LENS, SIZE, OWN_STYLE)
        np.testing.assert_allclose(drawn[:3, 12, 12], COLOURS[0], atol=1e-6)
        assert drawn[3, 12, 20] == pytest.approx(1.0)


def test_a_box_behind_the_camera_leaves_the_image_empty() -> None:
    pose = np.eye(4)[None].copy()
    pose[0, 2, 3] = -5.0
    drawn = draw_boxes(pose, np.array([[4.0, 2.0, 1.5]]), np.array([0]), LENS, SIZE, OWN_STYLE)
    assert not drawn.any()


def test_a_box_around_the_camera_fills_the_depth() -> None:
    drawn = draw_inverse_depth(np.eye(4)[None], np.full((1, 3), 4.0), LENS, SIZE, 4.0)
    assert (drawn == 1.0).all()


def test_no_boxes_give_an_empty_image() -> None:
    drawn = draw_boxes(np.zeros((0, 4, 4)), np.zeros((0, 3)), np.zeros(0, np.int64), LENS, SIZE, OWN_STYLE)
    assert drawn.shape == (4, *SIZE)
    assert not drawn.any()


@pytest.mark.parametrize(("pose", "size"), [(np.nan, 1.0), (0.0, np.inf), (0.0, 0.0), (0.0, -1.0)])
def test_senseless_boxes_are_refused(pose: float, size: float) -> None:
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = pose
    with pytest.raises(UsageError, match="box 1"):
        draw_boxes(poses, np.array([[1.0, 1.0, 1.0], [1.0, 1.0, size]]), np.zeros(2, np.int64), LENS, SIZE, OWN_STYLE)


def test_map_lines_are_drawn_near_the_vehicle_and_crossings_last() -> None:
    across = np.array([[8.0, 3.0, 0.0], [8.0, -3.0, 0.0]])
    far = across + np.array([100.0, 0.0, 0.0])
    camera_SE3_ego = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 1.5], [1.0, 0.0, 0.0, 0.0], [0, 0, 0, 1.0]])
    lines = [MapLine("crossing", across), MapLine("drivable", across), MapLine("lane", far)]
    drawn = draw_map(lines, np.eye(4), camera_SE3_ego, LENS, SIZE, 2.0)
    row = int(31.0 * 1.5 / 8.0 + 12.0)
    np.testing.assert_allclose(drawn[:, row, 20], (1.0, 0.0, 0.0), atol=0.2)
    assert not drawn[1].any()
    with pytest.raises(UsageError, match="not finite"):
        draw_map([MapLine("lane", across * np.nan)], np.eye(4), camera_SE3_ego, LENS, SIZE, 2.0)


def test_the_lines_of_a_map_are_further_channels_behind_those_of_the_boxes() -> None:
    clip = make_clip()
    given = clip.boxes.at(0), clip.intrinsics, clip.ego_SE3_camera, clip.size_px
    points = np.array([[4.0, 3.0, -1.5], [9.0, -2.0, -1.5], [20.0, -1.0, -1.5]])
    lines, pose = [MapLine("lane", points), MapLine("drivable", points + 1.0)], np.eye(4)
    pose[:3, 3] = 1.0, 0.5, 0.2
    plain, both = draw_layout(*given, OWN_STYLE), draw_layout(*given, OWN_STYLE, lines=lines, ego_SE3_line=pose)
    assert plain.any() and both.shape[1] == plain.shape[1] + 3
    np.testing.assert_array_equal(both[:, : plain.shape[1]], plain)
    for view, (lens, mount) in enumerate(zip(clip.intrinsics, clip.ego_SE3_camera)):
        drawn = draw_map(lines, pose, np.linalg.inv(mount), lens, clip.size_px, OWN_STYLE.width_px)
        assert drawn[1].any() and drawn[2].any()
        np.testing.assert_array_equal(both[view, plain.shape[1] :], drawn)


def test_lines_of_a_map_agree_with_the_reference() -> None:
    """Borders first, then lanes, then crossings, whatever their order; segments beyond 65 m are left out."""
    rng = np.random.default_rng(3)
    kinds = ("crossing", "lane", "drivable", "lane")
    lines = [MapLine(kind, rng.uniform((2.0, -8.0, -1.6), (30.0, 8.0, -1.4), (4, 3))) for kind in kinds]
    lines.append(MapLine("lane", np.array([[70.0, 0.0, -1.5], [66.0, 1.0, -1.5], [60.0, 0.0, -1.5]])))
    camera_SE3_ego = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    segments, colours = [], []
    for kind, colour in (("drivable", (0, 0, 1)), ("lane", (0, 1, 0)), ("crossing", (1, 0, 0))):
        for line in lines:
            for start, end in itertools.pairwise(line.points_m):
                if line.kind == kind and min(np.hypot(*start[:2]), np.hypot(*end[:2])) <= 65.0:
                    segments.append([(-one[1], -one[2], one[0]) for one in (start, end)])
                    colours.append(colour)
    drawn = draw_map(lines, np.eye(4), camera_SE3_ego, LENS, SIZE, 1.5)
    expected = reference_lines(np.array(segments), np.array(colours, np.float64), 1.5)
    np.testing.assert_allclose(drawn, expected, atol=1e-6)


def test_colours_are_those_that_released_weights_were_trained_with() -> None:
    published = {
        "pedestrian": (255, 0, 0), "cyclist": (128, 255, 0), "motorcycle": (0, 255, 128), "bus": (128, 0, 255),
        "car": (0, 0, 255), "truck": (255, 255, 0),
    }  # fmt: skip
    found = dict(zip(CATEGORIES, (255.0 * COLOURS).tolist()))
    assert {name: tuple(found[name]) for name in published} == published
