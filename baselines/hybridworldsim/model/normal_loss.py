"""The loss of normals where stereo depth is known: compiled, because about one pixel in a hundred is known.

In torch, on complete images, it is by far the most expensive of the losses.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from hybridworldsim.kernels.dispatch import is_compiled
from hybridworldsim.model.plain import losses as plain

_NEAREST_M = 1e-3
_LEAST = 1e-24


def normal_loss(rendered_m: Tensor, stereo_m: Tensor, known: Tensor, K: Tensor) -> Tensor:
    """Return the mean absolute difference of curvatures over pixels where stereo depth is known all around.

    A normal is that of the plane through a pixel's four neighbours. The curvature is the square of the normals' Sobel
    gradients (3 x 3), summed over channels and directions. Both are computed from depth alone, so that the normals of
    stereo and of the street are computed in the same way (the supplement, "Loss Function").

    Args:
        rendered_m: (H, W) expected depth.
        stereo_m: (H, W) depth of multi-view stereo; its normals are computed from it.
        known: (H, W) bool: where stereo depth is known; a pixel counts if all 5 x 5 pixels around it are known.
        K: (3, 3) intrinsics, pixels.
    """
    if not is_compiled(rendered_m):
        lens = K.to(rendered_m.device, rendered_m.dtype, non_blocking=True)
        return plain.normal_loss(rendered_m, stereo_m, known, lens)
    loss: Tensor = _NormalLoss.apply(rendered_m, stereo_m, known, K)
    return loss


class _NormalLoss(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rendered_m: Tensor, stereo_m: Tensor, known: Tensor, K: Tensor) -> Tensor:
        rendered, stereo, mask = (image.detach().numpy() for image in (rendered_m, stereo_m, known))
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
    """Sum the differences and count the pixels; the gradient of the sum is added to `gradient` (H, W)."""
    height, width = rendered.shape
    total, count = 0.0, 0
    stereo_normals, rendered_normals = np.empty((3, 3, 5)), np.empty((3, 3, 5))
    for row in range(1, height - 1):
        for column in range(1, width - 1):
            if not _is_surrounded(known, row, column):
                continue
            count += 1
            target, _, _ = _curvature(stereo, x, y, row, column, stereo_normals)
            curvature, down, across = _curvature(rendered, x, y, row, column, rendered_normals)
            total += abs(curvature - target)
            sign = 1.0 if curvature > target else (-1.0 if curvature < target else 0.0)
            if sign != 0.0:
                _add_curvature_gradient(
                    rendered, x, y, row, column, rendered_normals, down, across, 2.0 * sign, gradient
                )
    return total, count


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _is_surrounded(known: Any, row: Any, column: Any) -> Any:
    """Return whether all 5 x 5 pixels around are known, within the image."""
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

    `normals` (3, 3, 5) receives the normals around, the inverse length of each before normalization, and 1 if that
    length is not zero.
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
    down0, across0 = _sobel_gradients(normals, 0)
    down1, across1 = _sobel_gradients(normals, 1)
    down2, across2 = _sobel_gradients(normals, 2)
    total = down0 * down0 + down1 * down1 + down2 * down2
    total += across0 * across0 + across1 * across1 + across2 * across2
    return total, (down0, down1, down2), (across0, across1, across2)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sobel_gradients(normals: Any, axis: Any) -> Any:
    """Sobel gradients of one component of the normals, down and across."""
    down, across = 0.0, 0.0
    for i in range(3):
        for j in range(3):
            down += _sobel(i, j) * normals[i, j, axis]
            across += _sobel(j, i) * normals[i, j, axis]
    return down, across


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _tangents(depth: Any, x: Any, y: Any, row: Any, column: Any) -> Any:
    """Vectors from the left to the right neighbour and from the upper to the lower one, in the camera's frame."""
    above, below = max(row - 1, 0), min(row + 1, depth.shape[0] - 1)
    left, right = max(column - 1, 0), min(column + 1, depth.shape[1] - 1)
    left_m, right_m = _depth(depth, row, left), _depth(depth, row, right)
    above_m, below_m = _depth(depth, above, column), _depth(depth, below, column)
    return (
        (x[right] * right_m - x[left] * left_m, y[row] * (right_m - left_m), right_m - left_m),
        (x[column] * (below_m - above_m), y[below] * below_m - y[above] * above_m, below_m - above_m),
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _depth(depth: Any, row: Any, column: Any) -> Any:
    return max(float(depth[row, column]), _NEAREST_M)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _add_curvature_gradient(
    depth: Any, x: Any, y: Any, row: Any, column: Any, normals: Any, down: Any, across: Any, scale: Any, gradient: Any
) -> None:
    """Add the gradient of a pixel's curvature, times `scale` / 2, to the gradients of the depths around."""
    for i in range(3):
        for j in range(3):
            sobel_down, sobel_across = _sobel(i, j), _sobel(j, i)
            u = scale * (sobel_down * down[0] + sobel_across * across[0])
            v = scale * (sobel_down * down[1] + sobel_across * across[1])
            w = scale * (sobel_down * down[2] + sobel_across * across[2])
            # Derivative of the normalization: the component along the normal has no effect.
            n0, n1, n2 = normals[i, j, 0], normals[i, j, 1], normals[i, j, 2]
            along = (u * n0 + v * n1 + w * n2) * normals[i, j, 4]
            inverse = normals[i, j, 3]
            a, b, c = (u - along * n0) * inverse, (v - along * n1) * inverse, (w - along * n2) * inverse
            centre, middle = row + i - 1, column + j - 1
            right, low = _tangents(depth, x, y, centre, middle)
            # The gradient of a . (d x r) is a x d with respect to r, and r x a with respect to d.
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
    """An element of the Sobel kernel: the difference along one axis times the smoothing beside it."""
    return (along - 1.0) * (2.0 if beside == 1 else 1.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _add(gradient: Any, depth: Any, row: Any, column: Any, value: Any) -> None:
    if depth[row, column] >= _NEAREST_M:
        gradient[row, column] += value
