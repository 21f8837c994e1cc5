"""The tracker on images that are warped exactly, and on the synthetic street with its truth."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from mirror.calibration.affine import refine_tracks
from mirror.calibration.frame_choice import FrameChoice, choose_stretch, nearest_distinct
from mirror.calibration.tracking import TrackedImage, TrackingOptions, find_corners, fit_one_pose, track_pair, track_rig
from mirror.geometry import Poses, quaternion_exp
from mirror.geometry.cameras import Camera

CAMERA = Camera("pinhole", 320, 240, 260.0, 260.0, 161.0, 119.0)


def texture(height: int = 480, width: int = 640, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    smooth = cv2.GaussianBlur(rng.normal(size=(height, width)).astype(np.float32), (0, 0), 2.0)
    return np.clip(128.0 + 40.0 * smooth / smooth.std(), 0, 255)


def view_of_plane(image: np.ndarray, camera: Camera, camera_SE3_plane: Poses, per_m: float = 60.0) -> np.ndarray:
    """Render a textured plane z = 0 for a pinhole."""
    rays = camera.rays().direction.reshape(-1, 3)
    plane = camera_SE3_plane.inverse()
    origin, ends = plane.transform(np.zeros((1, 3)))[0], plane.transform(rays)[0]
    ways = ends - origin
    at = origin - ways * (origin[0, 2] / ways[:, 2:])
    maps = (at[:, :2] * per_m + [320.0, 240.0]).reshape(camera.height_px, camera.width_px, 2).astype(np.float32)
    return cv2.remap(image, maps[..., 0], maps[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT).astype(np.uint8)


def test_points_of_a_slanted_plane_are_tracked_to_their_true_places() -> None:
    image = texture().astype(np.float32)
    poses = [Poses(quaternion_exp(np.array([[0.45, tilt, 0.0]])), np.array([[0.1 * side, 0.0, away]]))
             for tilt, side, away in ((0.3, 0.0, 3.0), (0.2, 1.0, 2.6))]  # fmt: skip
    first, second = (TrackedImage.from_grey(view_of_plane(image, CAMERA, pose)) for pose in poses)
    moved = poses[1] @ poses[0].inverse()
    corners = find_corners(first, TrackingOptions())
    one, two = track_pair(first, second, corners, CAMERA, moved, replace(TrackingOptions(), epipolar_px=5.0))
    assert len(one) > 60
    back = poses[0].inverse()
    origin = back.transform(np.zeros((1, 3)))[0]
    ways = back.transform(CAMERA.unproject(one).direction)[0] - origin
    points = origin - ways * (origin[0, 2] / ways[:, 2:])
    error = two - CAMERA.project(poses[1].transform(points)[0]).uv_px
    assert np.abs(np.median(error, axis=0)).max() < 0.03
    assert np.median(np.linalg.norm(error, axis=1)) < 0.1


def test_an_affine_warp_is_found_to_hundredths_of_a_pixel() -> None:
    image = cv2.GaussianBlur(texture(), (0, 0), 1.5).astype(np.float32)
    linear = np.array([[1.06, 0.08], [-0.05, 0.94]])
    shift = np.array([3.3, -2.6])
    inverse = np.linalg.inv(linear)
    warped = cv2.warpAffine(
        image, np.column_stack([inverse, -inverse @ shift]), (640, 480), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    )
    points = np.random.default_rng(2).uniform(80.0, 380.0, (60, 2))
    true = points @ linear.T + shift
    found, good = refine_tracks(image, 0.8 * warped + 20.0, points, true + 0.4)
    assert good.mean() > 0.9
    # OpenCV's warp itself rounds coordinates to 1/32 px.
    assert np.median(np.linalg.norm(found - true, axis=1)[good]) < 0.03
    assert np.linalg.norm(found - true, axis=1)[good].max() < 0.08


def test_points_without_texture_or_near_the_edge_are_not_refined() -> None:
    flat = np.full((100, 100), 80.0, np.float32)
    points = np.array([[50.0, 50.0], [3.0, 50.0], [98.5, 98.5]])
    out, good = refine_tracks(flat, flat, points, points)
    assert not good.any()
    assert (out == points).all()
    assert refine_tracks(flat, flat, points[:0], points[:0])[1].shape == (0,)


def test_masked_pixels_have_no_corners() -> None:
    grey = texture().astype(np.uint8)
    still = np.zeros(grey.shape, bool)
    still[100:300, 200:500] = True
    corners = find_corners(TrackedImage.from_grey(grey, still), TrackingOptions())
    assert len(corners) > 20
    assert (corners >= [204.0, 104.0]).all()
    assert (corners <= [495.0, 295.0]).all()
    assert not len(find_corners(TrackedImage.from_grey(np.zeros((60, 80), np.uint8)), TrackingOptions()))


def test_wrong_tracks_do_not_fit_the_common_pose() -> None:
    rng = np.random.default_rng(5)
    points = rng.uniform((-4.0, -3.0, 6.0), (4.0, 3.0, 20.0), (300, 3))
    moved = Poses(quaternion_exp(np.array([[0.0, 0.05, 0.0]])), np.array([[0.2, 0.0, -1.0]]))
    one, two = CAMERA.project(points), CAMERA.project(moved.transform(points)[0])
    valid = one.valid & two.valid
    first, second = one.uv_px[valid], two.uv_px[valid]
    wrong = rng.random(len(first)) < 0.2
    second = second + wrong[:, None] * rng.normal(0.0, 30.0, second.shape)
    fits = fit_one_pose(CAMERA, first, second, 1.0)
    assert fits[~wrong].mean() > 0.97
    assert fits[wrong].mean() < 0.2
    assert not fit_one_pose(CAMERA, first[:5], second[:5], 1.0).any()


def test_a_missing_image_only_loses_its_pairs() -> None:
    image = texture().astype(np.float32)
    poses = Poses(np.tile(quaternion_exp(np.array([[0.4, 0.0, 0.0]])), (4, 1)),
                  np.array([[0.05 * k, 0.0, 3.0 - 0.1 * k] for k in range(4)]))  # fmt: skip
    loaded: list[int] = []

    def load(frame: int, name: str) -> TrackedImage | None:
        loaded.append(frame)
        grey = view_of_plane(image, CAMERA, poses[frame : frame + 1])
        return None if frame == 1 else TrackedImage.from_grey(grey)

    found = track_rig(load, {"a": CAMERA}, {"a": poses.inverse()}, 4, TrackingOptions(epipolar_px=5.0))
    assert loaded == [0, 1, 2, 3]
    assert [(pair.first, pair.second) for pair in found.pairs] == [(2, 3)]
    assert found.corners["a"] > 30
    assert [one.tracks == len(found.pairs[0]) <= one.corners for one in found.attempts] == [True]


def test_the_stretch_with_the_most_turning_is_chosen() -> None:
    yaw = np.radians(np.clip(np.arange(400) - 200.0, 0.0, 90.0))
    steps = 0.25 * np.stack([np.cos(yaw), np.sin(yaw), np.zeros(400)], axis=1)
    poses = Poses(quaternion_exp(np.stack([0 * yaw, 0 * yaw, yaw], axis=1)), np.cumsum(steps, axis=0))
    index = choose_stretch(poses, FrameChoice(frames=10))
    assert len(index) == 10
    assert index[0] < 205
    assert index[-1] > 280
    step_m = np.linalg.norm(np.diff(np.stack([np.interp(index, np.arange(400), poses.translation[:, k])
                                              for k in range(3)], axis=1), axis=0), axis=1)  # fmt: skip
    assert step_m.max() < 3.6
    still = Poses(poses.rotation[:50], np.zeros((50, 3)))
    assert len(choose_stretch(still[:50], FrameChoice())) == 1
    assert len(choose_stretch(poses[:1], FrameChoice())) == 1
    assert len(choose_stretch(poses[:30], FrameChoice())) == 3


def test_each_stamp_is_chosen_once() -> None:
    stamps = np.array([0, 100, 200, 300])
    assert nearest_distinct(np.array([40.0, 60.0, 190.0, 210.0]), stamps).tolist() == [0, 1, 2]
    assert nearest_distinct(np.array([40.0]), stamps[:1]).tolist() == [0]
    assert nearest_distinct(np.array([40.0]), stamps[:0]).tolist() == []
