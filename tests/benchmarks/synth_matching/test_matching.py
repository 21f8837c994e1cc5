"""Tests of feature matching on the synthetic street; the measuring code is compared with pycolmap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.synth_matching.features import (
    Features,
    colmap,
    colmap_camera,
    extract_features,
    match_errors_px,
    match_features,
    verify_matches,
)
from benchmarks.synth_matching.posed_images import PosedImage, render_frames, urban_drive
from mirror.calibration.tracking import TrackedImage, TrackingOptions, find_corners, track_pair
from mirror.errors import UsageError
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.fleet.drives import make_drives

pytest.importorskip("pycolmap", reason="pycolmap is absent: pip install '.[calibration]'")

CAMERAS = (
    Camera("pinhole", 640, 360, 410.0, 412.0, 318.0, 181.0),
    Camera("brown_conrady", 640, 360, 410.0, 412.0, 318.0, 181.0, (-0.13, 0.012, 0.0003, -0.0002, 0.001)),
    Camera("rational", 640, 360, 410.0, 412.0, 318.0, 181.0, (0.62, 0.05, 0.0003, -0.0002, 0.001, 0.95, 0.16, 0.008)),
    Camera("kannala_brandt", 640, 360, 310.0, 312.0, 318.0, 181.0, (-0.012, 0.004, -0.002, 0.0005)),
)


def small_drive() -> SynthDrive:
    return make_drives("tiny", 3)[1][0]


def image_pairs(cameras: list[str], width_px: int = 640) -> list[tuple[PosedImage, PosedImage]]:
    drive = small_drive()
    drive = replace(
        drive, preset=replace(drive.preset, width_px=width_px), vehicle=replace(drive.vehicle, width_px=width_px)
    )
    seconds = np.arange(0.0, drive.truth.duration_s, 0.05)
    driven = drive.truth.driven_m(seconds)
    at = np.interp(0.4 * driven[-1] + np.array([0.0, 1.0]), driven, seconds)
    instants = drive.condition.start_ns + np.round(at * 1e9).astype(np.int64)
    first, second = render_frames(drive, instants, cameras)
    return [(first[name], second[name]) for name in cameras]


@pytest.fixture(scope="module")
def pairs() -> list[tuple[PosedImage, PosedImage]]:
    return image_pairs(["front_wide", "front_left"])


@pytest.fixture(scope="module")
def shots(pairs: list[tuple[PosedImage, PosedImage]]) -> tuple[PosedImage, PosedImage]:
    return pairs[0]


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.model)
def test_projection_agrees_with_pycolmap(camera: Camera) -> None:
    points = np.random.default_rng(1).uniform((-2.0, -1.2, 1.5), (2.0, 1.2, 9.0), (200, 3))
    theirs = colmap_camera(camera).img_from_cam(points)
    assert np.abs(camera.project(points).uv_px - theirs).max() < 1e-9


def test_lenses_unknown_to_colmap_are_refused() -> None:
    with pytest.raises(UsageError, match="f_theta"):
        colmap_camera(Camera("f_theta", 8, 6, 1.0, 1.0, 4.0, 3.0, (0.0, 4.0)))


def some_features(rng: np.random.Generator, base: np.ndarray, noise: float) -> tuple[Features, object, object]:
    pycolmap = colmap()
    raw = np.clip(base + rng.normal(0.0, noise, base.shape), 0.0, None)
    data = np.round(512.0 * raw / np.linalg.norm(raw, axis=1, keepdims=True)).clip(0, 255).astype(np.uint8)
    unit = data.astype(np.float32)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    theirs = pycolmap.FeatureDescriptors(type=pycolmap.FeatureExtractorType.SIFT, data=data)
    keypoints = pycolmap.keypoints_from_matrix(rng.uniform(1.0, 100.0, (len(data), 4)).astype(np.float32))
    return Features(np.zeros((len(data), 2)), np.ones(len(data)), unit), theirs, keypoints


def test_matches_agree_with_pycolmap() -> None:
    pycolmap, rng = colmap(), np.random.default_rng(2)
    base = rng.gamma(0.5, 1.0, (300, 128))
    one, their_one, ours = some_features(rng, base, 0.15)
    other, their_other, others = some_features(rng, np.concatenate([base[50:], base[50:120]]), 0.15)
    options = pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=1)
    options.sift.cpu_brute_force_matcher = True
    matcher = pycolmap.FeatureMatcher.create(options, pycolmap.Device.cpu)
    theirs = {tuple(pair) for pair in matcher.match(ours, their_one, others, their_other).tolist()}
    found = {tuple(pair) for pair in match_features(one, other).tolist()}
    assert len(theirs) > 150
    # pycolmap assumes descriptor lengths of exactly 512, so ratios within rounding of the limit may differ.
    assert len(found ^ theirs) <= 0.02 * len(theirs)


@pytest.mark.parametrize("count", [0, 1])
def test_images_without_features_have_no_matches(count: int) -> None:
    none = Features(np.zeros((count, 2)), np.ones(count), np.full((count, 128), 128**-0.5, np.float32))
    assert match_features(none, none).shape == (0, 2)


def test_surface_points_of_an_image_project_to_their_pixels(shots: tuple[PosedImage, PosedImage]) -> None:
    for shot in shots:
        uv = np.random.default_rng(3).uniform((0.0, 0.0), (shot.camera.width_px, shot.camera.height_px), (2000, 2))
        points = shot.points(uv)
        assert np.abs(shot.image_of(points) - uv).max() < 1e-6
        row, column = shot.pixels(uv)
        # At pixel centres the points agree with the rendered distance to 1 mm.
        middle = np.stack([column, row], axis=1) + 0.5
        seen = np.isfinite(shot.distance_m[row, column])
        apart = np.linalg.norm(shot.points(middle) - shot.origin, axis=1) - shot.distance_m[row, column]
        assert np.abs(apart[seen]).max() < 1e-3


def test_points_on_a_wall_match_the_closed_form() -> None:
    """The reference is a tilted plane 10 m ahead of a pinhole camera."""
    camera = CAMERAS[0]
    normal = np.array([0.6, 0.0, -0.8])
    rays = camera.rays().direction
    distance = -8.0 / (rays @ normal)
    shot = PosedImage(
        np.zeros((360, 640, 3), np.uint8), camera, Poses.identity(), distance.astype(np.float32),
        np.broadcast_to(normal, (360, 640, 3)).astype(np.float32), np.ones((360, 640), np.bool_),
    )  # fmt: skip
    uv = np.random.default_rng(4).uniform((0.0, 0.0), (380.0, 360.0), (500, 2))
    assert np.abs(shot.points(uv) @ normal + 8.0).max() < 1e-4


def test_neighbouring_images_have_hundreds_of_accurate_matches(shots: tuple[PosedImage, PosedImage]) -> None:
    one, other = (extract_features(shot) for shot in shots)
    pairs = verify_matches(match_features(one, other), one, shots[0].camera, other, shots[1].camera)
    errors = match_errors_px(pairs, one, shots[0], other, shots[1])
    assert len(pairs) >= 200
    assert np.median(errors) < 0.6
    assert (errors < 3.0).mean() > 0.6


def test_benchmark_drives_use_one_vehicle_in_every_light() -> None:
    day, night = urban_drive("along"), urban_drive("along", "night", visit=2)
    assert day.vehicle == night.vehicle
    assert day.recipe.light == "day"
    assert (night.condition.light, night.condition.visit) == ("night", 2)


@pytest.mark.parametrize("number", [0, 1], ids=["front_wide", "front_left"])
def test_images_agree_with_the_true_depth(pairs: list[tuple[PosedImage, PosedImage]], number: int) -> None:
    """Tracked points lie where the depth of the first image puts them, half a pixel of convention included."""
    first, second = pairs[number]
    images = [
        TrackedImage.from_grey(np.round(one.bgr @ [0.114, 0.587, 0.299]).astype(np.uint8), one.is_static)
        for one in (first, second)
    ]
    moved = second.world_SE3_camera.inverse() @ first.world_SE3_camera
    options = TrackingOptions()
    uv, there = track_pair(*images, find_corners(images[0], options), first.camera, moved, options)
    assert len(uv) > 100
    error = there - second.image_of(first.points(uv))
    assert np.abs(np.nanmedian(error, axis=0)).max() < 0.1
