"""Tests of image motion against exact projection, and of motion blur against its integral."""

import numpy as np
import pytest

from mirror.geometry.cameras import Camera
from mirror.synth.render.develop import compute_image_jacobian, compute_image_motion
from mirror.synth.render.develop.motion import apply_motion_blur

LENSES = [
    Camera("pinhole", 480, 270, 300.0, 300.0, 240.0, 135.0, ()),
    Camera("kannala_brandt", 480, 270, 220.0, 220.0, 240.0, 135.0, (-0.012, 0.004, -0.002, 0.0)),
    Camera("brown_conrady", 480, 270, 275.0, 280.0, 236.0, 138.0, (-0.17, 0.022, 0.0006, -0.0004, 0.0)),
]


@pytest.mark.parametrize("camera", LENSES, ids=lambda camera: camera.model)
def test_motion_of_static_points_matches_their_projection(camera: Camera) -> None:
    rng = np.random.default_rng(2)
    rays = camera.rays().direction
    distance = rng.uniform(5.0, 40.0, (270, 480)).astype(np.float32)
    velocity, turn, exposure = np.array([3.0, -0.5, 12.0]), np.array([0.05, -0.4, 0.1]), 0.01
    flow = compute_image_motion(compute_image_jacobian(rays), distance, velocity, turn, exposure)
    points = rays * distance[..., None]

    def projected(time: float) -> np.ndarray:
        moved = points - time * (velocity + np.cross(turn, points))
        return camera.project(moved.reshape(-1, 3)).uv_px.reshape(270, 480, 2)

    exact = projected(0.5 * exposure) - projected(-0.5 * exposure)
    size = np.linalg.norm(exact, axis=-1)
    error = np.linalg.norm(flow - exact, axis=-1)
    assert size.max() > 4.0
    assert error.max() < 0.02 * size.max()
    assert error.mean() < 0.01 * size.mean()


def test_motion_of_the_sky_depends_only_on_rotation() -> None:
    jacobian = compute_image_jacobian(LENSES[0].rays().direction)
    sky = np.full((270, 480), np.inf, np.float32)
    assert not compute_image_motion(jacobian, sky, (0.0, 0.0, 20.0), (0.0, 0.0, 0.0), 0.01).any()
    # A right turn moves the image to the left, 300 px per radian in the middle.
    flow = compute_image_motion(jacobian, sky, (0.0, 0.0, 20.0), (0.0, 1.0, 0.0), 0.05)
    assert flow[135, 240] == pytest.approx([-15.0, 0.0], abs=0.05)


@pytest.mark.parametrize("length", [2.0, 4.0, 9.0])
def test_a_blurred_edge_is_a_ramp_of_the_motion_length(length: float) -> None:
    image = np.zeros((20, 60, 3), np.float32)
    image[:, 30:] = 1.0
    flow = np.zeros((20, 60, 2), np.float32)
    flow[..., 0] = length
    ramp = np.clip((np.arange(60) + 0.5 - 30.0) / length + 0.5, 0.0, 1.0)
    out = apply_motion_blur(image, flow)
    assert np.array_equal(out[0], out[19])
    assert np.abs(out[5, :, 0] - ramp).max() < 0.26
    assert np.abs(out[5, :, 0] - ramp).mean() < 0.02
    assert np.array_equal(
        apply_motion_blur(image.swapaxes(0, 1).copy(), flow.swapaxes(0, 1)[..., ::-1].copy()), out.swapaxes(0, 1)
    )


def test_uniform_images_and_short_motions_are_unchanged() -> None:
    rng = np.random.default_rng(0)
    image = rng.random((30, 40, 3)).astype(np.float32)
    assert np.array_equal(apply_motion_blur(image, np.full((30, 40, 2), 0.5, np.float32)), image)
    even = np.full_like(image, 0.7)
    flow = rng.normal(0.0, 30.0, (30, 40, 2)).astype(np.float32)
    assert apply_motion_blur(even, flow) == pytest.approx(even, rel=1e-5)
    assert apply_motion_blur(image, flow).min() >= 0.0
