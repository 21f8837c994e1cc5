"""I3D against a re-computation by bare functional calls on tensors named as in the published port."""

import math

import pytest
import torch
from torch.nn import functional as f

from mirror.metrics.networks.i3d import InflatedInception
from mirror.metrics.networks.state import load_strictly
from tests.metrics.networks.i3d_states import WIDTHS, published_sizes, random_state


def same(x, kernel, stride, value=0.0):
    """TensorFlow's "same": as many results as ceil(size / stride)."""
    sides = []
    for size, k, s in reversed(list(zip(x.shape[2:], kernel, stride))):
        total = max((math.ceil(size / s) - 1) * s + k - size, 0)
        sides += [total // 2, total - total // 2]
    return f.pad(x, sides, value=value)


def reference(state, x):
    def unit(name, x, stride=1):
        weight = state[f"{name}.conv3d.weight"]
        y = f.conv3d(same(x, weight.shape[2:], (stride,) * 3), weight, stride=stride)
        scale = state[f"{name}.bn.weight"] / torch.sqrt(state[f"{name}.bn.running_var"] + 1e-5)
        shape = (1, -1, 1, 1, 1)
        y = (y - state[f"{name}.bn.running_mean"].reshape(shape)) * scale.reshape(shape)
        return f.relu(y + state[f"{name}.bn.bias"].reshape(shape))

    def pool(x, kernel, stride):
        # What is pooled is never negative, so that TensorFlow's padding with minus infinity gives the same.
        return f.max_pool3d(same(x, kernel, stride, -1e30), kernel, stride)

    x = pool(unit("Conv3d_1a_7x7", x, 2), (1, 3, 3), (1, 2, 2))
    x = pool(unit("Conv3d_2c_3x3", unit("Conv3d_2b_1x1", x)), (1, 3, 3), (1, 2, 2))
    for name in WIDTHS:
        if name == "4b":
            x = pool(x, (3, 3, 3), (2, 2, 2))
        if name == "5b":
            x = pool(x, (2, 2, 2), (2, 2, 2))
        m = f"Mixed_{name}"
        x = torch.cat(
            [
                unit(f"{m}.b0", x),
                unit(f"{m}.b1b", unit(f"{m}.b1a", x)),
                unit(f"{m}.b2b", unit(f"{m}.b2a", x)),
                unit(f"{m}.b3b", pool(x, (3, 3, 3), (1, 1, 1))),
            ],
            dim=1,
        )
    steps = [x[:, :, t : t + 2].mean(dim=(2, 3, 4)) for t in range(x.shape[2] - 1)]
    weight, bias = state["logits.conv3d.weight"][:, :, 0, 0, 0], state["logits.conv3d.bias"]
    return torch.stack([step @ weight.T + bias for step in steps]).mean(dim=0)


@pytest.fixture(scope="module")
def filled():
    network, state = InflatedInception(), random_state()
    load_strictly(network, state)
    return network, state


def test_published_names_and_sizes():
    sizes = {name: tuple(tensor.shape) for name, tensor in InflatedInception().state_dict().items()}
    assert sizes == published_sizes()
    assert sum(math.prod(size) for name, size in sizes.items() if "running" not in name and "tracked" not in name) == (
        sum(parameter.numel() for parameter in InflatedInception().parameters())
    )


def test_logits(filled):
    network, state = filled
    clip = torch.rand(1, 3, 17, 224, 224, generator=torch.Generator().manual_seed(1)) * 2 - 1
    with torch.inference_mode():
        truth, got = reference(state, clip), network(clip)
    assert got.shape == (1, 400)
    assert float((got - truth).abs().max()) < 5e-6 * float(truth.abs().max())


def test_eight_frames_are_too_few(filled):
    with pytest.raises(RuntimeError), torch.inference_mode():
        filled[0](torch.zeros(1, 3, 8, 224, 224))
