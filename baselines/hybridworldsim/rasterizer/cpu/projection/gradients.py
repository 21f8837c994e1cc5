"""Functions that the gradients of all projections share: from output records to Gaussians.

`grad_x` is the gradient of the loss with respect to x, which gsplat calls `v_x`: `grad_scale` is that of a Gaussian's
scales.

Kernels take the gradients to the records as flat arrays `(means2d, depths, conics, compensations)`, and the strides of
these four arrays. An output without a gradient has an array of three zeros with stride 0.
"""

from __future__ import annotations

from typing import Any

from hybridworldsim.kernels import lanes
from hybridworldsim.kernels.compilation import kernel

_RATIO_MIN = 1e-290  # ratio of the determinants below which the slope of the square root overflows


@kernel(inline="always")
def multiply_by(number: Any, triple: Any) -> Any:
    """Multiply a triple by a number."""
    return number * triple[0], number * triple[1], number * triple[2]


@kernel(inline="always")
def add(a: Any, b: Any) -> Any:
    """Add two triples."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel(inline="always")
def combine(a: Any, first: Any, b: Any, second: Any) -> Any:
    """Add two triples, each multiplied by a number."""
    return a * first[0] + b * second[0], a * first[1] + b * second[1], a * first[2] + b * second[2]


@kernel(inline="always")
def select_rows(ids: Any, start: Any, end: Any, rows: Any) -> None:
    """Write to `rows` the next eight places in `ids`, then the indices there; spare lanes repeat the first."""
    for lane in range(8):
        rows[lane] = start + lane if start + lane < end else start
        rows[8 + lane] = ids[rows[lane]]


@kernel(inline="always")
def load_upstream(upstream: Any, strides: Any, rows: Any, lanes_in_use: Any) -> Any:
    """Load gradients with respect to mean, depth, conic and compensation; spare lanes get zeros."""
    grad_means2d, grad_depths, grad_conics, grad_compensations = upstream
    mean_stride, depth_stride, conic_stride, compensation_stride = strides
    return (
        (
            lanes.select(lanes_in_use, lanes.gather(grad_means2d, rows, 0, mean_stride, 0), 0.0),
            lanes.select(lanes_in_use, lanes.gather(grad_means2d, rows, 0, mean_stride, 1), 0.0),
        ),
        lanes.select(lanes_in_use, lanes.gather(grad_depths, rows, 0, depth_stride, 0), 0.0),
        (
            lanes.select(lanes_in_use, lanes.gather(grad_conics, rows, 0, conic_stride, 0), 0.0),
            lanes.select(lanes_in_use, lanes.gather(grad_conics, rows, 0, conic_stride, 1), 0.0),
            lanes.select(lanes_in_use, lanes.gather(grad_conics, rows, 0, conic_stride, 2), 0.0),
        ),
        lanes.select(lanes_in_use, lanes.gather(grad_compensations, rows, 0, compensation_stride, 0), 0.0),
    )


@kernel(inline="always")
def covariance_gradient(camera: Any, shape: Any, grad_conic: Any, grad_compensation: Any) -> Any:
    """Compute the gradient with respect to the 2D covariance's xx, xy (one of two equal entries) and yy.

    Args:
        camera: `KernelCamera`.
        shape: xx, xy, yy and determinant of the covariance before the blur.
        grad_conic: gradients to the three entries of the conic.
        grad_compensation: gradient to the compensation.
    """
    xx, xy, yy, sharp = shape
    blurred_x, blurred_y = xx + camera.blur, yy + camera.blur
    inverse = 1.0 / (sharp + camera.blur * (xx + yy) + camera.blur * camera.blur)
    p, q, r = blurred_y * inverse, 0.0 - xy * inverse, blurred_x * inverse
    half = 0.5 * grad_conic[1]
    t00, t01 = p * grad_conic[0] + q * half, p * half + q * grad_conic[2]
    t10, t11 = q * grad_conic[0] + r * half, q * half + r * grad_conic[2]
    grad_xx, grad_xy, grad_yy = 0.0 - (t00 * p + t01 * q), 0.0 - (t00 * q + t01 * r), 0.0 - (t10 * q + t11 * r)
    if camera.antialiased:
        ratio = sharp * inverse
        free = (ratio > camera.ratio_min) & (ratio > _RATIO_MIN)
        grad_ratio = lanes.select(free, 0.5 * grad_compensation / lanes.sqrt(ratio), 0.0) * inverse
        grad_xx = grad_xx + grad_ratio * (yy - ratio * blurred_y)
        grad_xy = grad_xy + grad_ratio * (ratio - 1.0) * xy
        grad_yy = grad_yy + grad_ratio * (xx - ratio * blurred_x)
    return grad_xx, grad_xy, grad_yy


@kernel(inline="always")
def quaternion_gradient(quaternion: Any, k: Any, first: Any, second: Any, third: Any) -> Any:
    """Compute the gradient of a quaternion from the gradient of its rotation's rows; k is 2 / squared norm."""
    w, x, y, z = quaternion
    v01, v02, v12 = second[0] + first[1], first[2] + third[0], second[2] + third[1]
    d21, d02, d10 = third[1] - second[2], first[2] - third[0], second[0] - first[1]
    grad_w = k * (x * d21 + y * d02 + z * d10)
    grad_x = k * (w * d21 + y * v01 + z * v02 - 2.0 * x * (second[1] + third[2]))
    grad_y = k * (w * d02 + x * v01 + z * v12 - 2.0 * y * (first[0] + third[2]))
    grad_z = k * (w * d10 + x * v02 + y * v12 - 2.0 * z * (first[0] + second[1]))
    # the length of a quaternion has no effect: remove the radial part of the gradient
    outward = 0.5 * k * (grad_w * w + grad_x * x + grad_y * y + grad_z * z)
    return grad_w - outward * w, grad_x - outward * x, grad_y - outward * y, grad_z - outward * z


@kernel(inline="always")
def store_gradients(
    rows: Any, count: Any, next_row: Any, buffer: Any, grad_mean: Any, grad_quat: Any, grad_scale: Any, output: Any
) -> Any:
    """Write the gradients of up to eight Gaussians, and zeros for the invisible Gaussians listed before them.

    Args:
        rows: rows as written by `select_rows`.
        count: number of lanes in use.
        next_row: first Gaussian without a written gradient.
        buffer: (80,) scratch in the dtype of the output.
        grad_mean: three lanes.
        grad_quat: four lanes.
        grad_scale: three lanes.
        output: (N, 3), (N, 4) and (N, 3).

    Returns:
        The new `next_row`.
    """
    grad_means, grad_quats, grad_scales = output
    lanes.store(buffer, 0, grad_mean[0])
    lanes.store(buffer, 8, grad_mean[1])
    lanes.store(buffer, 16, grad_mean[2])
    lanes.store(buffer, 24, grad_quat[0])
    lanes.store(buffer, 32, grad_quat[1])
    lanes.store(buffer, 40, grad_quat[2])
    lanes.store(buffer, 48, grad_quat[3])
    lanes.store(buffer, 56, grad_scale[0])
    lanes.store(buffer, 64, grad_scale[1])
    lanes.store(buffer, 72, grad_scale[2])
    for lane in range(min(8, count)):
        row = rows[8 + lane]
        for unseen in range(next_row, row):
            grad_means[unseen, 0], grad_means[unseen, 1], grad_means[unseen, 2] = 0.0, 0.0, 0.0
            grad_quats[unseen, 0], grad_quats[unseen, 1], grad_quats[unseen, 2], grad_quats[unseen, 3] = (
                0.0,
                0.0,
                0.0,
                0.0,
            )
            grad_scales[unseen, 0], grad_scales[unseen, 1], grad_scales[unseen, 2] = 0.0, 0.0, 0.0
        grad_means[row, 0], grad_means[row, 1], grad_means[row, 2] = buffer[lane], buffer[8 + lane], buffer[16 + lane]
        grad_quats[row, 0], grad_quats[row, 1] = buffer[24 + lane], buffer[32 + lane]
        grad_quats[row, 2], grad_quats[row, 3] = buffer[40 + lane], buffer[48 + lane]
        grad_scales[row, 0], grad_scales[row, 1] = buffer[56 + lane], buffer[64 + lane]
        grad_scales[row, 2] = buffer[72 + lane]
        next_row = row + 1
    return next_row


@kernel(inline="always")
def store_viewmat_sums(first: Any, second: Any, third: Any, translation: Any, grad_viewmat: Any) -> None:
    """Write the sums over lanes for a view matrix: nine for the rotation, row by row, and three for the translation."""
    grad_viewmat[0], grad_viewmat[1], grad_viewmat[2] = (
        lanes.sum_lanes(first[0]),
        lanes.sum_lanes(first[1]),
        lanes.sum_lanes(first[2]),
    )
    grad_viewmat[3], grad_viewmat[4] = lanes.sum_lanes(second[0]), lanes.sum_lanes(second[1])
    grad_viewmat[5], grad_viewmat[6] = lanes.sum_lanes(second[2]), lanes.sum_lanes(third[0])
    grad_viewmat[7], grad_viewmat[8] = lanes.sum_lanes(third[1]), lanes.sum_lanes(third[2])
    grad_viewmat[9], grad_viewmat[10] = lanes.sum_lanes(translation[0]), lanes.sum_lanes(translation[1])
    grad_viewmat[11] = lanes.sum_lanes(translation[2])
