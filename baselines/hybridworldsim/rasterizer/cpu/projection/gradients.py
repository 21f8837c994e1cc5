"""Functions that the gradients of all projections share: from output records to Gaussians.

Kernels take the gradients to the records as flat arrays `(means2d, depths, conics, compensations)`, and the strides of
these four arrays. An output without a gradient has an array of three zeros with stride 0.
"""

from __future__ import annotations

from typing import Any

from hybridworldsim.kernels import lanes
from hybridworldsim.kernels.compilation import kernel

_RATIO_MIN = 1e-290  # ratio of the determinants below which the slope of the square root overflows


@kernel(inline="always")
def scale(factor: Any, triple: Any) -> Any:
    """Multiply a triple by a number."""
    return factor * triple[0], factor * triple[1], factor * triple[2]


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
    """Write the next eight indices in `ids`, then their Gaussians, to `rows`; spare lanes repeat the first."""
    for lane in range(8):
        rows[lane] = start + lane if start + lane < end else start
        rows[8 + lane] = ids[rows[lane]]


@kernel(inline="always")
def load_upstream(upstream: Any, strides: Any, rows: Any, lanes_in_use: Any) -> Any:
    """Load gradients to mean (x, y), depth, conic (xx, xy, yy) and compensation; zero for spare lanes."""
    to_means2d, to_depths, to_conics, to_compensations = upstream
    by_mean, by_depth, by_conic, by_compensation = strides
    return (
        (
            lanes.select(lanes_in_use, lanes.gather(to_means2d, rows, 0, by_mean, 0), 0.0),
            lanes.select(lanes_in_use, lanes.gather(to_means2d, rows, 0, by_mean, 1), 0.0),
        ),
        lanes.select(lanes_in_use, lanes.gather(to_depths, rows, 0, by_depth, 0), 0.0),
        (
            lanes.select(lanes_in_use, lanes.gather(to_conics, rows, 0, by_conic, 0), 0.0),
            lanes.select(lanes_in_use, lanes.gather(to_conics, rows, 0, by_conic, 1), 0.0),
            lanes.select(lanes_in_use, lanes.gather(to_conics, rows, 0, by_conic, 2), 0.0),
        ),
        lanes.select(lanes_in_use, lanes.gather(to_compensations, rows, 0, by_compensation, 0), 0.0),
    )


@kernel(inline="always")
def covariance_gradient(camera: Any, shape: Any, to_conic: Any, to_compensation: Any) -> Any:
    """Compute the gradient to xx, xy and yy of the 2D covariance (xy as one of two equal entries).

    Args:
        camera: `KernelCamera`.
        shape: xx, xy, yy and determinant of the covariance before the blur.
        to_conic: gradients to the three entries of the conic.
        to_compensation: gradient to the compensation.
    """
    xx, xy, yy, sharp = shape
    blurred_x, blurred_y = xx + camera.blur, yy + camera.blur
    inverse = 1.0 / (sharp + camera.blur * (xx + yy) + camera.blur * camera.blur)
    p, q, r = blurred_y * inverse, 0.0 - xy * inverse, blurred_x * inverse
    half = 0.5 * to_conic[1]
    t00, t01 = p * to_conic[0] + q * half, p * half + q * to_conic[2]
    t10, t11 = q * to_conic[0] + r * half, q * half + r * to_conic[2]
    to_xx, to_xy, to_yy = 0.0 - (t00 * p + t01 * q), 0.0 - (t00 * q + t01 * r), 0.0 - (t10 * q + t11 * r)
    if camera.antialiased:
        ratio = sharp * inverse
        free = (ratio > camera.ratio_min) & (ratio > _RATIO_MIN)
        to_ratio = lanes.select(free, 0.5 * to_compensation / lanes.sqrt(ratio), 0.0) * inverse
        to_xx = to_xx + to_ratio * (yy - ratio * blurred_y)
        to_xy = to_xy + to_ratio * (ratio - 1.0) * xy
        to_yy = to_yy + to_ratio * (xx - ratio * blurred_x)
    return to_xx, to_xy, to_yy


@kernel(inline="always")
def quaternion_gradient(quaternion: Any, k: Any, first: Any, second: Any, third: Any) -> Any:
    """Compute the gradient to a quaternion from the gradient to the rows of its rotation; k is 2 / squared norm."""
    w, x, y, z = quaternion
    v01, v02, v12 = second[0] + first[1], first[2] + third[0], second[2] + third[1]
    d21, d02, d10 = third[1] - second[2], first[2] - third[0], second[0] - first[1]
    to_w = k * (x * d21 + y * d02 + z * d10)
    to_x = k * (w * d21 + y * v01 + z * v02 - 2.0 * x * (second[1] + third[2]))
    to_y = k * (w * d02 + x * v01 + z * v12 - 2.0 * y * (first[0] + third[2]))
    to_z = k * (w * d10 + x * v02 + y * v12 - 2.0 * z * (first[0] + second[1]))
    # the length of a quaternion has no effect: remove the radial part of the gradient
    outward = 0.5 * k * (to_w * w + to_x * x + to_y * y + to_z * z)
    return to_w - outward * w, to_x - outward * x, to_y - outward * y, to_z - outward * z


@kernel(inline="always")
def store_gradients(
    rows: Any, count: Any, next_row: Any, buffer: Any, to_mean: Any, to_quat: Any, to_scale: Any, output: Any
) -> Any:
    """Write the gradients of up to eight Gaussians, and zeros for the invisible Gaussians in front of them.

    Args:
        rows: rows as written by `select_rows`.
        count: number of lanes in use.
        next_row: first Gaussian without a written gradient.
        buffer: (80,) scratch in the dtype of the output.
        to_mean: three lanes.
        to_quat: four lanes.
        to_scale: three lanes.
        output: (N, 3), (N, 4) and (N, 3).

    Returns:
        The new `next_row`.
    """
    to_means, to_quats, to_scales = output
    lanes.store(buffer, 0, to_mean[0])
    lanes.store(buffer, 8, to_mean[1])
    lanes.store(buffer, 16, to_mean[2])
    lanes.store(buffer, 24, to_quat[0])
    lanes.store(buffer, 32, to_quat[1])
    lanes.store(buffer, 40, to_quat[2])
    lanes.store(buffer, 48, to_quat[3])
    lanes.store(buffer, 56, to_scale[0])
    lanes.store(buffer, 64, to_scale[1])
    lanes.store(buffer, 72, to_scale[2])
    for lane in range(min(8, count)):
        row = rows[8 + lane]
        for unseen in range(next_row, row):
            to_means[unseen, 0], to_means[unseen, 1], to_means[unseen, 2] = 0.0, 0.0, 0.0
            to_quats[unseen, 0], to_quats[unseen, 1], to_quats[unseen, 2], to_quats[unseen, 3] = 0.0, 0.0, 0.0, 0.0
            to_scales[unseen, 0], to_scales[unseen, 1], to_scales[unseen, 2] = 0.0, 0.0, 0.0
        to_means[row, 0], to_means[row, 1], to_means[row, 2] = buffer[lane], buffer[8 + lane], buffer[16 + lane]
        to_quats[row, 0], to_quats[row, 1] = buffer[24 + lane], buffer[32 + lane]
        to_quats[row, 2], to_quats[row, 3] = buffer[40 + lane], buffer[48 + lane]
        to_scales[row, 0], to_scales[row, 1] = buffer[56 + lane], buffer[64 + lane]
        to_scales[row, 2] = buffer[72 + lane]
        next_row = row + 1
    return next_row


@kernel(inline="always")
def store_viewmat_sums(first: Any, second: Any, third: Any, translation: Any, to_viewmat: Any) -> None:
    """Write the sums over lanes for a view matrix: nine for the rotation, row by row, and three for the translation."""
    to_viewmat[0], to_viewmat[1], to_viewmat[2] = (
        lanes.sum_lanes(first[0]),
        lanes.sum_lanes(first[1]),
        lanes.sum_lanes(first[2]),
    )
    to_viewmat[3], to_viewmat[4] = lanes.sum_lanes(second[0]), lanes.sum_lanes(second[1])
    to_viewmat[5], to_viewmat[6] = lanes.sum_lanes(second[2]), lanes.sum_lanes(third[0])
    to_viewmat[7], to_viewmat[8] = lanes.sum_lanes(third[1]), lanes.sum_lanes(third[2])
    to_viewmat[9], to_viewmat[10] = lanes.sum_lanes(translation[0]), lanes.sum_lanes(translation[1])
    to_viewmat[11] = lanes.sum_lanes(translation[2])
