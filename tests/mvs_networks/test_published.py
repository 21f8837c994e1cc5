"""PatchmatchNet with its published weights: what the public code gives, and how near synthetic truth it comes."""

from dataclasses import replace

import numpy as np
import pytest

from hybridworldsim.mvs.patchmatchnet.estimator import PatchmatchNetEstimator
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.synth.fleet.drives import make_drives
from mirror.synth.render import render
from mirror.weights.resolve import WeightResolver
from tests.mvs_networks.images import posed, wall

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
"""What FangjinhuaWang/PatchmatchNet at 974abc0 printed for the same pictures, seed and one thread."""


@pytest.fixture(scope="module")
def estimator(real_data):
    file = real_data / "weights" / "patchmatchnet" / "params_000007.ckpt"
    if not file.is_file():
        pytest.skip(f"no weights at {file}")
    return PatchmatchNetEstimator.load(WeightResolver({"patchmatchnet": file}))


def test_what_the_public_implementation_gives(estimator):
    pictures = [wall(96, 64, at)[0] for at in ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (-0.5, 0.1, 0.0))]
    found = estimator(pictures[0], pictures[1:], 4.0, 20.0)
    places = np.ix_(PUBLIC_ROWS, PUBLIC_COLUMNS)
    np.testing.assert_allclose(found.depth_m[places], PUBLIC_DEPTH_M, rtol=5e-4)
    np.testing.assert_allclose(found.confidence[places], PUBLIC_CONFIDENCE, atol=2e-3)


@pytest.fixture(scope="module")
def street():
    """A picture of the synthetic street, four round it, a metre away each, and the true depth."""
    drive = make_drives("reconstruction", 0, scenes=1, traversals=1)[1][0]
    times = drive.condition.start_ns + np.arange(0, 40_000_000_000, 100_000_000)
    poses = drive.world_SE3_camera("front_wide", times)
    middle = int(np.argmin(np.linalg.norm(poses.translation[:, :2], axis=1)))
    pose = poses[middle : middle + 1]
    camera = Camera("pinhole", 320, 240, 240.0, 240.0, 160.0, 120.0, ())
    pictures, truth = [], None
    for step in ((0, 0, 0), (1, 0, 0), (-1, 0, 0), (0, -1, 0), (0, 0, -1)):
        moved = Poses(pose.rotation, pose.transform(np.array([step], float)).reshape(1, 3))
        seen = render(drive.world, moved, camera, 20.0, drive.condition)
        if truth is None:
            truth = seen.view.distance_m * camera.rays().direction[..., 2]
        rgb = np.ascontiguousarray(seen.bgr[..., ::-1])
        pictures.append(posed(rgb, moved.translation[0], moved.rotation[0], K=camera.intrinsic_matrix()))
    return pictures, truth


@pytest.mark.parametrize(
    ("near", "far", "most"), [(3.0, 4.0, 0.03), (4.0, 8.0, 0.08), (8.0, 20.0, 0.07), (20.0, 40.0, 0.07)]
)
def test_depth_of_the_synthetic_street(estimator, street, near, far, most):
    pictures, truth = street
    found = estimator(pictures[0], pictures[1:], 2.0, 100.0)
    ring = (truth >= near) & (truth < far) & (found.confidence > 0.6)
    assert ring.sum() > 1000
    error = np.abs(found.depth_m - truth)[ring] / truth[ring]
    assert np.median(error) < most


def test_more_confident_depths_are_better(estimator, street):
    pictures, truth = street
    found = estimator(pictures[0], pictures[1:], 2.0, 100.0)
    known = np.isfinite(found.depth_m) & np.isfinite(truth)
    error = np.abs(found.depth_m - truth)[known] / truth[known]
    confident = found.confidence[known] > 0.5
    assert np.median(error[confident]) < 0.7 * np.median(error[~confident])


def test_real_weights_on_what_cannot_be_matched(estimator, street):
    pictures, _ = street
    for value in (0, 128, 255):
        flat = [replace(one, rgb=np.full_like(one.rgb, value)) for one in pictures]
        found = estimator(flat[0], flat[1:], 2.0, 100.0)
        known = np.isfinite(found.depth_m)
        assert (found.depth_m[known] > 0.0).all()
        # Eight even hypotheses, four of which count, are a half.
        assert np.median(found.confidence[known]) < 0.65
    same = [replace(one, rgb=pictures[0].rgb) for one in pictures[1:]]
    found = estimator(pictures[0], same, 2.0, 100.0)
    assert np.nanmedian(found.depth_m) > 40.0


def test_results_depend_on_threads_by_rounding_only(estimator):
    pictures = [wall(96, 64, at)[0] for at in ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0))]
    one, two = (replace(estimator, threads=n)(pictures[0], pictures[1:], 4.0, 20.0).depth_m for n in (1, 2))
    assert np.nanmax(np.abs(one - two) / one) < 1e-3
