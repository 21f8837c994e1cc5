"""The loss of normals, where stereo knows a surface: compiled, since that is a pixel in a hundred.

In torch, on whole images, it is the dearest of the losses by far.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

_NEAREST_M = 1e-3
_LEAST = 1e-24


def normal_loss(rendered_m: Tensor, stereo_m: Tensor, known: Tensor, K: Tensor) -> Tensor:
    """Mean absolute difference of curvatures, where stereo knows all of a pixel's surroundings.

    A normal is that of the plane through a pixel's four neighbours; the curvature is the square of the normals' Sobel
    gradients (3 x 3), summed over channels and directions. Both are made of depths alone, so that normals of stereo and
    of the street are made alike (the supplement, "Loss Function").

    Args:
        rendered_m: (H, W) expected depth.
        stereo_m: (H, W) depth of multi-view stereo; the normals come from the same depth.
        known: (H, W) bool: where there is one; a pixel counts where all 5 x 5 around it are.
        K: (3, 3).
    """
    found: Tensor = _NormalLoss.apply(rendered_m, stereo_m, known, K)
    return found


class _NormalLoss(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rendered_m: Tensor, stereo_m: Tensor, known: Tensor, K: Tensor) -> Tensor:
        rendered, stereo, mask = (one.detach().numpy() for one in (rendered_m, stereo_m, known))
        height, width = rendered.shape
        (fx, _, cx), (_, fy, cy), _ = K.double().numpy()
        x, y = (np.arange(width) + 0.5 - cx) / fx, (np.arange(height) + 0.5 - cy) / fy
        gradient = np.zeros((height, width))
        total, count = sum_differences(rendered, stereo, mask, x, y, gradient)
        ctx.gradient = torch.from_numpy(gradient).to(rendered_m.dtype) / max(count, 1)
        return rendered_m.new_tensor(total / max(count, 1))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        return gradients[0] * ctx.gradient, None, None, None


@numba.njit(cache=True, nogil=True, error_model="numpy")
def sum_differences(rendered: Any, stereo: Any, known: Any, x: Any, y: Any, gradient: Any) -> Any:
    """Sum of the differences, and of how many pixels; `gradient` (H, W), zeros, gets that of the sum."""
    height, width = rendered.shape
    total, count = 0.0, 0
    theirs, ours = np.empty((3, 3, 5)), np.empty((3, 3, 5))
    for row in range(1, height - 1):
        for column in range(1, width - 1):
            if not _surrounded(known, row, column):
                continue
            count += 1
            target, _, _ = _curvature(stereo, x, y, row, column, theirs)
            found, down, across = _curvature(rendered, x, y, row, column, ours)
            total += abs(found - target)
            sign = 1.0 if found > target else (-1.0 if found < target else 0.0)
            if sign != 0.0:
                _pull(rendered, x, y, row, column, ours, down, across, 2.0 * sign, gradient)
    return total, count


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _surrounded(known: Any, row: Any, column: Any) -> Any:
    """Whether all 5 x 5 pixels around are known, as far as there are any."""
    if not known[row, column]:
        return False
    for i in range(max(row - 2, 0), min(row + 3, known.shape[0])):
        for j in range(max(column - 2, 0), min(column + 3, known.shape[1])):
            if not known[i, j]:
                return False
    return True


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _curvature(depth: Any, x: Any, y: Any, row: Any, column: Any, normals: Any) -> Any:
    """The curvature at a pixel, and the Sobel gradients of its normals down and across.

    `normals` (3, 3, 5) gets the normals around, the inverse of the length that each had, and whether it had one.
    """
    for i in range(3):
        for j in range(3):
            right, down = _tangents(depth, x, y, row + i - 1, column + j - 1)
            a = down[1] * right[2] - down[2] * right[1]
            b = down[2] * right[0] - down[0] * right[2]
            c = down[0] * right[1] - down[1] * right[0]
            square = a * a + b * b + c * c
            inverse = 1.0 / math.sqrt(max(square, _LEAST))
            normals[i, j, 0], normals[i, j, 1], normals[i, j, 2] = a * inverse, b * inverse, c * inverse
            normals[i, j, 3], normals[i, j, 4] = inverse, 1.0 if square > _LEAST else 0.0
    down0, across0 = _slopes(normals, 0)
    down1, across1 = _slopes(normals, 1)
    down2, across2 = _slopes(normals, 2)
    total = down0 * down0 + down1 * down1 + down2 * down2
    total += across0 * across0 + across1 * across1 + across2 * across2
    return total, (down0, down1, down2), (across0, across1, across2)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _slopes(normals: Any, axis: Any) -> Any:
    """Sobel gradients of one axis of the normals, down and across."""
    down, across = 0.0, 0.0
    for i in range(3):
        for j in range(3):
            down += _sobel(i, j) * normals[i, j, axis]
            across += _sobel(j, i) * normals[i, j, axis]
    return down, across


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _tangents(depth: Any, x: Any, y: Any, row: Any, column: Any) -> Any:
    """From the left neighbour to the right one and from the upper to the lower, in the camera's frame."""
    above, below = max(row - 1, 0), min(row + 1, depth.shape[0] - 1)
    left, right = max(column - 1, 0), min(column + 1, depth.shape[1] - 1)
    near, far = _depth(depth, row, left), _depth(depth, row, right)
    high, low = _depth(depth, above, column), _depth(depth, below, column)
    return (
        (x[right] * far - x[left] * near, y[row] * (far - near), far - near),
        (x[column] * (low - high), y[below] * low - y[above] * high, low - high),
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _depth(depth: Any, row: Any, column: Any) -> Any:
    return max(float(depth[row, column]), _NEAREST_M)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _pull(
    depth: Any, x: Any, y: Any, row: Any, column: Any, normals: Any, down: Any, across: Any, scale: Any, gradient: Any
) -> None:
    """Add the gradient of a pixel's curvature, `scale` halves of it, to those of the depths around."""
    for i in range(3):
        for j in range(3):
            one, other = _sobel(i, j), _sobel(j, i)
            u = scale * (one * down[0] + other * across[0])
            v = scale * (one * down[1] + other * across[1])
            w = scale * (one * down[2] + other * across[2])
            # Through the division by the length: what is along the normal changes nothing.
            n0, n1, n2 = normals[i, j, 0], normals[i, j, 1], normals[i, j, 2]
            along = (u * n0 + v * n1 + w * n2) * normals[i, j, 4]
            inverse = normals[i, j, 3]
            a, b, c = (u - along * n0) * inverse, (v - along * n1) * inverse, (w - along * n2) * inverse
            centre, middle = row + i - 1, column + j - 1
            right, low = _tangents(depth, x, y, centre, middle)
            # a . (d x r): by r it is a x d, by d it is r x a.
            r0, r1, r2 = b * low[2] - c * low[1], c * low[0] - a * low[2], a * low[1] - b * low[0]
            d0, d1, d2 = right[1] * c - right[2] * b, right[2] * a - right[0] * c, right[0] * b - right[1] * a
            above, below = max(centre - 1, 0), min(centre + 1, depth.shape[0] - 1)
            before, after = max(middle - 1, 0), min(middle + 1, depth.shape[1] - 1)
            _add(gradient, depth, centre, after, r0 * x[after] + r1 * y[centre] + r2)
            _add(gradient, depth, centre, before, -(r0 * x[before] + r1 * y[centre] + r2))
            _add(gradient, depth, below, middle, d0 * x[middle] + d1 * y[below] + d2)
            _add(gradient, depth, above, middle, -(d0 * x[middle] + d1 * y[above] + d2))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sobel(along: Any, beside: Any) -> Any:
    """What Sobel's kernel has at a place: the difference along, the smoothing beside."""
    return (along - 1.0) * (2.0 if beside == 1 else 1.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _add(gradient: Any, depth: Any, row: Any, column: Any, value: Any) -> None:
    if depth[row, column] >= _NEAREST_M:
        gradient[row, column] += value
