"""Tests of visibility and pixel bounds for objects with known occlusion."""

import numpy as np
import pytest

from mirror.geometry import Poses, matrix_from_quaternion
from mirror.geometry.cameras import Camera
from mirror.synth.model import Label, Material, block, ellipsoid
from mirror.synth.truth.boxes import PosedObject, measure_visibility
from mirror.synth.truth.casting import cast_rays

CAMERA = Camera("pinhole", 160, 120, 120.0, 120.0, 80.0, 60.0)
FORWARD = Poses(np.array([[0.5, -0.5, 0.5, -0.5]]), np.array([[0.0, 0.0, 1.5]]))
GREY = (0.5, 0.5, 0.5)


def box(x: float, y: float, size: tuple[float, float, float], z: float = 1.5) -> PosedObject:
    model = block((x, y, z), size, GREY, Material.PLAIN, Label.CAR, without=())
    return PosedObject(model, Poses(np.array([[1.0, 0, 0, 0]]), np.array([[x, y, z]])), size)


def render_numbers(posed_objects: dict[int, PosedObject], camera: Camera = CAMERA, pose: Poses = FORWARD) -> np.ndarray:
    """Object numbers at the pixel centres."""
    rays = (camera.rays().direction @ matrix_from_quaternion(pose.rotation)[0].T).reshape(-1, 3)
    nearest, numbers = np.full(len(rays), np.inf), np.full(len(rays), -1, np.int32)
    for number, one in posed_objects.items():
        distance = cast_rays(one.model, pose.translation[0], rays)[0]
        numbers[distance < nearest] = number
        nearest = np.minimum(nearest, distance)
    return numbers.reshape(camera.height_px, camera.width_px)


def test_unoccluded_objects_are_fully_visible_within_their_projection() -> None:
    posed_objects = {7: box(11.0, 0.0, (2.0, 1.0, 1.0))}
    visibility = measure_visibility(render_numbers(posed_objects), CAMERA, FORWARD, posed_objects)
    # The front face is at 10 m, half a metre to each side: 6 pixels.
    assert visibility.number.tolist() == [7]
    assert visibility.visibility.tolist() == [1.0]
    assert visibility.bounds_px.tolist() == [[74.0, 54.0, 86.0, 66.0]]
    assert visibility.pixels.tolist() == [144]


def test_visibility_of_half_and_fully_hidden_objects() -> None:
    posed_objects = {
        0: box(21.0, 0.0, (2.0, 2.0, 2.0)),
        1: box(10.5, -2.0, (1.0, 4.0, 4.0)),
        2: box(16.5, -2.0, (1.0, 1.0, 1.0)),
    }
    visibility = measure_visibility(render_numbers(posed_objects), CAMERA, FORWARD, posed_objects)
    assert visibility.number.tolist() == [0, 1, 2]
    assert visibility.visibility.tolist() == [0.5, 1.0, 0.0]
    assert visibility.pixels[2] == 0
    assert np.isnan(visibility.bounds_px[2]).all()
    assert visibility.bounds_px[0].tolist() == [74.0, 54.0, 80.0, 66.0]


def test_pixels_outside_the_raster_do_not_count() -> None:
    half_out = {0: box(10.5, 80.0 / 120.0 * 10.0, (1.0, 2.0, 1.0)), 1: box(-9.0, 0.0, (1.0, 1.0, 1.0))}
    visibility = measure_visibility(render_numbers(half_out), CAMERA, FORWARD, half_out)
    assert visibility.number.tolist() == [0]
    assert visibility.visibility.tolist() == [1.0]
    assert visibility.bounds_px[0, 0] == 0.0


def test_large_objects_use_a_coarser_grid() -> None:
    camera = Camera("kannala_brandt", 640, 480, 300.0, 300.0, 320.0, 240.0, (-0.01, 0.0, 0.0, 0.0))
    posed_objects = {0: box(4.0, 0.3, (2.0, 3.0, 2.5)), 1: box(2.2, 0.0, (0.2, 0.4, 3.0))}
    numbers = render_numbers(posed_objects, camera)
    visibility = measure_visibility(numbers, camera, FORWARD, posed_objects)
    alone = render_numbers({0: posed_objects[0]}, camera) == 0
    assert visibility.visibility[0] == pytest.approx((numbers == 0).sum() / alone.sum(), abs=0.01)
    assert visibility.pixels.tolist() == [(numbers == 0).sum(), (numbers == 1).sum()]


def test_nested_and_round_objects_are_distinguished() -> None:
    ball = ellipsoid((12.0, 1.0, 1.5), (1.0, 1.0, 1.0), GREY, Material.PLAIN, Label.PERSON)
    posed_objects = {
        3: PosedObject(ball, Poses(np.array([[1.0, 0, 0, 0]]), np.array([[12.0, 1.0, 1.5]])), (1.0, 1.0, 1.0))
    }
    numbers = render_numbers(posed_objects)
    visibility = measure_visibility(numbers, CAMERA, FORWARD, posed_objects)
    assert visibility.visibility.tolist() == [1.0]
    v, u = np.nonzero(numbers == 3)
    assert visibility.bounds_px[0].tolist() == [u.min(), v.min(), u.max() + 1, v.max() + 1]


def test_image_pixels_count_even_without_a_sampled_ray() -> None:
    thin = {0: box(30.0, 0.02, (1.0, 0.001, 1.0))}
    numbers = np.full((120, 160), -1, np.int32)
    assert len(measure_visibility(numbers, CAMERA, FORWARD, thin)) == 0
    numbers[60, 79] = 0
    visibility = measure_visibility(numbers, CAMERA, FORWARD, thin)
    assert (visibility.pixels.tolist(), visibility.visibility.tolist()) == ([1], [1.0])


def test_an_empty_list_of_objects_gives_no_rows() -> None:
    nothing = np.full((120, 160), -1, np.int32)
    assert len(measure_visibility(nothing, CAMERA, FORWARD, {})) == 0
    hidden = measure_visibility(nothing, CAMERA, FORWARD, {0: box(9.0, 0.0, (1.0, 1.0, 1.0))})
    assert (hidden.pixels.tolist(), hidden.visibility.tolist()) == ([0], [0.0])
