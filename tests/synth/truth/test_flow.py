"""Tests of flow against closed forms and individually projected points."""

import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.geometry import Poses, matrix_from_quaternion
from mirror.geometry.cameras import Camera
from mirror.synth.truth import static_flow
from mirror.synth.truth.casting import cast_rays
from tests.synth.truth.models import ball, square

PINHOLE = Camera("pinhole", 80, 60, 70.0, 70.0, 40.0, 30.0)
FISHEYE = Camera("kannala_brandt", 80, 60, 35.0, 35.0, 41.0, 29.0, (-0.01, 0.003, 0.0, 0.0))
STILL = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 3)))


def moved(*twist: float) -> Poses:
    return STILL @ Poses.exp(np.array([twist]))


def wall(camera: Camera, depth_m: float) -> np.ndarray:
    """Distances to the plane z = depth in front of the camera."""
    return depth_m / camera.rays().direction[..., 2]


def test_sideways_motion_before_a_wall_gives_uniform_flow() -> None:
    flow = static_flow(wall(PINHOLE, 5.0), PINHOLE, STILL, PINHOLE, moved(0, 0, 0, 0.5, -0.2, 0.0))
    assert flow.dtype == np.float32
    assert np.abs(flow - [-70.0 * 0.5 / 5.0, 70.0 * 0.2 / 5.0]).max() < 1e-5


def test_forward_motion_before_a_wall_gives_expanding_flow() -> None:
    flow = static_flow(wall(PINHOLE, 5.0), PINHOLE, STILL, PINHOLE, moved(0, 0, 0, 0, 0, 1.0))
    u, v = np.meshgrid(np.arange(80) + 0.5 - 40, np.arange(60) + 0.5 - 30)
    assert np.abs(flow - np.stack([u, v], axis=-1) * (5.0 / 4.0 - 1.0)).max() < 1e-5


def test_flow_of_the_sky_depends_only_on_rotation() -> None:
    level = Camera("pinhole", 80, 2, 70.0, 70.0, 40.0, 0.5)
    sky = np.full((2, 80), np.inf)
    turn = (0.0, 0.1, 0.0)
    still, driving = (static_flow(sky, level, STILL, level, moved(*turn, 0, 0, z)) for z in (0.0, 7.0))
    assert np.array_equal(still, driving)
    u = np.arange(80) + 0.5
    expected = 40.0 + 70.0 * np.tan(np.arctan((u - 40.0) / 70.0) - 0.1) - u
    assert np.abs(still[0, :, 0] - expected).max() < 1e-5


def test_flow_is_zero_without_motion_and_nan_behind_the_camera() -> None:
    assert np.abs(static_flow(wall(FISHEYE, 3.0), FISHEYE, STILL, FISHEYE, STILL)).max() < 1e-6
    assert np.isnan(static_flow(wall(PINHOLE, 3.0), PINHOLE, STILL, PINHOLE, moved(0, 0, 0, 0, 0, 4.0))).all()


@pytest.mark.parametrize("offset_m", [0.0, 3e5])
def test_flow_maps_points_of_sphere_and_floor_onto_themselves(offset_m: float) -> None:
    """Distances of one view, moved along the flow, match the other view's own rays."""
    shift = np.array([offset_m, -offset_m, 0.0])
    first = Poses(STILL.rotation, shift[None])
    later = Poses(moved(0.02, -0.05, 0.03, 0.3, 0.1, 0.4).rotation, np.array([[0.3, 0.1, 0.4]]) + shift)
    models = [ball((0.2, 0.1, 6.0), 1.5), square(30.0, 9.0, two_sided=True)]
    scene = [model.transform(np.eye(3), shift) for model in models]

    def distances(camera: Camera, pose: Poses, uv: np.ndarray | None = None) -> np.ndarray:
        direction = (camera.rays() if uv is None else camera.unproject(uv)).direction
        world = direction @ matrix_from_quaternion(pose.rotation)[0].T
        each = [cast_rays(one, pose.translation[0], world.reshape(-1, 3))[0] for one in scene]
        return np.minimum(*each).reshape(direction.shape[:-1])

    there = distances(PINHOLE, first)
    flow = static_flow(there, PINHOLE, first, FISHEYE, later)
    u, v = np.meshgrid(np.arange(80) + 0.5, np.arange(60) + 0.5)
    landed = np.stack([u, v], axis=-1) + flow
    points = first.transform((PINHOLE.rays().direction * there[..., None]).reshape(-1, 3))[0].reshape(60, 80, 3)
    expected = np.linalg.norm(points - later.translation[0], axis=-1)
    met = distances(FISHEYE, later, landed)
    # The far side of the sphere is hidden from the second position, where a nearer surface is hit.
    assert (met < expected + 1e-3).all()
    assert (np.abs(met - expected) < 1e-3).mean() > 0.9


def test_a_different_raster_is_refused() -> None:
    with pytest.raises(UsageError, match=r"shape \(80, 60\)"):
        static_flow(np.ones((80, 60)), PINHOLE, STILL, PINHOLE, STILL)
