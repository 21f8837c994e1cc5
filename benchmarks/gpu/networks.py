"""Networks on a device: a generated frame beside the time that its operations need, and features a second."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import torch
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from benchmarks.gpu.machine import HEIGHT_PX, WIDTH_PX, Machine
from benchmarks.gpu.quantities import BUDGETS_S
from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder, TinySettings
from hybridworldsim.generation.inference.frame_sampler import SamplerSettings, sample_frame
from hybridworldsim.generation.network.configuration import SMALL, TINY, TINY_REFERENCES, TransformerConfig
from hybridworldsim.generation.network.transformer import Transformer
from hybridworldsim.generation.training.costs import empty_conditions
from mirror.metrics.features.extractor import extract
from mirror.metrics.features.fid import InceptionFeatures
from mirror.metrics.networks.inception import FidInception

VIEWS: Final = 7
GENERATED_PX: Final = (448, 256)
_STEPS: Final = 4
_SIDE: Final = 4096
_IMAGES: Final = 32


def measure_generation(machine: Machine) -> dict[str, float]:
    """Time a frame of seven views with its decoding, and a matrix product, whose speed gives the frame's own bound.

    The parameters are random: they do not change the time. bfloat16 on a GPU, float32 on a CPU.
    """
    config = SMALL if machine.scale == 1.0 else TINY
    width, height = machine.size_px(*GENERATED_PX, multiple=config.token_px)
    make = _frame_maker(config, (height, width), machine)
    with torch.inference_mode():
        ms = machine.median_ms(make(machine.device), 0.5 * BUDGETS_S["generation"])
        with FlopCounterMode(display=False) as counter:
            make("meta")()
    operations = float(counter.get_total_flops())
    return {
        "a frame of seven views, 448x256, four steps": ms,
        "its operations": operations / 1e12,
        "its time by operations at the speed of a large matrix product": 1e3 * operations / _product_speed(machine),
    }


def measure_features(machine: Machine) -> dict[str, float]:
    """Count images whose Inception features are computed a second, from 8-bit images; the weights are random."""
    width, height = machine.size_px()
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (machine.count(_IMAGES, 4), height, width, 3), np.uint8)
    network = FidInception().eval().requires_grad_(False)
    features = InceptionFeatures(network, "tf1", name="smoke", batch=16, device=machine.device)
    with torch.inference_mode():
        ms = machine.median_ms(lambda: extract(features, images), 0.5 * BUDGETS_S["features"], most=20)
    return {f"Inception, {WIDTH_PX}x{HEIGHT_PX}": 1e3 * len(images) / ms}


def _frame_maker(
    config: TransformerConfig, size_px: tuple[int, int], machine: Machine
) -> Callable[[str], Callable[[], object]]:
    """Return a function from a device to a call that samples and decodes a frame there."""
    settings = SamplerSettings(_STEPS, precision="bf16" if machine.is_gpu else "float32")

    def make(device: str) -> Callable[[], object]:
        with torch.device(device):
            network, codec = Transformer(config), TinyAutoencoder(TinySettings(config.latent_channels))
        conditions = empty_conditions(config, size_px, VIEWS, device)
        grid = [side // config.latent_stride for side in size_px]
        references = torch.randn(1, TINY_REFERENCES, VIEWS, config.latent_channels, *grid, device=device)
        noise = torch.randn(1, 1, VIEWS, config.latent_channels, *grid, device=device)

        def frame() -> Tensor:
            latents = sample_frame(network, references, conditions, noise, settings)
            return codec.decode(latents.flatten(0, 2))

        return frame

    return make


def _product_speed(machine: Machine) -> float:
    """Operations a second of the product of two large square matrices, in the precision of the frame."""
    side = max(256, round(_SIDE * machine.scale**0.5))
    dtype = torch.bfloat16 if machine.is_gpu else torch.float32
    one, other = (torch.randn(side, side, dtype=dtype, device=machine.device) for _ in range(2))
    ms = machine.median_ms(lambda: one @ other, 0.1 * BUDGETS_S["generation"])
    return 2.0 * side**3 / (ms / 1e3)
