"""The compiled part of SSIM: a ring of rows under the window, four sums a row, nothing as large as the image.

Loops run along rows, of which each is contiguous, tap by tap: all of them vectorise.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mirror.arrays import AnyArray, Int64
from mirror.compiled import inner_njit

_QUANTITIES = 4


@njit(cache=True, nogil=True, fastmath={"contract"})
def similarity(
    render: AnyArray,
    truth: AnyArray,
    known: AnyArray | None,
    channels: int,
    centre: float,
    taps: AnyArray,
    c1: float,
    c2: float,
    sample_covariance: bool,
    out: AnyArray,
) -> None:
    """Write SSIM at every pixel whose whole window lies in the image.

    Args:
        render: (h + 2 radius, (w + 2 radius) C), of any type.
        truth: of the same shape and type.
        known: of the same shape, 1 where a value takes part, else 0; None: all do.
        channels: C.
        centre: subtracted from values before they are squared, in the type that it and they make together.
        taps: (2 radius + 1,) the window along one axis, symmetric, of sum 1.
        c1: the luminance term's constant.
        c2: the structure term's constant.
        sample_covariance: whether variances are divided by N - 1; windows are then uniform.
        out: (h, w C), written; of no meaning where a window holds nothing known.
    """
    rows, width = out.shape
    size = len(taps)
    reach = width + (size - 1) * channels
    ring = np.empty((_QUANTITIES, size * reach), out.dtype)
    known_ring = np.empty(size * reach, out.dtype)
    column = np.empty(reach, out.dtype)
    sums = np.empty((_QUANTITIES, width), out.dtype)
    share = np.empty(width, out.dtype)
    gain = np.empty(width, out.dtype)
    across = np.arange(size) * channels
    gain[:] = size**2 / (size**2 - 1.0) if sample_covariance else 1.0
    for row in range(rows + size - 1):
        slot = row % size * reach
        quantities = ring[:, slot : slot + reach]
        _enter(render[row], truth[row], centre, quantities)
        if known is not None:
            for x in range(reach):
                # Not a slice: the error of shapes that differ takes three seconds to compile.
                known_ring[slot + x] = known[row, x]
                if known[row, x] == 0:
                    quantities[:, x] = 0
        if row < size - 1:
            continue
        down = (row + 1 + np.arange(size)) % size * reach
        for quantity in range(_QUANTITIES):
            _weigh(ring[quantity], down, taps, column)
            _weigh(column, across, taps, sums[quantity])
        if known is not None:
            _weigh(known_ring, down, taps, column)
            _weigh(column, across, taps, share)
            _normalise(sums, share, size**2, sample_covariance, gain)
        _combine(sums[0], sums[1], sums[2], sums[3], gain, out.dtype.type(centre), c1, c2, out[row - size + 1])


@njit(cache=True, nogil=True, fastmath={"contract"})
def _enter(render: AnyArray, truth: AnyArray, centre: float, quantities: AnyArray) -> None:
    value, difference, power, power_difference = quantities[0], quantities[1], quantities[2], quantities[3]
    for x in range(len(value)):
        a, b = render[x] - centre, truth[x] - centre
        d = a - b
        value[x] = a
        difference[x] = d
        power[x] = a * a + b * b
        power_difference[x] = d * d


@njit(cache=True, nogil=True, fastmath={"contract"})
def _weigh(rows: AnyArray, starts: Int64, taps: AnyArray, out: AnyArray) -> None:
    """Weighted sum of stretches of ``rows``, of which opposite ones have equal weights: two pairs a pass."""
    size, width = len(taps), len(out)
    half = size // 2
    middle, weight = rows[starts[half] :], taps[half]
    done = half % 2
    if done:
        first, last, outer = rows[starts[0] :], rows[starts[size - 1] :], taps[0]
        for x in range(width):
            out[x] = weight * middle[x] + outer * (first[x] + last[x])
    else:
        for x in range(width):
            out[x] = weight * middle[x]
    for tap in range(done, half, 2):
        a, b, weight = rows[starts[tap] :], rows[starts[size - 1 - tap] :], taps[tap]
        c, d, other = rows[starts[tap + 1] :], rows[starts[size - 2 - tap] :], taps[tap + 1]
        for x in range(width):
            out[x] += weight * (a[x] + b[x]) + other * (c[x] + d[x])


@inner_njit
def _normalise(sums: AnyArray, share: AnyArray, pixels: int, sample_covariance: bool, gain: AnyArray) -> None:
    """Divide by the share of the window that is known."""
    one = gain.dtype.type(1)
    for x in range(len(share)):
        # A window without a known pixel has no result; nobody reads it.
        whole = share[x] if share[x] > 0 else one
        for quantity in range(_QUANTITIES):
            sums[quantity, x] /= whole
        if sample_covariance:
            count = whole * pixels
            gain[x] = count / max(count - one, one)


@njit(cache=True, nogil=True, fastmath={"contract"})
def _combine(
    mean: AnyArray,
    mean_difference: AnyArray,
    power: AnyArray,
    power_difference: AnyArray,
    gain: AnyArray,
    centre: float,
    c1: float,
    c2: float,
    out: AnyArray,
) -> None:
    for x in range(len(out)):
        a, d = mean[x], mean_difference[x]
        b = a - d
        # Variances are not negative but for rounding, whose sign means nothing; a maximum would not vectorise.
        variances = gain[x] * abs(power[x] - a * a - b * b) + c2
        variance = gain[x] * abs(power_difference[x] - d * d)
        a += centre
        b += centre
        squares = a * a + b * b + c1
        out[x] = (squares - d * d) * (variances - variance) / (squares * variances)
