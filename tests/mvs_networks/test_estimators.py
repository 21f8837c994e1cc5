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
from tests.mvs_networks.images import folded, posed, randomised, wall


@pytest.fixture(scope="module")
def estimators():
    torch.manual_seed(0)
    return {
        "mvsnet": MVSNetEstimator(network=folded(randomised(MVSNet(refine=False), 0)), planes=16),
        "patchmatchnet": PatchmatchNetEstimator(network=folded(randomised(PatchmatchNet(), 1))),
    }


NAMES = pytest.mark.parametrize("name", ["mvsnet", "patchmatchnet"])


def neighbours(width=72, height=40, **options):
    return [wall(width, height, at, **options)[0] for at in ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (-0.5, 0.1, 0.0))]


def require_sound(found, picture, near=2.0, far=40.0):
    """Depths inside the range or unknown, confidence from 0 to 1 and 0 where unknown, all float32."""
    assert found.depth_m.shape == found.confidence.shape == picture.valid.shape
    assert found.depth_m.dtype == found.confidence.dtype == np.float32
    known = np.isfinite(found.depth_m)
    assert (known | np.isnan(found.depth_m)).all()
    assert (found.depth_m[known] >= near * (1.0 - 1e-6)).all()
    assert (found.depth_m[known] <= far * (1.0 + 1e-6)).all()
    assert ((found.confidence >= 0.0) & (found.confidence <= 1.0)).all()
    assert not found.confidence[~known].any()
    return known


@NAMES
@pytest.mark.parametrize("size", [(72, 40), (64, 64), (33, 17), (8, 8), (3, 2), (1, 1)])
def test_any_size(estimators, name, size):
    pictures = neighbours(*size)
    require_sound(estimators[name](pictures[0], pictures[1:], 2.0, 40.0), pictures[0])


@NAMES
def test_sources_of_another_size_and_one_source(estimators, name):
    reference = neighbours()[0]
    small = neighbours(31, 19)[1]
    known = require_sound(estimators[name](reference, [small], 2.0, 40.0), reference)
    assert known.any()


@NAMES
@pytest.mark.parametrize("value", [0, 255, 127], ids=["black", "saturated", "flat"])
def test_pictures_without_texture(estimators, name, value):
    pictures = [dataclasses.replace(one, rgb=np.full_like(one.rgb, value)) for one in neighbours()]
    require_sound(estimators[name](pictures[0], pictures[1:], 2.0, 40.0), pictures[0])


@NAMES
def test_identical_pictures_from_elsewhere(estimators, name):
    """A camera that moved through a world that shows no move: some depth or none, but nothing unsound."""
    first, second, third = neighbours()
    same = [dataclasses.replace(one, rgb=first.rgb) for one in (second, third)]
    require_sound(estimators[name](first, same, 2.0, 40.0), first)


@NAMES
def test_nothing_is_known_without_another_place(estimators, name):
    reference = neighbours()[0]
    blind = dataclasses.replace(neighbours()[1], valid=np.zeros_like(reference.valid))
    for sources in ([], [reference], [blind]):
        found = estimators[name](reference, sources, 2.0, 40.0)
        assert np.isnan(found.depth_m).all()
        assert not found.confidence.any()


@NAMES
def test_what_no_source_sees_is_unknown(estimators, name):
    """The source has turned round."""
    reference, source = neighbours()[:2]
    behind = posed(source.rgb, (0.5, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
    assert np.isnan(estimators[name](reference, [behind], 2.0, 40.0).depth_m).all()


@NAMES
def test_masks(estimators, name):
    reference, first, second = neighbours()
    valid = np.ones_like(reference.valid)
    valid[10:30, 20:40] = False
    found = estimators[name](dataclasses.replace(reference, valid=valid), [first, second], 2.0, 40.0)
    assert np.isnan(found.depth_m[~valid]).all()
    assert np.isfinite(found.depth_m[valid]).any()
    masked = dataclasses.replace(first, valid=valid)
    require_sound(estimators[name](reference, [masked], 2.0, 40.0), reference)


@NAMES
def test_equal_to_the_bit_and_apart_from_the_world_origin(estimators, name):
    pictures = neighbours()
    first, again = (estimators[name](pictures[0], pictures[1:], 2.0, 40.0) for _ in range(2))
    assert np.array_equal(first.depth_m, again.depth_m, equal_nan=True)
    assert np.array_equal(first.confidence, again.confidence)
    # Millions of metres away in the world, multiples of what float64 resolves exactly.
    moved = neighbours(world=(2.0**22, -(2.0**22), 64.0))
    there = estimators[name](moved[0], moved[1:], 2.0, 40.0)
    both = np.isfinite(first.depth_m) & np.isfinite(there.depth_m)
    assert both.mean() > 0.5
    difference = np.abs(there.depth_m - first.depth_m)[both] / first.depth_m[both]
    assert np.median(difference) < 1e-4


@NAMES
def test_the_number_of_threads_is_put_back(estimators, name):
    before = torch.get_num_threads()
    pictures = neighbours(16, 16)
    dataclasses.replace(estimators[name], threads=before + 1)(pictures[0], pictures[1:], 2.0, 40.0)
    assert torch.get_num_threads() == before


@NAMES
@pytest.mark.parametrize("span", [(0.0, 10.0), (-1.0, 10.0), (10.0, 10.0), (10.0, 2.0), (1.0, np.inf), (np.nan, 10.0)])
def test_ranges_that_are_none(estimators, name, span):
    pictures = neighbours(16, 16)
    with pytest.raises(UsageError, match="depths from"):
        estimators[name](pictures[0], pictures[1:], *span)


@NAMES
@pytest.mark.parametrize("span", [(1e-3, 1e6), (5.0, 5.001), (1e-6, 2e-6), (1e5, 1e7)])
def test_ranges_of_any_size(estimators, name, span):
    pictures = neighbours(32, 32)
    require_sound(estimators[name](pictures[0], pictures[1:], *span), pictures[0], *span)


@NAMES
def test_pictures_that_do_not_fit(estimators, name):
    pictures = neighbours()
    tight = dataclasses.replace(estimators[name], memory_bytes=1 << 20)
    with pytest.raises(UsageError, match=r"72 x 40 px needs \d+ MiB; expected at most memory_bytes, 1 MiB"):
        tight(pictures[0], pictures[1:], 2.0, 40.0)


@pytest.mark.parametrize("planes", [0, 4, 12, 193])
def test_planes_that_cannot_be_halved(planes):
    with pytest.raises(UsageError, match="a multiple of 8"):
        MVSNetEstimator(network=MVSNet(refine=False), planes=planes)


def test_enlargement_is_exact_on_a_plane_and_makes_no_bridge():
    v, u = np.meshgrid(np.arange(64.0), np.arange(96.0), indexing="ij")
    plane = torch.from_numpy(1.0 / (0.1 + 0.0005 * u + 0.0007 * v))
    found = upsample_depth(plane[::4, ::4], 4)
    torch.testing.assert_close(found[:61, :93], plane[:61, :93], rtol=1e-6, atol=0.0)
    step = torch.full((8, 8), 5.0)
    step[:, 4:] = 30.0
    assert set(upsample_depth(step, 4).round(decimals=4).unique().tolist()) == {5.0, 30.0}
