"""The compiled part of `ms_structure`: each pass reads every pixel once, in place of a dozen arrays between."""

from __future__ import annotations

import math

from numba import njit

from mirror.arrays import Float64


@njit(cache=True, nogil=True)
def multiply_bands(
    fine_render: Float64,
    fine_truth: Float64,
    fine_share: Float64,
    smooth_render: Float64,
    smooth_truth: Float64,
    share: Float64,
    known: Float64,
    squares: Float64,
    true_squares: Float64,
    products: Float64,
) -> None:
    """Subtract the window means from render and truth; write the squares and the product of the differences.

    Args:
        fine_render: (H, W) sums of small windows of the render, or the render itself, 0 outside the mask.
        fine_truth: (H, W) those of the truth.
        fine_share: (H, W) share of each small window that is in the mask.
        smooth_render: (H, W) sums of windows of the render.
        smooth_truth: (H, W) sums of windows of the truth.
        share: (H, W) share of each window that is in the mask.
        known: (H, W) 1 in the mask, else 0.
        squares: (H, W) written: those of the render.
        true_squares: (H, W) written: those of the truth.
        products: (H, W) written: render times truth.
    """
    for row in range(known.shape[0]):
        for column in range(known.shape[1]):
            x = y = 0.0
            # Where the mask is, its shares are not 0.
            if known[row, column] > 0.0:
                x = fine_render[row, column] / fine_share[row, column] - smooth_render[row, column] / share[row, column]
                y = fine_truth[row, column] / fine_share[row, column] - smooth_truth[row, column] / share[row, column]
            squares[row, column] = x * x
            true_squares[row, column] = y * y
            products[row, column] = x * y


@njit(cache=True, nogil=True)
def sum_scores(
    squares: Float64,
    true_squares: Float64,
    products: Float64,
    share: Float64,
    known: Float64,
    rounding_variance: float,
    weight_variance: float,
    least_share: float,
) -> tuple[float, float]:
    """Sum weights and weighted gains over the mask; a gain is ``r |r|``, or its excess over the least share.

    Sums of windows hold the mask's share of each, by which means would be divided: the constants get it instead.

    Args:
        squares: (H, W) sums of windows of the render's squares.
        true_squares: (H, W) sums of windows of the truth's squares.
        products: (H, W) sums of windows of the products.
        share: (H, W) share of each window that is in the mask.
        known: (H, W) 1 in the mask, else 0.
        rounding_variance: q of the definition.
        weight_variance: C of the definition.
        least_share: ``r |r|`` up to which a window gains nothing; negative: none.

    Returns:
        The weighted sum of the gains, and the sum of the weights.
    """
    weighted = total = 0.0
    for row in range(known.shape[0]):
        for column in range(known.shape[1]):
            rounding = rounding_variance * share[row, column]
            y = true_squares[row, column]
            # Less than rounding to 8 bits is no structure.
            if known[row, column] > 0.0 and y > rounding:
                weight = y / (y + weight_variance * share[row, column])
                r = products[row, column] / math.sqrt((squares[row, column] + rounding) * (y + rounding))
                gain = r * abs(r)
                if least_share >= 0.0:
                    gain = max(gain - least_share, 0.0) / (1.0 - least_share)
                weighted += weight * gain
                total += weight
    return weighted, total
