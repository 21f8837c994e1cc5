"""Camera models against OpenCV, against their definitions, and against themselves inverted."""

from __future__ import annotations

import pickle

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mirror.errors import UsageError
from mirror.geometry import Camera, camera_from_row
from mirror.geometry.cameras import camera_from_attributes
from mirror.geometry.cameras.perspective import Perspective
from tests.draws import draws
from tests.geometry.cameras import CAMERAS, each_model


def seen_points(camera: Camera, count: int = 20_000, seed: int = 0) -> np.ndarray:
    """Points in front of the camera, in and around its image."""
    generator = np.random.default_rng(seed)
    rays = camera.unproject(generator.uniform((-50, -50), (1970, 1130), (count, 2)))
    return rays.direction[rays.valid] * generator.uniform(0.5, 80.0, (int(rays.valid.sum()), 1))


def opencv_pixels(camera: Camera, points: np.ndarray) -> np.ndarray:
    matrix, zero = camera.intrinsic_matrix(first_pixel_centre=0.0), np.zeros(3)
    distortion = np.array(camera.distortion or (0.0,) * 4)
    if camera.model == "kannala_brandt":
        return cv2.fisheye.projectPoints(points[:, None], zero, zero, matrix, distortion)[0][:, 0]
    return cv2.projectPoints(points, zero, zero, matrix, distortion)[0][:, 0]


@pytest.mark.parametrize("model", ["pinhole", "brown_conrady", "rational", "kannala_brandt"])
def test_project_agrees_with_opencv_whose_pixels_are_half_a_pixel_less(model: str) -> None:
    camera = CAMERAS[model]
    points = seen_points(camera)
    points = points[points[:, 2] > 0.05 * np.linalg.norm(points, axis=1)]
    ours = camera.project(points)
    assert ours.defined.all()
    assert np.abs(ours.uv_px - (opencv_pixels(camera, points) + 0.5)).max() < 1e-10
    assert (ours.depth_m == points[:, 2]).all()


def test_f_theta_is_its_polynomial() -> None:
    camera = CAMERAS["f_theta"]
    angle = np.linspace(0.0, 2.5, 50)
    rays = np.stack((0.6 * np.sin(angle), -0.8 * np.sin(angle), np.cos(angle)), axis=-1)
    radius = sum(value * angle**power for power, value in enumerate(camera.distortion))
    expected = np.stack((camera.cx_px + 0.6 * radius, camera.cy_px - 0.8 * radius), axis=-1)
    projection = camera.project(7.0 * rays)
    assert np.abs(projection.uv_px - expected).max() < 1e-10
    assert (projection.depth_m < 0).any()


@each_model
def test_unproject_inverts_project(camera: Camera) -> None:
    points = seen_points(camera)
    projection = camera.project(points)
    rays = camera.unproject(projection.uv_px)
    assert rays.valid.all()
    unit = points / np.linalg.norm(points, axis=1, keepdims=True)
    assert np.abs(rays.direction - unit).max() < 1e-11
    assert np.abs(np.linalg.norm(rays.direction, axis=1) - 1.0).max() < 1e-15
    assert np.abs(camera.project(rays.direction).uv_px - projection.uv_px).max() < 1e-9


@each_model
def test_every_pixel_has_the_ray_that_comes_back(camera: Camera) -> None:
    small = camera.scaled(0.1)
    rays = small.rays()
    assert rays.direction.shape == (108, 192, 3)
    assert rays.valid.all()
    back = small.project(rays.direction).uv_px
    assert np.abs(back - np.stack(np.meshgrid(np.arange(192) + 0.5, np.arange(108) + 0.5), axis=-1)).max() < 1e-9


@each_model
def test_validity(camera: Camera) -> None:
    assert camera.project([0.0, 0.0, 1.0]).uv_px.tolist() == [camera.cx_px, camera.cy_px]
    projection = camera.project(
        [[0.0, 0, -1], [0.1, 0.1, 0.0], [np.nan, 0, 1], [np.inf, 0, 1], [0, 0, np.inf], [0] * 3]
    )
    assert not projection.valid[[0, 2, 3, 5]].any()
    assert np.isnan(projection.uv_px[[0, 2, 3, 5]]).all()
    if camera.lens.forward_only:
        assert not projection.defined[1]
    outside = camera.project(camera.unproject([[-1e-6, 5.0], [1919.9999, 5.0], [1920.0 + 1e-6, 5.0]]).direction)
    assert outside.valid.tolist() == [False, True, False]
    assert outside.defined.all()
    assert not camera.unproject([np.nan, 3.0]).valid
    assert not camera.unproject([[np.inf, 3.0]]).valid.any()


@each_model
def test_shapes(camera: Camera) -> None:
    assert camera.project(np.empty((0, 3))).uv_px.shape == (0, 2)
    assert camera.project(np.ones((2, 3, 3))).valid.shape == (2, 3)
    assert camera.project(np.ones(3)).depth_m.shape == ()
    assert camera.unproject(np.empty((0, 2))).direction.shape == (0, 3)
    with pytest.raises(UsageError, match="shape"):
        camera.project(np.ones((2, 2)))
    with pytest.raises(UsageError, match="shape"):
        camera.unproject(np.ones((2, 3)))


def test_the_limit_of_a_polynomial_is_the_closed_form() -> None:
    # r (1 + k1 r^2): the slope 1 + 3 k1 r^2 vanishes at 1 / sqrt(-3 k1).
    camera = Camera("brown_conrady", 100, 100, 50.0, 50.0, 50.0, 50.0, (-0.25, 0, 0, 0, 0))
    limit = np.sqrt(4 / 3)
    assert np.tan(camera.angle_limit_rad) == pytest.approx(limit, rel=1e-15)
    assert camera.project([limit * (1 - 1e-12), 0, 1]).defined
    assert not camera.project([limit * (1 + 1e-12), 0, 1]).defined
    # theta (1 + k1 theta^2), and one that turns back twice: only the first turn counts.
    fisheye = Camera("kannala_brandt", 100, 100, 50.0, 50.0, 50.0, 50.0, (-0.25, 0, 0, 0))
    assert fisheye.angle_limit_rad == pytest.approx(limit, rel=1e-15)
    k1, k2 = -(1 + 1 / 4) / 3, (1 / 4) / 5  # slope (1 - t^2)(1 - t^2 / 4)
    twice = Camera("kannala_brandt", 100, 100, 50.0, 50.0, 50.0, 50.0, (k1, k2, 0, 0))
    assert twice.angle_limit_rad == pytest.approx(1.0, rel=1e-12)
    assert CAMERAS["pinhole"].angle_limit_rad == np.pi / 2
    assert Camera("kannala_brandt", 9, 9, 5.0, 5.0, 4.0, 4.0, (0.0,) * 4).angle_limit_rad == np.pi


def test_the_limit_of_a_rational_model_is_its_turn_or_its_pole() -> None:
    # r / (1 + k4 r^2) turns back at 1 / sqrt(k4); with k4 < 0 it has its pole at 1 / sqrt(-k4).
    for k4 in (0.25, -0.25):
        camera = Camera("rational", 100, 100, 50.0, 50.0, 50.0, 50.0, (0, 0, 0, 0, 0, k4, 0, 0))
        assert np.tan(camera.angle_limit_rad) == pytest.approx(2.0, rel=1e-14)


def test_with_tangential_terms_the_map_is_one_to_one_up_to_the_limit() -> None:
    camera = Camera("brown_conrady", 2000, 2000, 500.0, 500.0, 1000.0, 1000.0, (-0.2, 0, 0.01, -0.02, 0))
    limit = np.tan(camera.angle_limit_rad)
    assert limit < np.sqrt(1 / 0.6)
    grid = np.stack(np.meshgrid(*(np.linspace(-limit, limit, 401),) * 2), axis=-1).reshape(-1, 2)
    grid = grid[np.linalg.norm(grid, axis=1) < limit * (1 - 1e-6)]
    step = 1e-6
    ones = np.ones((len(grid), 1))

    def image(points: np.ndarray) -> np.ndarray:
        return camera.project(np.concatenate((points, ones), axis=1)).uv_px

    inner = image(grid)
    du, dv = image(grid + np.array([step, 0.0])) - inner, image(grid + np.array([0.0, step])) - inner
    determinant = (du[:, 0] * dv[:, 1] - du[:, 1] * dv[:, 0]) / step**2 / 500.0**2
    least = np.nanmin(determinant)
    assert 0 < least < 0.01
    rays = camera.unproject(inner)
    assert rays.valid.mean() > 0.999
    assert np.nanmax(np.abs(camera.project(rays.direction).uv_px - inner)) < 1e-9


@given(
    st.tuples(*(st.floats(-2, 2) for _ in range(2)), *(st.floats(-0.02, 0.02) for _ in range(2)), st.floats(-1, 1)),
    st.tuples(*(st.floats(-2, 2) for _ in range(3))),
    st.booleans(),
)
@settings(max_examples=draws(150), deadline=None)
def test_perspective_round_trip_whatever_the_coefficients(
    brown: tuple[float, ...], rational: tuple[float, ...], is_rational: bool
) -> None:
    camera = Camera(
        "rational", 1000, 800, 400.0, 400.0, 500.0, 400.0, brown + (rational if is_rational else (0.0,) * 3)
    )
    angle = np.linspace(0.0, 0.999 * min(camera.angle_limit_rad, np.radians(80)), 60)
    check_round_trip(camera, angle)


def test_hard_lenses_are_inverted_up_to_their_limit() -> None:
    """Lenses far beyond any real one, where Newton's method needs short steps from a good start."""
    generator = np.random.default_rng(0)
    share = np.linspace(0.0, 1.0, 60)
    for number in range(100):
        brown = (*generator.uniform(-2, 2, 2), *generator.uniform(-0.02, 0.02, 2), generator.uniform(-1, 1))
        rational = tuple(generator.uniform(-2, 2, 3)) if number % 2 else (0.0, 0.0, 0.0)
        camera = Camera("rational", 1000, 800, 400.0, 400.0, 500.0, 400.0, (*brown, *rational))
        rays = rays_at(0.9999 * min(camera.angle_limit_rad, np.radians(80)) * share)
        projection = camera.project(rays)
        back = camera.unproject(projection.uv_px)
        assert back.valid.all()
        # Close to a pole pixels lie anywhere.
        near = np.abs(projection.uv_px).max(axis=1) < 10_000
        assert np.abs(camera.project(back.direction).uv_px - projection.uv_px)[near].max() < 1e-8
        assert np.abs(back.direction - rays)[:50].max() < 1e-9


@pytest.mark.parametrize("model", ["brown_conrady", "rational"])
def test_an_image_of_a_real_lens_needs_no_careful_steps(model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    careful: list[int] = []
    slow = Perspective.undistort_carefully

    def counted(self: Perspective, u: np.ndarray, v: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, ...]:
        careful.append(len(u))
        return slow(self, u, v, radius)

    monkeypatch.setattr(Perspective, "undistort_carefully", counted)
    assert CAMERAS[model].scaled(0.1).rays().valid.all()
    assert not careful


@given(st.tuples(*(st.floats(-0.5, 0.5) for _ in range(4))), st.floats(-0.3, 0.3))
@settings(max_examples=draws(100), deadline=None)
def test_fisheye_round_trip_whatever_the_coefficients(coefficients: tuple[float, ...], even: float) -> None:
    kannala = Camera("kannala_brandt", 1000, 800, 400.0, 400.0, 500.0, 400.0, coefficients)
    f_theta = Camera("f_theta", 1000, 800, 1.0, 1.0, 500.0, 400.0, (0.0, 400.0, 400 * even, 400 * coefficients[0]))
    for camera in (kannala, f_theta):
        check_round_trip(camera, np.linspace(0.0, 0.9999 * camera.angle_limit_rad, 60))


def rays_at(angle: np.ndarray) -> np.ndarray:
    """Rays at angles from the axis, each in another direction around it."""
    around = 2.4 * np.arange(len(angle))
    return np.stack((np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)), axis=-1)


def check_round_trip(camera: Camera, angle: np.ndarray) -> None:
    rays = rays_at(angle)
    projection = camera.project(rays)
    assert projection.defined.all()
    scale = np.abs(projection.uv_px).max()
    assume(scale < 1e6)
    back = camera.unproject(projection.uv_px)
    assert back.valid.all()
    assert np.abs(camera.project(back.direction).uv_px - projection.uv_px).max() < 1e-9 * max(1.0, scale / 1000)
    # At the limit a pixel hardly moves with the angle, so the angle is known less well than the pixel.
    inner = angle < 0.9 * camera.angle_limit_rad
    assert np.abs(back.direction - rays)[inner].max() < 1e-9


def test_beyond_the_range_there_is_no_ray() -> None:
    camera = Camera("brown_conrady", 1000, 1000, 300.0, 300.0, 500.0, 500.0, (-0.25, 0, 0, 0, 0))
    farthest = 300.0 * np.sqrt(4 / 3) * (2 / 3)
    radius = np.array([0.0, 0.5, 1 - 1e-6, 1 + 1e-9, 1.2, 5.0]) * farthest
    rays = camera.unproject(np.stack((500 + radius, np.full(6, 500.0)), axis=-1))
    assert rays.valid.tolist() == [True, True, True, False, False, False]
    assert np.isnan(rays.direction[3:]).all()
    fisheye = Camera("kannala_brandt", 1000, 1000, 300.0, 300.0, 500.0, 500.0, (-0.25, 0, 0, 0))
    rays = fisheye.unproject(np.stack((500 + radius, np.full(6, 500.0)), axis=-1))
    assert rays.valid.tolist() == [True, True, True, False, False, False]


def test_rasters_and_matrices() -> None:
    camera = CAMERAS["brown_conrady"]
    points = seen_points(camera, 500)
    uv = camera.project(points).uv_px
    assert np.allclose(camera.scaled(0.5).project(points).uv_px, 0.5 * uv, atol=1e-9)
    assert np.allclose(camera.resized(640, 270).project(points).uv_px, uv * (640 / 1920, 270 / 1080), atol=1e-9)
    assert np.allclose(camera.cropped(100, 50, 800, 600).project(points).uv_px, uv - (100, 50), atol=1e-9)
    f_theta = CAMERAS["f_theta"]
    points = seen_points(f_theta, 500)
    assert np.allclose(f_theta.scaled(0.5).project(points).uv_px, 0.5 * f_theta.project(points).uv_px, atol=1e-9)
    assert camera.intrinsic_matrix()[0, 2] == camera.intrinsic_matrix(first_pixel_centre=0.0)[0, 2] + 0.5


def test_undistort_maps_agree_with_opencv() -> None:
    camera, target = CAMERAS["brown_conrady"].scaled(0.25), CAMERAS["pinhole"].scaled(0.25)
    ours = camera.undistort_maps(target)
    theirs = cv2.initUndistortRectifyMap(
        camera.intrinsic_matrix(first_pixel_centre=0.0),
        np.array(camera.distortion),
        None,
        target.intrinsic_matrix(first_pixel_centre=0.0),
        (target.width_px, target.height_px),
        cv2.CV_32FC1,
    )
    for one, other in zip(ours, theirs):
        assert np.abs(one - other).max() < 1e-3


def test_from_a_row_and_what_is_no_camera() -> None:
    camera = CAMERAS["kannala_brandt"]
    row = {**vars(camera), "camera": "front_wide", "distortion": np.array(camera.distortion)}
    assert camera_from_row(row) == camera
    assert hash(camera_from_row(row)) == hash(camera)
    for change, words in (
        ({"model": "fish"}, "pinhole, brown_conrady, rational, kannala_brandt, f_theta"),
        ({"distortion": [1.0]}, "k1 k2 k3 k4"),
        ({"distortion": [np.nan] * 4}, "finite"),
        ({"distortion": None}, "row of the calibrations table"),
        ({"fx_px": 0.0}, "fx, fy > 0"),
        ({"width_px": 0}, "pixel"),
        ({"model": "f_theta", "distortion": [1.0, 600.0]}, "c0 = 0"),
        ({"model": "f_theta", "distortion": [0.0, 0.0, 600.0]}, "c1 > 0"),
    ):
        with pytest.raises(UsageError) as error:
            camera_from_row({**row, **change})
        assert words in str(error.value)
        assert "camera front_wide" in str(error.value)
    with pytest.raises(UsageError, match="cx_px"):
        camera_from_row({key: value for key, value in row.items() if key != "cx_px"})


@each_model
def test_a_row_has_the_values_of_its_camera(camera: Camera) -> None:
    row = camera.to_row()
    assert list(row) == ["model", "width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px", "distortion"]
    assert camera_from_row(row) == camera == camera_from_attributes(camera)


def test_later_coefficients_of_f_theta_have_any_sign() -> None:
    camera = Camera("f_theta", 1000, 800, 1.0, 1.0, 500.0, 400.0, (0.0, 400.0, -5.0, 1.0))
    assert np.allclose(camera.project(np.array([[np.sin(0.3), 0.0, np.cos(0.3)]])).uv_px, [[500.0 + 119.577, 400.0]])


@each_model
@pytest.mark.parametrize("distance_m", [1e-9, 0.5, 1e9])
def test_the_axis_is_imaged_at_the_principal_point_at_any_distance(camera: Camera, distance_m: float) -> None:
    projection = camera.project(np.array([[0.0, 0.0, distance_m], [0.0, 0.0, -distance_m]]))
    assert projection.defined.tolist() == [True, False]
    assert projection.uv_px[0].tolist() == [camera.cx_px, camera.cy_px]


@each_model
def test_survives_pickling_and_blocks(camera: Camera) -> None:
    points = seen_points(camera)
    whole = camera.project(points)
    again = pickle.loads(pickle.dumps(camera)).project(points[5000:5010])
    assert (again.uv_px == whole.uv_px[5000:5010]).all()


@given(
    st.sampled_from(["brown_conrady", "rational", "kannala_brandt", "f_theta"]),
    st.lists(st.floats(), min_size=8, max_size=8),
    st.floats(),
)
@settings(max_examples=draws(300), deadline=None)
def test_any_numbers_make_a_camera_or_are_refused(model: str, numbers: list[float], focal: float) -> None:
    """A camera that is made has a lens that can be worked out: never a LinAlgError where it is first used."""
    count = {"brown_conrady": 5, "rational": 8, "kannala_brandt": 4, "f_theta": 5}[model]
    distortion = tuple(numbers[:count]) if model != "f_theta" else (0.0, *numbers[1:count])
    try:
        camera = Camera(model, 64, 48, focal, focal, 32.0, 24.0, distortion)
    except UsageError:
        return
    with np.errstate(all="ignore"):
        camera.rays()
        camera.project(np.array([[0.1, 0.2, 1.0], [0.0, 0.0, 1.0]]))


@pytest.mark.parametrize("coefficient", [1e308, -1e308, 1e150])
@pytest.mark.parametrize("model", ["brown_conrady", "rational", "kannala_brandt", "f_theta"])
def test_coefficients_beyond_any_lens_are_refused(model: str, coefficient: float) -> None:
    count = {"brown_conrady": 5, "rational": 8, "kannala_brandt": 4, "f_theta": 4}[model]
    with pytest.raises(UsageError, match="distortion"):
        Camera(model, 64, 48, 50.0, 50.0, 32.0, 24.0, (0.0, 50.0, *[coefficient] * (count - 2)))


def test_undistort_maps_lead_nowhere_where_a_camera_sees_nothing() -> None:
    """The radius of an image point r (1 - 0.3 r^2) has its greatest value at r = 1.054: no ray beyond it is seen."""
    camera = Camera("brown_conrady", 100, 80, 50.0, 50.0, 50.0, 40.0, (-0.3, 0.0, 0.0, 0.0, 0.0))
    target = Camera("pinhole", 100, 80, 20.0, 20.0, 50.0, 40.0)
    x, y = (np.arange(100) + 0.5 - 50.0) / 20.0, (np.arange(80) + 0.5 - 40.0) / 20.0
    radius = np.hypot(*np.meshgrid(x, y))
    for found in camera.undistort_maps(target):
        assert (found[radius > 1.06] == -1.0).all()
        assert (np.abs(found[radius < 1.05] + 1.0) > 1.0).all()
