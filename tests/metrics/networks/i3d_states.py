"""Random weights of I3D, named and sized as in the published port."""

import math

import torch

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
