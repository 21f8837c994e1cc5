"""Tests PatchmatchNet with its published weights against outputs of the public code and against synthetic truth."""

from dataclasses import replace

import numpy as np
import pytest

from hybridworldsim.mvs.patchmatchnet.estimator import PatchmatchNetEstimator
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.synth.fleet.drives import make_drives
from mirror.synth.render import render
from mirror.weights.resolve import WeightResolver
from tests.mvs.learned.images import make_stereo_image, make_wall_image

PUBLIC_ROWS, PUBLIC_COLUMNS = (4, 20, 36, 52), (8, 32, 56, 80)
PUBLIC_DEPTH_M = (
    (7.2554, 7.7311, 8.1299, 8.9562),
    (8.7198, 8.1388, 9.779, 9.4008),
    (7.9824, 8.6535, 9.4985, 9.1963),
    (8.983, 9.0842, 9.2251, 9.2482),
)
PUBLIC_CONFIDENCE = (
    (0.4997, 0.494, 0.5561, 0.5557),
    (0.5009, 0.4996, 0.4955, 0.6112),
    (0.5, 0.4999, 0.5259, 0.5041),
    (0.495, 0.506, 0.4993, 0.5719),
)
"""Outputs of FangjinhuaWang/PatchmatchNet at 974abc0 for the same images and seed, with one thread."""


@pytest.fixture(scope="module")
def estimator(real_data):
    file = real_data / "weights" / "patchmatchnet" / "params_000007.ckpt"
    if not file.is_file():
        pytest.skip(f"no weights at {file}")
    return PatchmatchNetEstimator.load(WeightResolver({"patchmatchnet": file}))


def test_outputs_equal_the_public_implementation(estimator):
    images = [make_wall_image(96, 64, at)[0] for at in ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (-0.5, 0.1, 0.0))]
    depth_map = estimator(images[0], images[1:], 4.0, 20.0)
    places = np.ix_(PUBLIC_ROWS, PUBLIC_COLUMNS)
    np.testing.assert_allclose(depth_map.depth_m[places], PUBLIC_DEPTH_M, rtol=5e-4)
    np.testing.assert_allclose(depth_map.confidence[places], PUBLIC_CONFIDENCE, atol=2e-3)


@pytest.fixture(scope="module")
def street():
    """An image of the synthetic street, four images one metre away from it, and the true depth."""
    drive = make_drives("reconstruction", 0, scenes=1, traversals=1)[1][0]
    times = drive.condition.start_ns + np.arange(0, 40_000_000_000, 100_000_000)
    poses = drive.world_SE3_camera("front_wide", times)
    middle = int(np.argmin(np.linalg.norm(poses.translation[:, :2], axis=1)))
    pose = poses[middle : middle + 1]
    camera = Camera("pinhole", 320, 240, 240.0, 240.0, 160.0, 120.0, ())
    images, truth = [], None
    for step in ((0, 0, 0), (1, 0, 0), (-1, 0, 0), (0, -1, 0), (0, 0, -1)):
        moved = Poses(pose.rotation, pose.transform(np.array([step], float)).reshape(1, 3))
        rendered = render(drive.world, moved, camera, 20.0, drive.condition)
        if truth is None:
            truth = rendered.view.distance_m * camera.rays().direction[..., 2]
        rgb = np.ascontiguousarray(rendered.bgr[..., ::-1])
        images.append(make_stereo_image(rgb, moved.translation[0], moved.rotation[0], K=camera.intrinsic_matrix()))
    return images, truth


@pytest.mark.parametrize(
    ("near", "far", "max_error"), [(3.0, 4.0, 0.03), (4.0, 8.0, 0.08), (8.0, 20.0, 0.07), (20.0, 40.0, 0.07)]
)
def test_depth_of_the_synthetic_street(estimator, street, near, far, max_error):
    images, truth = street
    depth_map = estimator(images[0], images[1:], 2.0, 100.0)
    ring = (truth >= near) & (truth < far) & (depth_map.confidence > 0.6)
    assert ring.sum() > 1000
    error = np.abs(depth_map.depth_m - truth)[ring] / truth[ring]
    assert np.median(error) < max_error


def test_confident_depths_have_smaller_errors(estimator, street):
    images, truth = street
    depth_map = estimator(images[0], images[1:], 2.0, 100.0)
    known = np.isfinite(depth_map.depth_m) & np.isfinite(truth)
    error = np.abs(depth_map.depth_m - truth)[known] / truth[known]
    confident = depth_map.confidence[known] > 0.5
    assert np.median(error[confident]) < 0.7 * np.median(error[~confident])


def test_images_that_cannot_be_matched(estimator, street):
    images, _ = street
    for value in (0, 128, 255):
        flat = [replace(image, rgb=np.full_like(image.rgb, value)) for image in images]
        depth_map = estimator(flat[0], flat[1:], 2.0, 100.0)
        known = np.isfinite(depth_map.depth_m)
        assert (depth_map.depth_m[known] > 0.0).all()
        # Four of eight equally probable hypotheses have a probability of a half.
        assert np.median(depth_map.confidence[known]) < 0.65
    same = [replace(image, rgb=images[0].rgb) for image in images[1:]]
    depth_map = estimator(images[0], same, 2.0, 100.0)
    assert np.nanmedian(depth_map.depth_m) > 40.0


def test_results_depend_on_threads_by_rounding_only(estimator):
    images = [make_wall_image(96, 64, at)[0] for at in ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0))]
    one, two = (replace(estimator, threads=n)(images[0], images[1:], 4.0, 20.0).depth_m for n in (1, 2))
    assert np.nanmax(np.abs(one - two) / one) < 1e-3
