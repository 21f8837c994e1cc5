"""The FID network against a re-computation by bare functional calls on torchvision-named tensors."""

import copy

import pytest
import torch
from torch import nn
from torch.nn import functional as f

from mirror.metrics.networks.folding import NormalisedConvolution, folded
from mirror.metrics.networks.inception import FidInception
from mirror.metrics.networks.state import load_strictly
from tests.metrics.networks.inception_states import A, C, published_sizes, random_state

# Every convolution: outputs, inputs, rows, columns; as the published state dict has them.


def reference(s, x):
    """From the published tensors, unfused."""

    def unit(name, x, stride=1, padding=0):
        y = f.conv2d(x, s[f"{name}.conv.weight"], stride=stride, padding=padding)
        mean, variance = s[f"{name}.bn.running_mean"], s[f"{name}.bn.running_var"]
        return f.relu(f.batch_norm(y, mean, variance, s[f"{name}.bn.weight"], s[f"{name}.bn.bias"], eps=0.001))

    def chain(block, x, *steps):
        for name, padding in steps:
            x = unit(f"{block}.{name}", x, padding=padding)
        return x

    def mean(x):
        inside = f.avg_pool2d(torch.ones_like(x[:, :1]), 3, 1, 1)
        return f.avg_pool2d(x, 3, 1, 1) / inside

    x = unit("Conv2d_1a_3x3", x, stride=2)
    x = f.max_pool2d(unit("Conv2d_2b_3x3", unit("Conv2d_2a_3x3", x), padding=1), 3, 2)
    x = f.max_pool2d(unit("Conv2d_4a_3x3", unit("Conv2d_3b_1x1", x)), 3, 2)
    for b in A:
        x = torch.cat(
            [
                chain(b, x, ("branch1x1", 0)),
                chain(b, x, ("branch5x5_1", 0), ("branch5x5_2", 2)),
                chain(b, x, ("branch3x3dbl_1", 0), ("branch3x3dbl_2", 1), ("branch3x3dbl_3", 1)),
                chain(b, mean(x), ("branch_pool", 0)),
            ],
            dim=1,
        )
    double = chain("Mixed_6a", x, ("branch3x3dbl_1", 0), ("branch3x3dbl_2", 1))
    x = torch.cat(
        [
            unit("Mixed_6a.branch3x3", x, stride=2),
            unit("Mixed_6a.branch3x3dbl_3", double, stride=2),
            f.max_pool2d(x, 3, 2),
        ],
        dim=1,
    )
    row, column = (0, 3), (3, 0)
    for b in C:
        x = torch.cat(
            [
                chain(b, x, ("branch1x1", 0)),
                chain(b, x, ("branch7x7_1", 0), ("branch7x7_2", row), ("branch7x7_3", column)),
                chain(
                    b,
                    x,
                    ("branch7x7dbl_1", 0),
                    ("branch7x7dbl_2", column),
                    ("branch7x7dbl_3", row),
                    ("branch7x7dbl_4", column),
                    ("branch7x7dbl_5", row),
                ),
                chain(b, mean(x), ("branch_pool", 0)),
            ],
            dim=1,
        )
    long = chain("Mixed_7a", x, ("branch7x7x3_1", 0), ("branch7x7x3_2", row), ("branch7x7x3_3", column))
    x = torch.cat(
        [
            unit("Mixed_7a.branch3x3_2", unit("Mixed_7a.branch3x3_1", x), stride=2),
            unit("Mixed_7a.branch7x7x3_4", long, stride=2),
            f.max_pool2d(x, 3, 2),
        ],
        dim=1,
    )
    for b, pool in (("Mixed_7b", mean), ("Mixed_7c", lambda x: f.max_pool2d(x, 3, 1, 1))):
        once = chain(b, x, ("branch3x3_1", 0))
        twice = chain(b, x, ("branch3x3dbl_1", 0), ("branch3x3dbl_2", 1))
        x = torch.cat(
            [
                chain(b, x, ("branch1x1", 0)),
                unit(f"{b}.branch3x3_2a", once, padding=(0, 1)),
                unit(f"{b}.branch3x3_2b", once, padding=(1, 0)),
                unit(f"{b}.branch3x3dbl_3a", twice, padding=(0, 1)),
                unit(f"{b}.branch3x3dbl_3b", twice, padding=(1, 0)),
                chain(b, pool(x), ("branch_pool", 0)),
            ],
            dim=1,
        )
    return x.mean(dim=(2, 3))


@pytest.fixture(scope="module")
def filled():
    network = FidInception()
    state = random_state(published_sizes())
    load_strictly(network, state)
    return network, state


def test_published_names_and_sizes():
    sizes = published_sizes()
    assert len(sizes) == 566
    assert {name: tuple(tensor.shape) for name, tensor in FidInception().state_dict().items()} == sizes


def test_features(filled):
    """In float64 the folded network equals the unfused reference; in float32 both do to rounding."""
    network, state = filled
    images = torch.rand(1, 3, 139, 139, generator=torch.Generator().manual_seed(1)) * 2 - 1
    wide = {k: v.double() for k, v in state.items()}
    with torch.inference_mode():
        truth = reference(wide, images.double())
        scale = float(truth.abs().max())
        assert truth.shape == (1, 2048)
        plain = copy.deepcopy(network)
        assert float((plain(images) - truth).abs().max()) < 2e-6 * scale
        apart = copy.deepcopy(network).fold()(images) - plain(images)
        assert float(apart.square().mean().sqrt()) < 1e-6 * scale
        assert float(apart.abs().max()) < 4e-6 * scale
        assert float((copy.deepcopy(network).double().fold()(images.double()) - truth).abs().max()) < 1e-12 * scale


def test_folding_twice_changes_nothing():
    unit = NormalisedConvolution(3, 4, 3).eval()
    images = torch.rand(1, 3, 8, 8)
    with torch.inference_mode():
        expected = unit(images)
        unit.fold()
        unit.fold()
        torch.testing.assert_close(unit(images), expected, rtol=1e-5, atol=1e-6)
    with pytest.raises(ValueError, match="running statistics"):
        folded(torch.ones(4, 3, 1, 1), nn.BatchNorm2d(4, track_running_stats=False))
