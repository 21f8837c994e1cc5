import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hybridworldsim.mvs.learned.source_features import SourceFeatures
from hybridworldsim.mvs.learned.warping import compute_motion, project_to_source, sample
from hybridworldsim.mvs.mvsnet.cost_volume import compute_variance_volume
from mirror.geometry.poses import Poses
from tests.draws import draws
from tests.mvs.learned.images import make_stereo_image, make_wall_image


def make_turned_pose(rng, degrees=5.0):
    """Make a pose near the origin with a small rotation."""
    return Poses.exp(np.concatenate((np.radians(rng.uniform(-degrees, degrees, 3)), rng.uniform(-0.5, 0.5, 3)))[None])


def make_two_images(rng, offset=(0.0, 0.0, 0.0), shape=(40, 56), source_shape=(48, 40)):
    reference, source = (
        make_stereo_image(
            rng.integers(0, 255, (*size, 3), dtype=np.uint8), pose.translation[0] + offset, pose.rotation[0]
        )
        for size, pose in ((shape, make_turned_pose(rng)), (source_shape, make_turned_pose(rng)))
    )
    return reference, source


def warp_by_loops(feature, reference, source, depth, stride):
    """Warp features point by point in float64: by rays, world coordinates and bilinear interpolation."""
    channels, rows, columns = feature.shape
    out = np.zeros((channels, *depth.shape))
    centre = np.array([0.5, 0.5, 0.0])
    for d, v, u in np.ndindex(depth.shape):
        pixel = np.array([stride * u, stride * v, 1.0]) + centre
        point = np.linalg.inv(reference.K) @ pixel * depth[d, v, u]
        world = reference.world_SE3_camera.transform(point[None]).reshape(3)
        in_source = source.world_SE3_camera.inverse().transform(world[None]).reshape(3)
        if in_source[2] <= 0.0:
            continue
        at = ((source.K @ in_source)[:2] / in_source[2] - 0.5) / stride
        left, top = np.floor(at).astype(int)
        for y, x in ((top, left), (top, left + 1), (top + 1, left), (top + 1, left + 1)):
            if 0 <= y < rows and 0 <= x < columns:
                out[:, d, v, u] += feature[:, y, x] * (1.0 - abs(at[0] - x)) * (1.0 - abs(at[1] - y))
    return out


@pytest.mark.parametrize("stride", [1, 4, 8])
@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (4.0e6, -3.0e6, 200.0)], ids=["here", "far away"])
def test_warping_equals_loops(stride, offset):
    rng = np.random.default_rng(stride)
    reference, source = make_two_images(rng, offset)
    feature = rng.normal(size=(3, 48 // stride, 40 // stride))
    depth = rng.uniform(2.0, 60.0, (2, 40 // stride, 56 // stride))
    positions = project_to_source(
        compute_motion(reference, source, stride), torch.from_numpy(depth).float(), feature.shape[2], feature.shape[1]
    )
    result = sample(torch.from_numpy(feature).float(), positions).numpy()
    expected = warp_by_loops(feature, reference, source, depth, stride)
    assert (expected != 0.0).mean() > 0.3
    np.testing.assert_allclose(result, expected, atol=2e-4)


@settings(max_examples=draws(20), deadline=None)
@given(st.floats(-1e7, 1e7), st.floats(-1e7, 1e7), st.integers(0, 100))
def test_motion_does_not_depend_on_the_origin(east, north, seed):
    rng = np.random.default_rng(seed)
    reference, source = make_two_images(rng)
    moved = [
        make_stereo_image(
            one.rgb, one.world_SE3_camera.translation[0] + (east, north, 0.0), one.world_SE3_camera.rotation[0]
        )
        for one in (reference, source)
    ]
    here, there = compute_motion(reference, source, 2), compute_motion(*moved, 2)
    np.testing.assert_allclose(there.rotation, here.rotation, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(there.translation, here.translation, atol=1e-6)


def test_points_behind_the_source_are_outside():
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 255, (16, 16, 3), dtype=np.uint8)
    reference, ahead = make_stereo_image(rgb), make_stereo_image(rgb, (0.0, 0.0, 10.0))
    positions = project_to_source(compute_motion(reference, ahead, 1), torch.full((1, 16, 16), 4.0), 16, 16)
    assert (positions.abs() > 2.0).all()
    assert not sample(torch.ones(1, 16, 16), positions).any()


def test_variance_equals_numpy():
    """Compares with float64 for three images, one of them partly hidden."""
    rng = np.random.default_rng(1)
    reference, first = make_two_images(rng, source_shape=(40, 56))
    _, second = make_two_images(rng, source_shape=(40, 56))
    features = torch.from_numpy(rng.normal(size=(3, 5, 10, 14))).float()
    hidden = torch.zeros(10, 14)
    hidden[:, 9:] = 1.0
    motions = [compute_motion(reference, source, 4) for source in (first, second)]
    depths = torch.tensor([2.0, 5.0, 11.0, 40.0, 3.0, 2.0, 7.0, 9.0, 30.0, 12.0])
    sources = [SourceFeatures(features[1], motions[0]), SourceFeatures(features[2], motions[1], hidden)]
    result = compute_variance_volume(features[0], sources, depths).double().numpy()

    planes = depths.view(-1, 1, 1).expand(-1, 10, 14)
    positions = [project_to_source(motion, planes, 14, 10) for motion in motions]
    shown = [torch.ones(10, 14), 1.0 - hidden]
    warped = [sample(feature * one, at).double().numpy() for feature, at, one in zip(features[1:], positions, shown)]
    weights = [np.ones((10, 10, 14)), 1.0 - sample(hidden[None], positions[1])[0].double().numpy()]
    # Where a sample is partly hidden, the visible part is scaled up.
    warped = [one / np.maximum(weight, 1e-3) for one, weight in zip(warped, weights)]
    stack = np.stack([np.broadcast_to(features[0].double().numpy()[:, None], warped[0].shape), *warped])
    weight = np.stack([np.ones((10, 10, 14)), *weights])[:, None]
    mean = (stack * weight).sum(0) / weight.sum(0)
    expected = (weight * (stack - mean) ** 2).sum(0) / weight.sum(0)
    np.testing.assert_allclose(result, expected, atol=2e-5)
    assert (result >= 0.0).all()


def test_variance_is_smallest_at_the_true_depth():
    """Uses colours as features: on a slanted wall the plane of smallest variance is next to the true depth."""
    reference, depth = make_wall_image(96, 64)
    sources = [make_wall_image(96, 64, at)[0] for at in ((0.5, 0.0, 0.0), (-0.5, 0.1, 0.2), (0.0, -0.4, 0.0))]
    colours = [torch.from_numpy(one.rgb).permute(2, 0, 1).float() for one in (reference, *sources)]
    planes = 1.0 / torch.linspace(1.0 / 16.0, 1.0 / 5.0, 64)
    features = [SourceFeatures(colour, compute_motion(reference, one, 1)) for colour, one in zip(colours[1:], sources)]
    best = compute_variance_volume(colours[0], features, planes).sum(0).argmin(0)
    inner = slice(8, -8)
    step = 1.0 / 5.0 - 1.0 / 16.0
    error = np.abs(1.0 / planes[best].numpy() - 1.0 / depth)[inner, inner] / (step / 63.0)
    assert np.median(error) < 0.6
    assert np.quantile(error, 0.9) < 2.0
