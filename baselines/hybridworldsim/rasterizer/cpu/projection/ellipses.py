"""What all projections share: which Gaussians may be seen at all, which ellipses reach the picture, and their record.

Kernels take the Gaussians as `(means, quats, scales, opacities)`, flat, and give what they see as the tensors of
`Projected`, `RECORD`.
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
"""What is written of each Gaussian: dtype and shape.

The shape of an ellipse stays float64: a needle's gradient cancels in its conic by the square of its aspect ratio.
"""

CAUSES = ("near", "far", "frustum", "radius", "opacity", "degenerate")
"""Why a Gaussian is culled; it counts for the first that is found, the cheapest is tried first."""

FLOAT32_MAX = 1e30
"""What is stored stays below, so that float32 holds it, and products with it."""

DETERMINANT_MAX = 1e200
"""Covariances beyond cannot be inverted in float64."""

RADIUS_MAX = float(2**30)
"""Half extents saturate here, pixels: they are int32."""

_LN2 = float(np.log(2.0))
_SQUARE_MIN, _SQUARE_MAX = QUATERNION_MIN**2, QUATERNION_MAX**2


@kernel(inline="always")
def rotation(quaternion: Any) -> Any:
    """The three rows of a quaternion's rotation, 2 / its squared norm, and whether it is a rotation at all."""
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
def to_camera(view: Any, point: Any) -> Any:
    """A point of the world in the camera's frame."""
    x, y, z = point
    return (
        view.r00 * x + view.r01 * y + (view.r02 * z + view.t0),
        view.r10 * x + view.r11 * y + (view.r12 * z + view.t1),
        view.r20 * x + view.r21 * y + (view.r22 * z + view.t2),
    )


@kernel(inline="always")
def along(row: Any, first: Any, second: Any, third: Any) -> Any:
    """A row vector times the matrix of three rows."""
    return (
        row[0] * first[0] + row[1] * second[0] + row[2] * third[0],
        row[0] * first[1] + row[1] * second[1] + row[2] * third[1],
        row[0] * first[2] + row[1] * second[2] + row[2] * third[2],
    )


@kernel(inline="always")
def dot(a: Any, b: Any) -> Any:
    """Scalar product of two triples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel(inline="always")
def times(a: Any, b: Any) -> Any:
    """Product of two triples, element by element."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@kernel(inline="always")
def logarithm(a: Any) -> Any:
    """Natural, of a positive ordinary number, to 1e-10."""
    m, e = lanes.mantissa(a), lanes.exponent(a)
    above = m > 1.4142135623730951
    m, e = lanes.choose(above, 0.5 * m, m), lanes.choose(above, e + 1.0, e)
    s = (m - 1.0) / (m + 1.0)
    q = s * s
    series = 1.0 + q * (1 / 3 + q * (1 / 5 + q * (1 / 7 + q * (1 / 9 + q * (1 / 11)))))
    return e * _LN2 + 2.0 * s * series


@kernel(inline="always")
def extent(view: Any, xx: Any, yy: Any, determinant: Any, opacity: Any) -> Any:
    """Half the extent of a blurred covariance in x and y, whole pixels."""
    if view.square:
        half = 0.5 * (xx + yy)
        longest = half + lanes.root(lanes.greater(half * half - determinant, SQUARE_DISCRIMINANT_MIN))
        both = lanes.whole_above(SQUARE_SIGMAS * lanes.root(longest))
        return both, both
    squared = lanes.greater(2.0 * logarithm(opacity * (1.0 / ALPHA_MIN)), 0.0)
    return lanes.whole_above(lanes.root(squared * xx)), lanes.whole_above(lanes.root(squared * yy))


@kernel()
def candidates(view: Any, gaussians: Any, begin: Any, end: Any, rows: Any, counts: Any) -> Any:
    """Find Gaussians that may reach the picture, by bounds that need no rotation; return how many.

    Args:
        view: `View`.
        gaussians: (3 N,), (4 N,), (3 N,), (N,).
        begin: first Gaussian.
        end: past the last.
        rows: (end - begin + 8,) gets their indices; spare lanes of the last eight repeat their first.
        counts: (6,) gets how many were culled, by the order of `CAUSES`.
    """
    means, _, scales, opacities = gaussians
    half_x, half_y = 0.5 * view.width, 0.5 * view.height
    found = 0
    near_count, far_count, frustum_count, opacity_count = 0, 0, 0, 0
    for row in range(begin, end, 8):
        for lane in range(8):
            rows[found + lane] = min(row + lane, end - 1)
        left = lanes.first_lanes(end - row)
        x, y, z = to_camera(view, lanes.triples(means, rows, found))
        near_count += lanes.how_many(left & (z < view.near))
        far_count += lanes.how_many(left & (z > view.far))
        inside = left & (z >= view.near) & (z <= view.far)
        if lanes.bits(inside) == 0:
            continue
        s0, s1, s2 = lanes.triples(scales, rows, found)
        size = lanes.greater(lanes.greater(lanes.magnitude(s0), lanes.magnitude(s1)), lanes.magnitude(s2))
        opacity = lanes.gather(opacities, rows, found, 1, 0)
        if not view.square:
            opacity_count += lanes.how_many(inside & (opacity < ALPHA_MIN))
            inside = inside & (opacity >= ALPHA_MIN)
        # sqrt(2 ln(255 o)) is less than o sqrt(2 ln 255) where o is more than 1
        reach = lanes.greater(opacity, 1.0)
        size, margin = reach * size, reach * view.margin
        off_x = lanes.magnitude(view.fx * x + (view.cx - half_x) * z) - (half_x + margin) * z
        off_y = lanes.magnitude(view.fy * y + (view.cy - half_y) * z) - (half_y + margin) * z
        beside = (off_x > view.reach_x * size) | (off_y > view.reach_y * size)
        frustum_count += lanes.how_many(inside & beside)
        inside = inside & (off_x <= view.reach_x * size) & (off_y <= view.reach_y * size)
        kept = lanes.bits(inside)
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
def record(
    view: Any,
    rows: Any,
    start: Any,
    shown: Any,
    mean: Any,
    depth: Any,
    shape: Any,
    opacity: Any,
    seen: Any,
    output: Any,
    counts: Any,
) -> Any:
    """Write those of eight ellipses that reach the picture; return how many there are in all.

    Args:
        view: `View`.
        rows: indices of Gaussians.
        start: first of the eight in `rows`.
        shown: mask of those that are left to be judged.
        mean: x and y, pixels.
        depth: metres.
        shape: xx, xy, yy and determinant of the covariance before the blur, pixel^2.
        opacity: before antialiasing.
        seen: how many are in the output.
        output: arrays as in `RECORD`; 8 rows longer than what they get.
        counts: (6,) int64, is increased by how many are culled, by the order of `CAUSES`.
    """
    ids, means2d, means2d_low, depths, conics, factors, compensations, radii = output
    xx, xy, yy, sharp = shape
    determinant = sharp + view.blur * (xx + yy) + view.blur * view.blur
    xx, yy = xx + view.blur, yy + view.blur
    compensation = lanes.spread(1.0)
    if view.antialiased:
        compensation = lanes.root(lanes.greater(sharp / determinant, view.ratio_min))
        opacity = opacity * compensation
    radius_x, radius_y = extent(view, xx, yy, determinant, opacity)

    sound = shown & (determinant > 0.0) & (determinant < DETERMINANT_MAX) & (xx + yy < FLOAT32_MAX * determinant)
    sound = sound & (lanes.magnitude(mean[0]) < FLOAT32_MAX) & (lanes.magnitude(mean[1]) < FLOAT32_MAX)
    opaque = sound
    if not view.square:
        opaque = sound & (opacity >= ALPHA_MIN)
    large = opaque & ((radius_x > view.clip) | (radius_y > view.clip))
    inside = large & (mean[0] + radius_x > 0.0) & (mean[0] - radius_x < view.width)
    inside = inside & (mean[1] + radius_y > 0.0) & (mean[1] - radius_y < view.height)
    counts[2] += lanes.how_many(large) - lanes.how_many(inside)
    counts[3] += lanes.how_many(opaque) - lanes.how_many(large)
    counts[4] += lanes.how_many(sound) - lanes.how_many(opaque)
    counts[5] += lanes.how_many(shown) - lanes.how_many(sound)
    kept = lanes.bits(inside)
    if kept == 0:
        return seen

    # (f11 dx + f12 dy)^2 + (f22 dy)^2, the square completed in x
    scale = 1.0 / lanes.root(yy * determinant)
    inverse = scale * scale * yy
    lanes.put_pairs(means2d, seen, mean[0], mean[1])
    lanes.put_pairs(means2d_low, seen, mean[0] - lanes.rounded(mean[0]), mean[1] - lanes.rounded(mean[1]))
    lanes.put(depths, seen, depth)
    lanes.put_triples(conics, seen, yy * inverse, 0.0 - xy * inverse, xx * inverse)
    lanes.put_triples(factors, seen, yy * scale, 0.0 - xy * scale, lanes.root(determinant) * scale)
    lanes.put(compensations, seen, compensation)
    lanes.put_pairs(radii, seen, lanes.lesser(radius_x, RADIUS_MAX), lanes.lesser(radius_y, RADIUS_MAX))
    for lane in range(8):
        ids[seen + lane] = rows[start + lane]
    if kept == 255:
        return seen + 8
    begin = seen
    for lane in range(begin, begin + 8):
        ids[seen] = ids[lane]
        means2d[seen, 0], means2d[seen, 1] = means2d[lane, 0], means2d[lane, 1]
        means2d_low[seen, 0], means2d_low[seen, 1] = means2d_low[lane, 0], means2d_low[lane, 1]
        depths[seen] = depths[lane]
        conics[seen, 0], conics[seen, 1], conics[seen, 2] = conics[lane, 0], conics[lane, 1], conics[lane, 2]
        factors[seen, 0], factors[seen, 1], factors[seen, 2] = factors[lane, 0], factors[lane, 1], factors[lane, 2]
        compensations[seen] = compensations[lane]
        radii[seen, 0], radii[seen, 1] = radii[lane, 0], radii[lane, 1]
        seen += (kept >> (lane - begin)) & 1
    return seen
