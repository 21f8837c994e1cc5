"""Functions that all projections share: early culling, culling of ellipses, and the output records.

Kernels take the Gaussians as flat arrays `(means, quats, scales, opacities)`, and write the visible ones to arrays as
in `RECORD`, which are the tensors of `ProjectedGaussians`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hybridworldsim.kernels import lanes
from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.rasterizer.presets import (
    ALPHA_MIN,
    QUATERNION_MAX,
    QUATERNION_MIN,
    SQUARE_DISCRIMINANT_MIN,
    SQUARE_SIGMAS,
)

RECORD: tuple[tuple[type, tuple[int, ...]], ...] = (
    (np.int64, ()),  # ids
    (np.float32, (2,)),  # means2d
    (np.float32, (2,)),  # means2d_low
    (np.float32, ()),  # depths
    (np.float64, (3,)),  # conics
    (np.float64, (3,)),  # factors
    (np.float32, ()),  # compensations
    (np.int32, (2,)),  # radii
)
"""The output of each Gaussian: dtype and shape.

Conics and factors are float64, because a needle's gradient loses the square of its aspect ratio by cancellation.
"""

CAUSES = ("near", "far", "frustum", "radius", "opacity", "degenerate")
"""Causes of culling. A Gaussian counts for the first cause that applies; the cheapest test comes first."""

FLOAT32_MAX = 1e30
"""Upper bound of stored values, so that float32 can represent them and products with them."""

DETERMINANT_MAX = 1e200
"""Covariances with a larger determinant cannot be inverted in float64."""

RADIUS_MAX = float(2**30)
"""Upper bound of half extents, pixels: they are int32."""

_LN2 = float(np.log(2.0))
_SQUARE_MIN, _SQUARE_MAX = QUATERNION_MIN**2, QUATERNION_MAX**2


@kernel(inline="always")
def rotation(quaternion: Any) -> Any:
    """Compute the three rows of a quaternion's rotation, 2 / its squared norm, and whether the quaternion is valid."""
    w, x, y, z = quaternion
    square = w * w + x * x + y * y + z * z
    k = 2.0 / square
    xx, yy, zz = k * x * x, k * y * y, k * z * z
    xy, xz, yz = k * x * y, k * x * z, k * y * z
    wx, wy, wz = k * w * x, k * w * y, k * w * z
    return (
        (1.0 - (yy + zz), xy - wz, xz + wy),
        (xy + wz, 1.0 - (xx + zz), yz - wx),
        (xz - wy, yz + wx, 1.0 - (xx + yy)),
        k,
        (square >= _SQUARE_MIN) & (square <= _SQUARE_MAX),
    )


@kernel(inline="always")
def to_camera(camera: Any, point: Any) -> Any:
    """Transform a point from the world to the camera frame."""
    x, y, z = point
    return (
        camera.r00 * x + camera.r01 * y + (camera.r02 * z + camera.t0),
        camera.r10 * x + camera.r11 * y + (camera.r12 * z + camera.t1),
        camera.r20 * x + camera.r21 * y + (camera.r22 * z + camera.t2),
    )


@kernel(inline="always")
def row_times_matrix(row: Any, first: Any, second: Any, third: Any) -> Any:
    """Multiply a row vector by a matrix of three rows."""
    return (
        row[0] * first[0] + row[1] * second[0] + row[2] * third[0],
        row[0] * first[1] + row[1] * second[1] + row[2] * third[1],
        row[0] * first[2] + row[1] * second[2] + row[2] * third[2],
    )


@kernel(inline="always")
def dot(a: Any, b: Any) -> Any:
    """Compute the scalar product of two triples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel(inline="always")
def multiply(a: Any, b: Any) -> Any:
    """Multiply two triples element by element."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@kernel(inline="always")
def log(a: Any) -> Any:
    """Compute the natural logarithm of positive normal numbers to 1e-10."""
    m, e = lanes.mantissa(a), lanes.exponent(a)
    above = m > 1.4142135623730951
    m, e = lanes.select(above, 0.5 * m, m), lanes.select(above, e + 1.0, e)
    s = (m - 1.0) / (m + 1.0)
    q = s * s
    series = 1.0 + q * (1 / 3 + q * (1 / 5 + q * (1 / 7 + q * (1 / 9 + q * (1 / 11)))))
    return e * _LN2 + 2.0 * s * series


@kernel(inline="always")
def compute_extent(camera: Any, xx: Any, yy: Any, determinant: Any, opacity: Any) -> Any:
    """Compute half the extent of a blurred covariance in x and y, whole pixels."""
    if camera.square:
        half = 0.5 * (xx + yy)
        longest = half + lanes.sqrt(lanes.max_or_b(half * half - determinant, SQUARE_DISCRIMINANT_MIN))
        both = lanes.ceil(SQUARE_SIGMAS * lanes.sqrt(longest))
        return both, both
    squared = lanes.max_or_b(2.0 * log(opacity * (1.0 / ALPHA_MIN)), 0.0)
    return lanes.ceil(lanes.sqrt(squared * xx)), lanes.ceil(lanes.sqrt(squared * yy))


@kernel()
def find_candidates(camera: Any, gaussians: Any, begin: Any, end: Any, rows: Any, counts: Any) -> Any:
    """Find Gaussians that may reach the image, by bounds that need no rotation; return the number found.

    Args:
        camera: `KernelCamera`.
        gaussians: (3 N,), (4 N,), (3 N,), (N,).
        begin: first Gaussian.
        end: one past the last.
        rows: (end - begin + 8,) output, the indices; spare lanes of the last eight repeat the first of them.
        counts: (6,) numbers of culled Gaussians in the order of `CAUSES`; they are increased.
    """
    means, _, scales, opacities = gaussians
    half_x, half_y = 0.5 * camera.width, 0.5 * camera.height
    found = 0
    near_count, far_count, frustum_count, opacity_count = 0, 0, 0, 0
    for row in range(begin, end, 8):
        for lane in range(8):
            rows[found + lane] = min(row + lane, end - 1)
        lanes_in_use = lanes.first_lanes(end - row)
        x, y, z = to_camera(camera, lanes.load_triples(means, rows, found))
        near_count += lanes.count_set(lanes_in_use & (z < camera.near))
        far_count += lanes.count_set(lanes_in_use & (z > camera.far))
        inside = lanes_in_use & (z >= camera.near) & (z <= camera.far)
        if lanes.to_bits(inside) == 0:
            continue
        s0, s1, s2 = lanes.load_triples(scales, rows, found)
        greatest_scale = lanes.max_or_b(lanes.max_or_b(lanes.abs_(s0), lanes.abs_(s1)), lanes.abs_(s2))
        opacity = lanes.gather(opacities, rows, found, 1, 0)
        if not camera.square:
            opacity_count += lanes.count_set(inside & (opacity < ALPHA_MIN))
            inside = inside & (opacity >= ALPHA_MIN)
        # sqrt(2 ln(255 o)) is less than o sqrt(2 ln 255) where o is more than 1
        reach = lanes.max_or_b(opacity, 1.0)
        greatest_scale, margin = reach * greatest_scale, reach * camera.margin
        off_x = lanes.abs_(camera.fx * x + (camera.cx - half_x) * z) - (half_x + margin) * z
        off_y = lanes.abs_(camera.fy * y + (camera.cy - half_y) * z) - (half_y + margin) * z
        beside = (off_x > camera.reach_x * greatest_scale) | (off_y > camera.reach_y * greatest_scale)
        frustum_count += lanes.count_set(inside & beside)
        inside = inside & (off_x <= camera.reach_x * greatest_scale) & (off_y <= camera.reach_y * greatest_scale)
        kept = lanes.to_bits(inside)
        for lane in range(8):
            rows[found] = row + lane
            found += (kept >> lane) & 1
    counts[0] += near_count
    counts[1] += far_count
    counts[2] += frustum_count
    counts[4] += opacity_count
    for spare in range(found, found + 8):
        rows[spare] = rows[found - found % 8] if found % 8 else begin
    return found


@kernel(inline="always")
def write_records(
    camera: Any,
    rows: Any,
    start: Any,
    valid_lanes: Any,
    mean: Any,
    depth: Any,
    shape: Any,
    opacity: Any,
    written: Any,
    output: Any,
    counts: Any,
) -> Any:
    """Write records of the ellipses, out of eight, that reach the image; return the new number of records.

    Args:
        camera: `KernelCamera`.
        rows: indices of Gaussians.
        start: index of the first of the eight in `rows`.
        valid_lanes: mask of the lanes that are not culled yet.
        mean: x and y, pixels.
        depth: metres.
        shape: xx, xy, yy and determinant of the covariance before the blur, pixel^2.
        opacity: opacity before antialiasing.
        written: number of records in the output.
        output: arrays as in `RECORD`, with 8 spare rows.
        counts: (6,) int64 numbers of culled Gaussians in the order of `CAUSES`; they are increased.
    """
    ids, means2d, means2d_low, depths, conics, factors, compensations, radii = output
    xx, xy, yy, sharp = shape
    determinant = sharp + camera.blur * (xx + yy) + camera.blur * camera.blur
    xx, yy = xx + camera.blur, yy + camera.blur
    compensation = lanes.broadcast(1.0)
    if camera.antialiased:
        compensation = lanes.sqrt(lanes.max_or_b(sharp / determinant, camera.ratio_min))
        opacity = opacity * compensation
    radius_x, radius_y = compute_extent(camera, xx, yy, determinant, opacity)

    sound = valid_lanes & (determinant > 0.0) & (determinant < DETERMINANT_MAX) & (xx + yy < FLOAT32_MAX * determinant)
    sound = sound & (lanes.abs_(mean[0]) < FLOAT32_MAX) & (lanes.abs_(mean[1]) < FLOAT32_MAX)
    opaque = sound
    if not camera.square:
        opaque = sound & (opacity >= ALPHA_MIN)
    large = opaque & ((radius_x > camera.clip) | (radius_y > camera.clip))
    inside = large & (mean[0] + radius_x > 0.0) & (mean[0] - radius_x < camera.width)
    inside = inside & (mean[1] + radius_y > 0.0) & (mean[1] - radius_y < camera.height)
    counts[2] += lanes.count_set(large) - lanes.count_set(inside)
    counts[3] += lanes.count_set(opaque) - lanes.count_set(large)
    counts[4] += lanes.count_set(sound) - lanes.count_set(opaque)
    counts[5] += lanes.count_set(valid_lanes) - lanes.count_set(sound)
    kept = lanes.to_bits(inside)
    if kept == 0:
        return written

    # the form as (f11 dx + f12 dy)^2 + (f22 dy)^2: the square is completed in x
    inverse_root = 1.0 / lanes.sqrt(yy * determinant)
    inverse = inverse_root * inverse_root * yy
    lanes.store_pairs(means2d, written, mean[0], mean[1])
    lanes.store_pairs(
        means2d_low, written, mean[0] - lanes.round_to_float32(mean[0]), mean[1] - lanes.round_to_float32(mean[1])
    )
    lanes.store(depths, written, depth)
    lanes.store_triples(conics, written, yy * inverse, 0.0 - xy * inverse, xx * inverse)
    lanes.store_triples(
        factors, written, yy * inverse_root, 0.0 - xy * inverse_root, lanes.sqrt(determinant) * inverse_root
    )
    lanes.store(compensations, written, compensation)
    lanes.store_pairs(radii, written, lanes.min_or_b(radius_x, RADIUS_MAX), lanes.min_or_b(radius_y, RADIUS_MAX))
    for lane in range(8):
        ids[written + lane] = rows[start + lane]
    if kept == 255:
        return written + 8
    begin = written
    for lane in range(begin, begin + 8):
        ids[written] = ids[lane]
        means2d[written, 0], means2d[written, 1] = means2d[lane, 0], means2d[lane, 1]
        means2d_low[written, 0], means2d_low[written, 1] = means2d_low[lane, 0], means2d_low[lane, 1]
        depths[written] = depths[lane]
        conics[written, 0], conics[written, 1], conics[written, 2] = conics[lane, 0], conics[lane, 1], conics[lane, 2]
        factors[written, 0], factors[written, 1], factors[written, 2] = (
            factors[lane, 0],
            factors[lane, 1],
            factors[lane, 2],
        )
        compensations[written] = compensations[lane]
        radii[written, 0], radii[written, 1] = radii[lane, 0], radii[lane, 1]
        written += (kept >> (lane - begin)) & 1
    return written
