from pathlib import Path

import pytest
import torch

from hybridworldsim.mvs.mvsnet.network import MVSNet
from hybridworldsim.mvs.mvsnet.regularisation import CostRegularisation
from hybridworldsim.mvs.patchmatchnet.features import FeaturePyramid
from hybridworldsim.mvs.patchmatchnet.network import PatchmatchNet
from tests.mvs.learned.images import fold, randomise

LISTINGS = Path(__file__).with_name("architectures")


def read_listing(name):
    lines = (LISTINGS / f"{name}.txt").read_text().splitlines()
    pairs = (line.split() for line in lines)
    return {key: () if shape == "-" else tuple(map(int, shape.split("x"))) for key, shape in pairs}


def get_shapes(network):
    return {key: tuple(value.shape) for key, value in network.state_dict().items()}


def test_mvsnet_has_the_public_names_and_shapes():
    public = read_listing("mvsnet")
    assert get_shapes(MVSNet(refine=True)) == public
    bare = {key: shape for key, shape in public.items() if not key.startswith("refine_network.")}
    assert get_shapes(MVSNet(refine=False)) == bare


def test_patchmatchnet_has_the_published_names_and_shapes():
    assert get_shapes(PatchmatchNet()) == read_listing("patchmatchnet")


def test_shapes_of_features():
    levels = randomise(FeaturePyramid(), 0)(torch.rand(3, 48, 64))
    assert {stride: tuple(level.shape) for stride, level in levels.items()} == {
        8: (64, 6, 8),
        4: (32, 12, 16),
        2: (16, 24, 32),
    }


@pytest.mark.parametrize(("build", "shape"), [(FeaturePyramid, (3, 32, 40)), (CostRegularisation, (32, 8, 8, 16))])
def test_folding_keeps_the_function(build, shape):
    x = torch.rand(shape, generator=torch.Generator().manual_seed(1))
    with torch.inference_mode():
        network = randomise(build(), 2).double()
        before = network(x.double())
        after = fold(network)(x.double())
    if isinstance(before, dict):
        before, after = (torch.cat([level.flatten() for level in levels.values()]) for levels in (before, after))
    torch.testing.assert_close(after, before, rtol=1e-10, atol=1e-10)


def test_regularisation_reaches_far_and_keeps_the_size():
    """Changes one corner of the volume and checks that the output changes far away, and keeps its shape."""
    network = randomise(CostRegularisation(), 3)
    volume = torch.rand(32, 16, 24, 32, generator=torch.Generator().manual_seed(4))
    changed = volume.clone()
    changed[:, 0, 0, 0] += 5.0
    with torch.inference_mode():
        difference = (network(changed) - network(volume)).abs()
    assert difference.shape == (16, 24, 32)
    assert difference[8:, 8:, 8:].max() > 0.0
