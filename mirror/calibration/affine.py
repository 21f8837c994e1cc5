"""Refinement of tracked points by an affine, gain-compensated patch alignment.

A surface that is passed at an angle is stretched and sheared between two images; a tracker that only shifts its window
then has an error with a sign, which no number of tracks averages away. Here the window of the first image is aligned
with the second by six affine parameters, a gain and an offset: the inverse compositional algorithm of S. Baker and
I. Matthews, "Lucas-Kanade 20 Years On" (2004), which inverts one 8 x 8 matrix a point. Pixels near the middle of the
window weigh more (a Gaussian).
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np

from mirror.arrays import Bool, Float32, Float64
from mirror.compiled import inner_njit

_RADIUS: Final = 8
_ITERATIONS: Final = 15
_SIGMA: Final = 5.0
_STOP_PX: Final = 0.003
_FARTHEST_PX: Final = 2.0
_LARGEST_RMS: Final = 0.35


def refine_tracks(first: Float32, second: Float32, first_px: Float64, second_px: Float64) -> tuple[Float64, Bool]:
    """Align patches around tracked points.

    Args:
        first: (H, W) grey image, slightly smoothed.
        second: (H, W) grey image, smoothed alike.
        first_px: (N, 2) points in the first image; the first pixel has its centre at (0, 0).
        second_px: (N, 2) approximate points in the second image.

    Returns:
        Refined points (N, 2) in the second image, and (N,) whether the alignment converged near its start.
    """
    out = second_px.copy()
    good = np.zeros(len(out), np.bool_)
    _align(first, second, first_px, out, good)
    return out, good


@inner_njit
def _bilinear(image: Float32, x: float, y: float) -> float:  # pragma: no cover
    column, row = int(x), int(y)
    a, b = x - column, y - row
    top = (1.0 - a) * image[row, column] + a * image[row, column + 1]
    low = (1.0 - a) * image[row + 1, column] + a * image[row + 1, column + 1]
    return (1.0 - b) * top + b * low


@numba.njit(cache=True, nogil=True)
def _align(
    first: Float32, second: Float32, first_px: Float64, second_px: Float64, good: Bool
) -> None:  # pragma: no cover
    height, width = first.shape
    side = 2 * _RADIUS + 1
    template = np.empty(side * side)
    basis = np.empty((side * side, 8))
    weights = np.empty(side * side)
    for point in range(len(first_px)):
        x0, y0 = first_px[point, 0], first_px[point, 1]
        margin = _RADIUS + 2
        if not (margin < x0 < width - margin - 1 and margin < y0 < height - margin - 1):
            continue
        matrix = np.zeros((8, 8))
        total, mean, square = 0.0, 0.0, 0.0
        for dy in range(-_RADIUS, _RADIUS + 1):
            for dx in range(-_RADIUS, _RADIUS + 1):
                at = (dy + _RADIUS) * side + dx + _RADIUS
                x, y = x0 + dx, y0 + dy
                value = _bilinear(first, x, y)
                gx = 0.5 * (_bilinear(first, x + 1.0, y) - _bilinear(first, x - 1.0, y))
                gy = 0.5 * (_bilinear(first, x, y + 1.0) - _bilinear(first, x, y - 1.0))
                template[at] = value
                basis[at, 0], basis[at, 1] = gx, gy
                basis[at, 2], basis[at, 3] = gx * dx / _SIGMA, gx * dy / _SIGMA
                basis[at, 4], basis[at, 5] = gy * dx / _SIGMA, gy * dy / _SIGMA
                basis[at, 6], basis[at, 7] = value / 64.0, 1.0
                weight = np.exp(-0.5 * (dx * dx + dy * dy) / _SIGMA**2)
                weights[at] = weight
                total += weight
                mean += weight * value
                square += weight * value * value
        mean /= total
        spread = square / total - mean * mean
        if spread < 1.0:
            continue
        for at in range(side * side):
            for i in range(8):
                for j in range(i, 8):
                    matrix[i, j] += weights[at] * basis[at, i] * basis[at, j]
        for i in range(8):
            for j in range(i):
                matrix[i, j] = matrix[j, i]
            matrix[i, i] *= 1.0 + 1e-6
        if np.linalg.det(matrix / (np.trace(matrix) / 8.0)) < 1e-30:
            continue
        inverse = np.linalg.inv(matrix)
        # The warp: second = shift + linear @ offset.
        sx, sy = second_px[point, 0], second_px[point, 1]
        a00, a01, a10, a11 = 1.0, 0.0, 0.0, 1.0
        gain, offset = 1.0, 0.0
        vector = np.empty(8)
        inside, converged, error = True, False, 0.0
        for _ in range(_ITERATIONS):
            vector[:] = 0.0
            error = 0.0
            for dy in range(-_RADIUS, _RADIUS + 1):
                for dx in range(-_RADIUS, _RADIUS + 1):
                    at = (dy + _RADIUS) * side + dx + _RADIUS
                    x, y = sx + a00 * dx + a01 * dy, sy + a10 * dx + a11 * dy
                    if not (1.0 <= x < width - 2.0 and 1.0 <= y < height - 2.0):
                        inside = False
                        break
                    off = gain * _bilinear(second, x, y) + offset - template[at]
                    error += weights[at] * off * off
                    for i in range(8):
                        vector[i] += weights[at] * basis[at, i] * off
                if not inside:
                    break
            if not inside:
                break
            step = inverse @ vector
            # Compose with the inverse of the step's warp, which acts on the template's side.
            b00, b01 = 1.0 + step[2] / _SIGMA, step[3] / _SIGMA
            b10, b11 = step[4] / _SIGMA, 1.0 + step[5] / _SIGMA
            determinant = b00 * b11 - b01 * b10
            if abs(determinant) < 0.1:
                inside = False
                break
            i00, i01, i10, i11 = b11 / determinant, -b01 / determinant, -b10 / determinant, b00 / determinant
            mx, my = -(i00 * step[0] + i01 * step[1]), -(i10 * step[0] + i11 * step[1])
            sx += a00 * mx + a01 * my
            sy += a10 * mx + a11 * my
            a00, a01, a10, a11 = (
                a00 * i00 + a01 * i10,
                a00 * i01 + a01 * i11,
                a10 * i00 + a11 * i10,
                a10 * i01 + a11 * i11,
            )
            gain = gain / (1.0 + step[6] / 64.0)
            offset = (offset - step[7]) / (1.0 + step[6] / 64.0)
            if mx * mx + my * my < _STOP_PX * _STOP_PX:
                converged = True
                break
        moved = (sx - second_px[point, 0]) ** 2 + (sy - second_px[point, 1]) ** 2
        if inside and converged and moved < _FARTHEST_PX**2 and error / total < _LARGEST_RMS**2 * spread:
            second_px[point, 0], second_px[point, 1] = sx, sy
            good[point] = True
