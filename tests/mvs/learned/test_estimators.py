import dataclasses

import numpy as np
import pytest
import torch

from hybridworldsim.mvs.mvsnet.estimator import MVSNetEstimator
from hybridworldsim.mvs.mvsnet.network import MVSNet
from hybridworldsim.mvs.mvsnet.upsampling import upsample_depth
from hybridworldsim.mvs.patchmatchnet.estimator import PatchmatchNetEstimator
from hybridworldsim.mvs.patchmatchnet.network import PatchmatchNet
from mirror.errors import UsageError
from tests.mvs.learned.images import fold, make_stereo_image, make_wall_image, randomise


@pytest.fixture(scope="module")
def estimators():
    torch.manual_seed(0)
    return {
        "mvsnet": MVSNetEstimator(network=fold(randomise(MVSNet(refine=False), 0)), planes=16),
        "patchmatchnet": PatchmatchNetEstimator(network=fold(randomise(PatchmatchNet(), 1))),
    }


NAMES = pytest.mark.parametrize("name", ["mvsnet", "patchmatchnet"])


def neighbours(width=72, height=40, **options):
    return [
        make_wall_image(width, height, at, **options)[0] for at in ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (-0.5, 0.1, 0.0))
    ]


def check_depth_map(depth_map, image, near=2.0, far=40.0):
    """Checks depths in the range or unknown, confidences from 0 to 1 and 0 where unknown, all float32."""
    assert depth_map.depth_m.shape == depth_map.confidence.shape == image.valid.shape
    assert depth_map.depth_m.dtype == depth_map.confidence.dtype == np.float32
    known = np.isfinite(depth_map.depth_m)
    assert (known | np.isnan(depth_map.depth_m)).all()
    assert (depth_map.depth_m[known] >= near * (1.0 - 1e-6)).all()
    assert (depth_map.depth_m[known] <= far * (1.0 + 1e-6)).all()
    assert ((depth_map.confidence >= 0.0) & (depth_map.confidence <= 1.0)).all()
    assert not depth_map.confidence[~known].any()
    return known


@NAMES
@pytest.mark.parametrize("size", [(72, 40), (64, 64), (33, 17), (8, 8), (3, 2), (1, 1)])
def test_any_size(estimators, name, size):
    images = neighbours(*size)
    check_depth_map(estimators[name](images[0], images[1:], 2.0, 40.0), images[0])


@NAMES
def test_sources_of_another_size_and_one_source(estimators, name):
    reference = neighbours()[0]
    small = neighbours(31, 19)[1]
    known = check_depth_map(estimators[name](reference, [small], 2.0, 40.0), reference)
    assert known.any()


@NAMES
@pytest.mark.parametrize("value", [0, 255, 127], ids=["black", "saturated", "flat"])
def test_images_without_texture(estimators, name, value):
    images = [dataclasses.replace(neighbour, rgb=np.full_like(neighbour.rgb, value)) for neighbour in neighbours()]
    check_depth_map(estimators[name](images[0], images[1:], 2.0, 40.0), images[0])


@NAMES
def test_identical_images_from_other_positions(estimators, name):
    """Moves the camera without a change of the image: each depth is in the range or unknown."""
    first, second, third = neighbours()
    same = [dataclasses.replace(image, rgb=first.rgb) for image in (second, third)]
    check_depth_map(estimators[name](first, same, 2.0, 40.0), first)


@NAMES
def test_no_depth_without_a_source_at_another_position(estimators, name):
    reference = neighbours()[0]
    masked_source = dataclasses.replace(neighbours()[1], valid=np.zeros_like(reference.valid))
    for sources in ([], [reference], [masked_source]):
        depth_map = estimators[name](reference, sources, 2.0, 40.0)
        assert np.isnan(depth_map.depth_m).all()
        assert not depth_map.confidence.any()


@NAMES
def test_pixels_that_no_source_sees_are_unknown(estimators, name):
    """Turns the source by 180 degrees."""
    reference, source = neighbours()[:2]
    behind = make_stereo_image(source.rgb, (0.5, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
    assert np.isnan(estimators[name](reference, [behind], 2.0, 40.0).depth_m).all()


@NAMES
def test_masked_pixels_are_unknown(estimators, name):
    reference, first, second = neighbours()
    valid = np.ones_like(reference.valid)
    valid[10:30, 20:40] = False
    depth_map = estimators[name](dataclasses.replace(reference, valid=valid), [first, second], 2.0, 40.0)
    assert np.isnan(depth_map.depth_m[~valid]).all()
    assert np.isfinite(depth_map.depth_m[valid]).any()
    masked = dataclasses.replace(first, valid=valid)
    check_depth_map(estimators[name](reference, [masked], 2.0, 40.0), reference)


@NAMES
def test_same_bits_twice_and_small_differences_far_from_the_origin(estimators, name):
    images = neighbours()
    first, again = (estimators[name](images[0], images[1:], 2.0, 40.0) for _ in range(2))
    assert np.array_equal(first.depth_m, again.depth_m, equal_nan=True)
    assert np.array_equal(first.confidence, again.confidence)
    # The offset is millions of metres, and float64 represents it exactly.
    moved = neighbours(world=(2.0**22, -(2.0**22), 64.0))
    there = estimators[name](moved[0], moved[1:], 2.0, 40.0)
    both = np.isfinite(first.depth_m) & np.isfinite(there.depth_m)
    assert both.mean() > 0.5
    difference = np.abs(there.depth_m - first.depth_m)[both] / first.depth_m[both]
    assert np.median(difference) < 1e-4


@NAMES
def test_number_of_threads_is_restored(estimators, name):
    before = torch.get_num_threads()
    images = neighbours(16, 16)
    dataclasses.replace(estimators[name], threads=before + 1)(images[0], images[1:], 2.0, 40.0)
    assert torch.get_num_threads() == before


@NAMES
@pytest.mark.parametrize("span", [(0.0, 10.0), (-1.0, 10.0), (10.0, 10.0), (10.0, 2.0), (1.0, np.inf), (np.nan, 10.0)])
def test_invalid_depth_ranges_are_refused(estimators, name, span):
    images = neighbours(16, 16)
    with pytest.raises(UsageError, match="depths from"):
        estimators[name](images[0], images[1:], *span)


@NAMES
@pytest.mark.parametrize("span", [(1e-3, 1e6), (5.0, 5.001), (1e-6, 2e-6), (1e5, 1e7)])
def test_depth_ranges_of_any_size(estimators, name, span):
    images = neighbours(32, 32)
    check_depth_map(estimators[name](images[0], images[1:], *span), images[0], *span)


@NAMES
def test_images_above_the_memory_limit_are_refused(estimators, name):
    images = neighbours()
    tight = dataclasses.replace(estimators[name], memory_bytes=1 << 20)
    with pytest.raises(UsageError, match=r"72 x 40 px .*memory_bytes, 1 MiB"):
        tight(images[0], images[1:], 2.0, 40.0)


@pytest.mark.parametrize("planes", [0, 4, 12, 193])
def test_number_of_planes_must_be_a_multiple_of_8(planes):
    with pytest.raises(UsageError, match="a multiple of 8"):
        MVSNetEstimator(network=MVSNet(refine=False), planes=planes)


def test_upsampling_is_exact_on_a_plane_and_keeps_steps():
    v, u = np.meshgrid(np.arange(64.0), np.arange(96.0), indexing="ij")
    plane = torch.from_numpy(1.0 / (0.1 + 0.0005 * u + 0.0007 * v))
    depth_map = upsample_depth(plane[::4, ::4], 4)
    torch.testing.assert_close(depth_map[:61, :93], plane[:61, :93], rtol=1e-6, atol=0.0)
    step = torch.full((8, 8), 5.0)
    step[:, 4:] = 30.0
    assert set(upsample_depth(step, 4).round(decimals=4).unique().tolist()) == {5.0, 30.0}
