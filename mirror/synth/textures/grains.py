"""Grains: grey patterns that repeat, with a mean of 1."""

from __future__ import annotations

import numpy as np

from mirror.arrays import Float32
from mirror.synth.textures.catalogue import Grain


def draw_grain(grain: Grain, size: int) -> Float32:
    """One period of a grain.

    Args:
        grain: which.
        size: texels along either side, a power of two.

    Returns:
        (size, size) factors of the reflectance, mean 1; rows go along v.
    """
    rng = np.random.default_rng([int(grain), 2718])
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)) * size
    shape = 1.0 / np.maximum(frequency, 1.0) ** 0.8
    waves = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((size, size))) * shape, (size, size))
    return (1.0 + 0.12 * (waves - waves.mean()) / waves.std()).astype(np.float32)
