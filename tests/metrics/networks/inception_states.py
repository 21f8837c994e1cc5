"""Names and sizes of the published weights of the FID network, and random ones."""

import torch

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
