"""What grains are made of: noise that repeats, shapes that go round the edge, and lines of joints."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np

from mirror.arrays import Float32, Float64


def waves(
    rng: np.random.Generator, size: int, longest: float, shortest: float, power: float = 1.0, stretch: float = 1.0
) -> Float32:
    """Noise of a band of wavelengths, that repeats.

    Args:
        rng: of the noise.
        size: texels along either side.
        longest: wavelength, as a share of the period.
        shortest: wavelength, as a share of the period.
        power: amplitude falls with frequency to this power; 0 is as rough as white noise.
        stretch: how much longer the waves are along v than along u; below 1 they are longer along u.

    Returns:
        (size, size), mean 0, standard deviation 1.
    """
    frequency = _frequencies(size, stretch)
    low, high = np.float32(1.0 / longest), np.float32(1.0 / shortest)
    # Soft ends of the band keep its ripples from ringing.
    gain = np.exp(-((frequency / high) ** 2)) * (1.0 - np.exp(-((frequency / low) ** 4)))
    if power != 0.0:
        gain *= np.maximum(frequency, 1.0) ** np.float32(-power)
    white = rng.standard_normal((*gain.shape, 2), np.float32).view(np.complex64)[..., 0]
    made = np.fft.irfft2(white * gain, (size, size)).astype(np.float32)
    made -= made.mean()
    made /= made.std()
    return made


@cache
def _frequencies(size: int, stretch: float) -> Float32:
    """(N, N / 2 + 1) waves a period, as `waves` stretches them."""
    across = np.fft.rfftfreq(size, 1.0 / size) / np.sqrt(stretch)
    down = np.fft.fftfreq(size, 1.0 / size)[:, None] * np.sqrt(stretch)
    return np.hypot(across, down).astype(np.float32)


def wrapped(x: float, y: float, reach: float, size: int) -> Iterator[tuple[float, float]]:
    """Where a shape at (x, y) must be drawn so that what leaves one edge comes in at the other."""
    shifts_x = (0.0, size) if x < reach else (0.0, -size) if x > size - reach else (0.0,)
    shifts_y = (0.0, size) if y < reach else (0.0, -size) if y > size - reach else (0.0,)
    for shift_x in shifts_x:
        for shift_y in shifts_y:
            yield x + shift_x, y + shift_y


def middles(size: int, period_m: float) -> Float64:
    """Where the texels' middles are along one side, metres."""
    places: Float64 = (np.arange(size, dtype=np.float64) + 0.5) * (period_m / size)
    return places


def joints(at_m: Float64, pitch_m: float, width_m: float, texel_m: float) -> Float64:
    """Share of each texel that joints cover.

    Args:
        at_m: middles of texels.
        pitch_m: from one joint's middle to the next; one lies at 0.
        width_m: of a joint.
        texel_m: of a texel.
    """
    gap: Float64 = np.abs((at_m + 0.5 * pitch_m) % pitch_m - 0.5 * pitch_m)
    share: Float64 = np.clip((0.5 * (width_m + texel_m) - gap) / texel_m, 0.0, min(width_m / texel_m, 1.0))
    return share
