"""Trunks of perceptual metrics with random weights."""

import torch

from mirror.metrics.features.lpips import lpips_trunk
from mirror.metrics.features.st_lpips import st_lpips_trunk


def trunk(name):
    return st_lpips_trunk(name[3:]) if name.startswith("st-") else lpips_trunk(name)


def random_state(network, seed=0):
    """Weights that keep the features' spread from layer to layer."""
    draw = torch.Generator().manual_seed(seed)
    state = {}
    for name, tensor in network.state_dict().items():
        spread = (2.0 / max(tensor[0].numel(), 1)) ** 0.5 if tensor.ndim == 4 else 0.1
        state[name] = tensor.clone() if name.endswith("filt") else torch.randn(tensor.shape, generator=draw) * spread
    return state
