"""The compiled part of PSNR*: sums over the pixels of large RGB images, in three passes for each fit.

Numpy writes ten terms of each pixel to memory, and its products of ten rows with themselves compute both halves.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mirror.arrays import Bool, Float64
from mirror.compiled import inner_numpy_njit

_BLOCK = 256
_TERMS = 10
_POWERS = [(2, 0, 0), (1, 1, 0), (1, 0, 1), (0, 2, 0), (0, 1, 1), (0, 0, 2), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0)]
_PRODUCTS = {tuple(a + b for a, b in zip(_POWERS[i], _POWERS[j])): (i, j) for i in range(10) for j in range(i, 10)}
# The 55 products of two terms are 35 monomials: a pair of terms for each, and the monomial of each pair.
_PAIRS = np.array(list(_PRODUCTS.values()))
_MONOMIAL = np.array(
    [[list(_PRODUCTS).index(tuple(a + b for a, b in zip(one, two))) for two in _POWERS] for one in _POWERS]
)
# Sums may be taken in any order: four or eight at a time.
_SUMS = {"reassoc", "contract", "nsz"}


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_SUMS)
def measure_spread(colours: Float64, mean: Float64, covariance: Float64) -> None:
    """Write the mean (3,) and the covariance (3, 3) of colours (3, N)."""
    count = colours.shape[1]
    for channel in range(3):
        total = 0.0
        for pixel in range(count):
            total += colours[channel, pixel]
        mean[channel] = total / count
    for first in range(3):
        for second in range(first, 3):
            total = 0.0
            for pixel in range(count):
                total += (colours[first, pixel] - mean[first]) * (colours[second, pixel] - mean[second])
            covariance[first, second] = covariance[second, first] = total / count


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_SUMS)
def warp_colours(colours: Float64, warp: Float64) -> None:
    """Warp colours (3, N) in place by coefficients (3, 10), clipped to 0 and 1.

    The terms are the products xx, xy, xz, yy, yz, zz, the colours x, y, z, and one.
    """
    for pixel in range(colours.shape[1]):
        x, y, z = colours[0, pixel], colours[1, pixel], colours[2, pixel]
        for channel in range(3):
            w = warp[channel]
            value = x * (w[0] * x + w[1] * y + w[2] * z + w[6]) + y * (w[3] * y + w[4] * z + w[7])
            value += z * (w[5] * z + w[8]) + w[9]
            colours[channel, pixel] = min(max(value, 0.0), 1.0)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_SUMS)
def add_equations(
    colours: Float64,
    target: Float64,
    usable: Bool,
    least: float,
    whiten: Float64,
    mean: Float64,
    gram: Float64,
    moments: Float64,
) -> None:
    """Add up the normal equations of the fits of three channels.

    Args:
        colours: (3, N) present colours of the render.
        target: (3, N) colours of the photograph.
        usable: (3, N) pixels that are saturated neither in the photograph nor in the first render.
        least: smallest value that is not saturated; 1 less it is the largest.
        whiten: (3, 3) from centred colours to those of the terms.
        mean: (3,) mean of the colours.
        gram: (3, 10, 10) out: sums of products of two terms.
        moments: (3, 10) out: sums of products of a term with the target.
    """
    terms, wanted = np.empty((_TERMS, _BLOCK)), np.empty((3, _BLOCK))
    fits, single = np.empty((3, _BLOCK), np.bool_), np.zeros((3, _TERMS, _TERMS))
    common = np.zeros(len(_PAIRS))
    gram[:] = 0.0
    moments[:] = 0.0
    for start in range(0, colours.shape[1], _BLOCK):
        count, some = min(_BLOCK, colours.shape[1] - start), False
        for place in range(count):
            pixel = start + place
            r, g, b = colours[0, pixel] - mean[0], colours[1, pixel] - mean[1], colours[2, pixel] - mean[2]
            x = whiten[0, 0] * r + whiten[0, 1] * g + whiten[0, 2] * b
            y = whiten[1, 0] * r + whiten[1, 1] * g + whiten[1, 2] * b
            z = whiten[2, 0] * r + whiten[2, 1] * g + whiten[2, 2] * b
            every = True
            for channel in range(3):
                colour = colours[channel, pixel]
                fit = usable[channel, pixel] and colour >= least and colour <= 1.0 - least
                fits[channel, place] = fit
                every = every and fit
                some = some or fit
                wanted[channel, place] = target[channel, pixel]
            weight = 1.0 if every else 0.0
            x, y, z = weight * x, weight * y, weight * z
            terms[0, place], terms[1, place], terms[2, place] = x * x, x * y, x * z
            terms[3, place], terms[4, place], terms[5, place] = y * y, y * z, z * z
            terms[6, place], terms[7, place], terms[8, place], terms[9, place] = x, y, z, weight
        for pair in range(len(_PAIRS)):
            one, two = terms[_PAIRS[pair, 0]], terms[_PAIRS[pair, 1]]
            total = 0.0
            for place in range(count):
                total += one[place] * two[place]
            common[pair] += total
        for first in range(_TERMS):
            for channel in range(3):
                total = 0.0
                for place in range(count):
                    total += terms[first, place] * wanted[channel, place]
                moments[channel, first] += total
        if some:
            _add_single_channels(colours, target, fits, whiten, mean, start, count, single, moments)
    for channel in range(3):
        for first in range(_TERMS):
            for second in range(first, _TERMS):
                total = common[_MONOMIAL[first, second]] + single[channel, first, second]
                gram[channel, first, second] = gram[channel, second, first] = total


@inner_numpy_njit
def _add_single_channels(
    colours: Float64,
    target: Float64,
    fits: Bool,
    whiten: Float64,
    mean: Float64,
    start: int,
    count: int,
    single: Float64,
    moments: Float64,
) -> None:
    """Add up pixels of a block of which one or two channels fit."""
    terms, values = np.empty(_TERMS), np.empty(3)
    for place in range(count):
        number = int(fits[0, place]) + int(fits[1, place]) + int(fits[2, place])
        if number in (0, 3):
            continue
        pixel = start + place
        for axis in range(3):
            values[axis] = 0.0
            for channel in range(3):
                values[axis] += whiten[axis, channel] * (colours[channel, pixel] - mean[channel])
        row = 0
        for first in range(3):
            for second in range(first, 3):
                terms[row] = values[first] * values[second]
                row += 1
        terms[6], terms[7], terms[8], terms[9] = values[0], values[1], values[2], 1.0
        for channel in range(3):
            if not fits[channel, place]:
                continue
            for first in range(_TERMS):
                moments[channel, first] += terms[first] * target[channel, pixel]
                for second in range(first, _TERMS):
                    single[channel, first, second] += terms[first] * terms[second]
