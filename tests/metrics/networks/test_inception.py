"""The FID network against a re-computation by bare functional calls on torchvision-named tensors."""

import copy

import pytest
import torch
from torch import nn
from torch.nn import functional as f

from mirror.metrics.networks.folding import NormalisedConvolution, folded
from mirror.metrics.networks.inception import FidInception
from mirror.metrics.networks.state import load_strictly

# Every convolution: outputs, inputs, rows, columns; as the published state dict has them.
STEM = {
    "Conv2d_1a_3x3": (32, 3, 3, 3),
    "Conv2d_2a_3x3": (32, 32, 3, 3),
    "Conv2d_2b_3x3": (64, 32, 3, 3),
    "Conv2d_3b_1x1": (80, 64, 1, 1),
    "Conv2d_4a_3x3": (192, 80, 3, 3),
}
A = {"Mixed_5b": (192, 32), "Mixed_5c": (256, 64), "Mixed_5d": (288, 64)}
C = {"Mixed_6b": 128, "Mixed_6c": 160, "Mixed_6d": 160, "Mixed_6e": 192}
E = {"Mixed_7b": 1280, "Mixed_7c": 2048}


def convolutions():
    sizes = dict(STEM)
    for name, (i, pooled) in A.items():
        sizes |= {
            f"{name}.branch1x1": (64, i, 1, 1),
            f"{name}.branch5x5_1": (48, i, 1, 1),
            f"{name}.branch5x5_2": (64, 48, 5, 5),
            f"{name}.branch3x3dbl_1": (64, i, 1, 1),
            f"{name}.branch3x3dbl_2": (96, 64, 3, 3),
            f"{name}.branch3x3dbl_3": (96, 96, 3, 3),
            f"{name}.branch_pool": (pooled, i, 1, 1),
        }
    sizes |= {
        "Mixed_6a.branch3x3": (384, 288, 3, 3),
        "Mixed_6a.branch3x3dbl_1": (64, 288, 1, 1),
        "Mixed_6a.branch3x3dbl_2": (96, 64, 3, 3),
        "Mixed_6a.branch3x3dbl_3": (96, 96, 3, 3),
    }
    for name, c in C.items():
        sizes |= {
            f"{name}.branch1x1": (192, 768, 1, 1),
            f"{name}.branch7x7_1": (c, 768, 1, 1),
            f"{name}.branch7x7_2": (c, c, 1, 7),
            f"{name}.branch7x7_3": (192, c, 7, 1),
            f"{name}.branch7x7dbl_1": (c, 768, 1, 1),
            f"{name}.branch7x7dbl_2": (c, c, 7, 1),
            f"{name}.branch7x7dbl_3": (c, c, 1, 7),
            f"{name}.branch7x7dbl_4": (c, c, 7, 1),
            f"{name}.branch7x7dbl_5": (192, c, 1, 7),
            f"{name}.branch_pool": (192, 768, 1, 1),
        }
    sizes |= {
        "Mixed_7a.branch3x3_1": (192, 768, 1, 1),
        "Mixed_7a.branch3x3_2": (320, 192, 3, 3),
        "Mixed_7a.branch7x7x3_1": (192, 768, 1, 1),
        "Mixed_7a.branch7x7x3_2": (192, 192, 1, 7),
        "Mixed_7a.branch7x7x3_3": (192, 192, 7, 1),
        "Mixed_7a.branch7x7x3_4": (192, 192, 3, 3),
    }
    for name, i in E.items():
        sizes |= {
            f"{name}.branch1x1": (320, i, 1, 1),
            f"{name}.branch3x3_1": (384, i, 1, 1),
            f"{name}.branch3x3_2a": (384, 384, 1, 3),
            f"{name}.branch3x3_2b": (384, 384, 3, 1),
            f"{name}.branch3x3dbl_1": (448, i, 1, 1),
            f"{name}.branch3x3dbl_2": (384, 448, 3, 3),
            f"{name}.branch3x3dbl_3a": (384, 384, 1, 3),
            f"{name}.branch3x3dbl_3b": (384, 384, 3, 1),
            f"{name}.branch_pool": (192, i, 1, 1),
        }
    return sizes


def published_sizes():
    sizes = {"fc.weight": (1008, 2048), "fc.bias": (1008,)}
    for name, size in convolutions().items():
        sizes[f"{name}.conv.weight"] = size
        for part in ("weight", "bias", "running_mean", "running_var"):
            sizes[f"{name}.bn.{part}"] = size[:1]
        sizes[f"{name}.bn.num_batches_tracked"] = ()
    return sizes


def random_state(sizes, seed=0):
    """Weights that keep the features' spread."""
    draw = torch.Generator().manual_seed(seed)
    state = {}
    for name, size in sizes.items():
        if name.endswith("tracked"):
            state[name] = torch.tensor(1)
        elif name.endswith("running_var") or name.endswith("bn.weight"):
            state[name] = 0.5 + torch.rand(size, generator=draw)
        else:
            spread = (2.0 / state_fan(size)) ** 0.5 if len(size) > 1 else 0.1
            state[name] = torch.randn(size, generator=draw) * spread
    return state


def state_fan(size):
    fan = 1
    for each in size[1:]:
        fan *= each
    return fan


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
