"""I3D against a re-computation by bare functional calls on tensors named as in the published port."""

import math

import pytest
import torch
from torch.nn import functional as f

from mirror.metrics.networks.i3d import InflatedInception
from mirror.metrics.networks.state import load_strictly

WIDTHS = {
    "3b": (64, 96, 128, 16, 32, 32),
    "3c": (128, 128, 192, 32, 96, 64),
    "4b": (192, 96, 208, 16, 48, 64),
    "4c": (160, 112, 224, 24, 64, 64),
    "4d": (128, 128, 256, 24, 64, 64),
    "4e": (112, 144, 288, 32, 64, 64),
    "4f": (256, 160, 320, 32, 128, 128),
    "5b": (256, 160, 320, 32, 128, 128),
    "5c": (384, 192, 384, 48, 128, 128),
}


def published_sizes():
    units = {"Conv3d_1a_7x7": (64, 3, 7), "Conv3d_2b_1x1": (64, 64, 1), "Conv3d_2c_3x3": (192, 64, 3)}
    inputs = 192
    for name, w in WIDTHS.items():
        units |= {
            f"Mixed_{name}.b0": (w[0], inputs, 1),
            f"Mixed_{name}.b1a": (w[1], inputs, 1),
            f"Mixed_{name}.b1b": (w[2], w[1], 3),
            f"Mixed_{name}.b2a": (w[3], inputs, 1),
            f"Mixed_{name}.b2b": (w[4], w[3], 3),
            f"Mixed_{name}.b3b": (w[5], inputs, 1),
        }
        inputs = w[0] + w[2] + w[4] + w[5]
    sizes = {"logits.conv3d.weight": (400, inputs, 1, 1, 1), "logits.conv3d.bias": (400,)}
    for name, (outputs, into, size) in units.items():
        sizes[f"{name}.conv3d.weight"] = (outputs, into, size, size, size)
        for part in ("weight", "bias", "running_mean", "running_var"):
            sizes[f"{name}.bn.{part}"] = (outputs,)
        sizes[f"{name}.bn.num_batches_tracked"] = ()
    return sizes


def random_state(seed=0):
    draw = torch.Generator().manual_seed(seed)
    state = {}
    for name, size in published_sizes().items():
        if name.endswith("tracked"):
            state[name] = torch.tensor(1)
        elif name.endswith(("running_var", "bn.weight")):
            state[name] = 0.5 + torch.rand(size, generator=draw)
        else:
            spread = (2.0 / math.prod(size[1:])) ** 0.5 if len(size) > 1 else 0.1
            state[name] = torch.randn(size, generator=draw) * spread
    return state


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
