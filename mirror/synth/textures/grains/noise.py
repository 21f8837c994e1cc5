"""Building blocks of grains: periodic noise, shapes across the periodic edge, and joints."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np

from mirror.arrays import Float32, Float64
from mirror.portable import arrays


def waves(
    rng: np.random.Generator, size: int, longest: float, shortest: float, power: float = 1.0, stretch: float = 1.0
) -> Float32:
    """Draw periodic noise in a band of wavelengths.

    Args:
        rng: source of the noise.
        size: texels along a side.
        longest: longest wavelength, as a share of the period.
        shortest: shortest wavelength, as a share of the period.
        power: the amplitude falls with this power of the frequency; 0 gives white noise.
        stretch: ratio of the wavelengths along v to those along u.

    Returns:
        (size, size) noise, mean 0, standard deviation 1.
    """
    frequency = _frequencies(size, stretch)
    low, high = np.float32(1.0 / longest), np.float32(1.0 / shortest)
    # Soft ends of the band prevent ringing.
    above, below = (frequency / high) ** 2, ((frequency / low) ** 2) ** 2
    gain = (arrays.exp(-above) * (1.0 - arrays.exp(-below))).astype(np.float32)
    if power != 0.0:
        gain *= arrays.power(np.maximum(frequency, 1.0), -power).astype(np.float32)
    white = rng.standard_normal((*gain.shape, 2), np.float32).view(np.complex64)[..., 0]
    noise = np.fft.irfft2(white * gain, (size, size)).astype(np.float32)
    noise -= noise.mean()
    noise /= noise.std()
    return noise


@cache
def _frequencies(size: int, stretch: float) -> Float32:
    """(N, N / 2 + 1) frequencies in waves per period, with the stretch of `waves`."""
    across = np.fft.rfftfreq(size, 1.0 / size) / np.sqrt(stretch)
    down = np.fft.fftfreq(size, 1.0 / size)[:, None] * np.sqrt(stretch)
    return arrays.hypot(across, down).astype(np.float32)


def wrap_patch(x: float, y: float, reach: float, size: int) -> Iterator[tuple[float, float]]:
    """Return the positions at which a shape at (x, y) must be drawn so that the pattern is periodic."""
    shifts_x = (0.0, size) if x < reach else (0.0, -size) if x > size - reach else (0.0,)
    shifts_y = (0.0, size) if y < reach else (0.0, -size) if y > size - reach else (0.0,)
    for shift_x in shifts_x:
        for shift_y in shifts_y:
            yield x + shift_x, y + shift_y


def scatter_centres(size: int, period_m: float) -> Float64:
    """Return the positions of the texels' centres along a side, in metres."""
    places: Float64 = (np.arange(size, dtype=np.float64) + 0.5) * (period_m / size)
    return places


def joints(at_m: Float64, pitch_m: float, width_m: float, texel_m: float) -> Float64:
    """Compute the share of each texel that joints cover.

    Args:
        at_m: centres of texels.
        pitch_m: distance between the centres of joints; one is at 0.
        width_m: width of a joint.
        texel_m: width of a texel.
    """
    gap: Float64 = np.abs((at_m + 0.5 * pitch_m) % pitch_m - 0.5 * pitch_m)
    share: Float64 = np.clip((0.5 * (width_m + texel_m) - gap) / texel_m, 0.0, min(width_m / texel_m, 1.0))
    return share
