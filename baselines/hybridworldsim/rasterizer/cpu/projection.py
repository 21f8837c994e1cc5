"""Project Gaussians into one pinhole camera by EWA splatting, eight at a time, and keep those that reach the picture.

Everything is float64 until it is stored. The covariance never forms in three dimensions: its square root, the axes
times the scales, is projected, so that the 2D determinant is a sum of squares (Cauchy-Binet) and a needle keeps its
width. Conventions are gsplat's (`ProjectionEWA3DGSFused.cu`, `Utils.cuh`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hybridworldsim.rasterizer.cpu import lanes
from hybridworldsim.rasterizer.cpu.kernels import kernel
from hybridworldsim.rasterizer.presets import ALPHA_MIN, SQUARE_DISCRIMINANT_MIN, SQUARE_SIGMAS, Preset

NORM2_MIN = 1e-60
"""Squared norm under which a quaternion is no rotation."""

FLOAT32_MAX = 1e30
"""What is stored stays below, so that float32 holds it, and products with it."""

DETERMINANT_MAX = 1e200
"""Covariances beyond cannot be inverted in float64."""

RADIUS_MAX = float(2**30)
"""Half extents saturate here, pixels: they are int32."""

_SIGMAS = 3.33  # an opaque Gaussian is below ALPHA_MIN there

_LN2 = float(np.log(2.0))
CAUSES = ("near", "far", "frustum", "radius", "opacity", "degenerate")


class View(NamedTuple):
    """One camera and the limits under which it sees a Gaussian; numbers that kernels take as they are.

    Attributes:
        antialiased: whether opacities shrink by the compensation.
        square: whether the extent is the square of three sigmas.
        r00: to `r22`, rotation of the view matrix; `t0` to `t2` its translation, metres.
        fx: `fy`, `cx`, `cy`: the pinhole, pixels.
        left: `right`, `top`, `bottom`: bounds of x/z and y/z in the Jacobian.
        near: `far`: depths between which Gaussians are kept, metres.
        blur: added to both variances, pixel^2.
        clip: Gaussians whose radii are no larger are dropped, pixels.
        reach_x: the radius of a Gaussian of opacity 1 is less than `reach_x` * greatest scale / depth + `margin`.
        ratio_min: floor of the squared compensation.
    """

    antialiased: bool
    square: bool
    r00: float
    r01: float
    r02: float
    r10: float
    r11: float
    r12: float
    r20: float
    r21: float
    r22: float
    t0: float
    t1: float
    t2: float
    fx: float
    fy: float
    cx: float
    cy: float
    left: float
    right: float
    top: float
    bottom: float
    width: float
    height: float
    near: float
    far: float
    blur: float
    clip: float
    reach_x: float
    reach_y: float
    margin: float
    ratio_min: float


def view_of(
    viewmat: np.ndarray[Any, np.dtype[np.float64]],
    K: np.ndarray[Any, np.dtype[np.float64]],
    width: int,
    height: int,
    *,
    eps2d: float,
    near_plane: float,
    far_plane: float,
    radius_clip: float,
    preset: Preset,
    antialiased: bool,
) -> View:
    """Gather what kernels need of a camera.

    Args:
        viewmat: (4, 4), world to camera.
        K: (3, 3) intrinsic matrix, pixels.
        width: of the picture, pixels.
        height: of the picture, pixels.
        eps2d: added to both variances, pixel^2.
        near_plane: least depth, metres; what is on or behind the camera plane is never kept.
        far_plane: greatest depth, metres.
        radius_clip: Gaussians whose radii are no larger are dropped, pixels.
        preset: gsplat's generation.
        antialiased: whether opacities shrink by the compensation.
    """
    fx, fy, cx, cy = float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])
    beside_x, beside_y = 0.15 * width / fx, 0.15 * height / fy
    right, left = (width - cx) / fx + beside_x, -cx / fx - beside_x
    bottom, top = (height - cy) / fy + beside_y, -cy / fy - beside_y
    stretch = float(np.linalg.norm(viewmat[:3, :3], 2)) * (1.0 + 1e-9)
    reach_x = stretch * abs(fx) * float(np.hypot(1.0, max(abs(left), abs(right))))
    reach_y = stretch * abs(fy) * float(np.hypot(1.0, max(abs(top), abs(bottom))))
    square = preset.extent == "square"
    if square:
        reach = SQUARE_SIGMAS * float(np.hypot(reach_x, reach_y))
        reaches = (reach, reach, SQUARE_SIGMAS * (2.0 * eps2d + SQUARE_DISCRIMINANT_MIN**0.5) ** 0.5 + 1.0)
    else:
        reaches = (_SIGMAS * reach_x, _SIGMAS * reach_y, _SIGMAS * eps2d**0.5 + 1.0)
    numbers = [
        *viewmat[:3, :3].ravel(),
        *viewmat[:3, 3],
        *(fx, fy, cx, cy, left, right, top, bottom, width, height),
        *(max(near_plane, 1e-30), far_plane, eps2d, radius_clip),
        *(*reaches, preset.compensation_min**2),
    ]
    return View(antialiased, square, *map(float, numbers))


@kernel(inline="always")
def rotation(quaternion: Any) -> Any:
    """The three rows of a quaternion's rotation, and 2 / its squared norm; any norm but 0."""
    w, x, y, z = quaternion
    k = 2.0 / (w * w + x * x + y * y + z * z)
    xx, yy, zz = k * x * x, k * y * y, k * z * z
    xy, xz, yz = k * x * y, k * x * z, k * y * z
    wx, wy, wz = k * w * x, k * w * y, k * w * z
    return (
        (1.0 - (yy + zz), xy - wz, xz + wy),
        (xy + wz, 1.0 - (xx + zz), yz - wx),
        (xz - wy, yz + wx, 1.0 - (xx + yy)),
        k,
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
def jacobian(view: Any, u: Any, v: Any, inverse_depth: Any) -> Any:
    """Of pixels by world coordinates: its two rows, and the clamped u = x/z, v = y/z that they were taken at."""
    u = lanes.lesser(lanes.greater(u, view.left), view.right)
    v = lanes.lesser(lanes.greater(v, view.top), view.bottom)
    a, b = view.fx * inverse_depth, view.fy * inverse_depth
    return (
        (a * (view.r00 - u * view.r20), a * (view.r01 - u * view.r21), a * (view.r02 - u * view.r22)),
        (b * (view.r10 - v * view.r20), b * (view.r11 - v * view.r21), b * (view.r12 - v * view.r22)),
        u,
        v,
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
def covariance(a: Any, b: Any) -> Any:
    """xx, xy, yy and determinant of the 2D covariance whose root has the rows a and b."""
    m0 = a[1] * b[2] - a[2] * b[1]
    m1 = a[2] * b[0] - a[0] * b[2]
    m2 = a[0] * b[1] - a[1] * b[0]
    return dot(a, a), dot(a, b), dot(b, b), m0 * m0 + m1 * m1 + m2 * m2


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
def candidates(view: Any, means: Any, scales: Any, opacities: Any, begin: Any, end: Any, rows: Any, counts: Any) -> Any:
    """Find Gaussians that may reach the picture, by bounds that need no rotation; return how many.

    Args:
        view: `View`.
        means: (3 N,) flat.
        scales: (3 N,) flat.
        opacities: (N,).
        begin: first Gaussian.
        end: past the last.
        rows: gets their indices; 8 longer than end - begin.
        counts: (6,) gets how many were culled, by the order of `CAUSES`.
    """
    half_x, half_y = 0.5 * view.width, 0.5 * view.height
    found = 0
    near_count, far_count, frustum_count, opacity_count = 0, 0, 0, 0
    for row in range(begin, end, 8):
        for lane in range(8):
            rows[found + lane] = min(row + lane, end - 1)
        left = lanes.first_lanes(end - row)
        x, y, z = to_camera(view, lanes.triples(means, rows, found))
        s0, s1, s2 = lanes.triples(scales, rows, found)
        size = lanes.greater(lanes.greater(lanes.magnitude(s0), lanes.magnitude(s1)), lanes.magnitude(s2))
        opacity = lanes.gather(opacities, rows, found, 1, 0)
        near_count += lanes.how_many(left & (z < view.near))
        far_count += lanes.how_many(left & (z > view.far))
        inside = left & (z >= view.near) & (z <= view.far)
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
    return found


@kernel()
def project_part(
    view: Any,
    means: Any,
    quats: Any,
    scales: Any,
    opacities: Any,
    begin: Any,
    end: Any,
    rows: Any,
    ids: Any,
    means2d: Any,
    means2d_low: Any,
    depths: Any,
    conics: Any,
    factors: Any,
    compensations: Any,
    radii: Any,
    counts: Any,
) -> Any:
    """Project Gaussians of a range and write those that the camera sees, in order; return how many.

    Args:
        view: `View`.
        means: (3 N,) flat.
        quats: (4 N,) flat.
        scales: (3 N,) flat.
        opacities: (N,).
        begin: first Gaussian.
        end: past the last.
        rows: (end - begin + 8,) int64, for its own use.
        ids: and all that follow, as in `Projected`; 8 longer than end - begin.
        means2d: likewise.
        means2d_low: likewise.
        depths: likewise.
        conics: likewise.
        factors: likewise.
        compensations: likewise.
        radii: likewise.
        counts: (6,) int64, is increased by how many were culled, by the order of `CAUSES`.
    """
    found = candidates(view, means, scales, opacities, begin, end, rows, counts)
    for spare in range(found, found + 8):
        rows[spare] = rows[found - found % 8] if found % 8 else begin
    seen = 0
    frustum_count, radius_count, opacity_count, degenerate_count = 0, 0, 0, 0
    for start in range(0, found, 8):
        left = lanes.first_lanes(found - start)
        x, y, z = to_camera(view, lanes.triples(means, rows, start))
        first, second, third, k = rotation(lanes.quadruples(quats, rows, start))
        inverse_depth = 1.0 / z
        u, v = x * inverse_depth, y * inverse_depth
        over_x, over_y, _, _ = jacobian(view, u, v, inverse_depth)
        a, b = along(over_x, first, second, third), along(over_y, first, second, third)
        size = lanes.triples(scales, rows, start)
        xx, xy, yy, sharp = covariance(times(a, size), times(b, size))
        determinant = sharp + view.blur * (xx + yy) + view.blur * view.blur
        xx, yy = xx + view.blur, yy + view.blur
        mean_x, mean_y = view.fx * u + view.cx, view.fy * v + view.cy

        opacity = lanes.gather(opacities, rows, start, 1, 0)
        compensation = lanes.spread(1.0)
        if view.antialiased:
            compensation = lanes.root(lanes.greater(sharp / determinant, view.ratio_min))
            opacity = opacity * compensation
        radius_x, radius_y = extent(view, xx, yy, determinant, opacity)

        sound = left & (k < 2.0 / NORM2_MIN) & (determinant > 0.0) & (determinant < DETERMINANT_MAX)
        sound = sound & (xx + yy < FLOAT32_MAX * determinant)
        sound = sound & (lanes.magnitude(mean_x) < FLOAT32_MAX) & (lanes.magnitude(mean_y) < FLOAT32_MAX)
        degenerate_count += lanes.how_many(left) - lanes.how_many(sound)
        if view.square:
            opaque = sound
        else:
            opaque = sound & (opacity >= ALPHA_MIN)
            opacity_count += lanes.how_many(sound) - lanes.how_many(opaque)
        large = opaque & ((radius_x > view.clip) | (radius_y > view.clip))
        radius_count += lanes.how_many(opaque) - lanes.how_many(large)
        inside = large & (mean_x + radius_x > 0.0) & (mean_x - radius_x < view.width)
        inside = inside & (mean_y + radius_y > 0.0) & (mean_y - radius_y < view.height)
        frustum_count += lanes.how_many(large) - lanes.how_many(inside)
        kept = lanes.bits(inside)
        if kept == 0:
            continue

        # (f11 dx + f12 dy)^2 + (f22 dy)^2, the square completed in x
        scale = 1.0 / lanes.root(yy * determinant)
        inverse = scale * scale * yy
        lanes.put_pairs(means2d, seen, mean_x, mean_y)
        lanes.put_pairs(means2d_low, seen, mean_x - lanes.rounded(mean_x), mean_y - lanes.rounded(mean_y))
        lanes.put(depths, seen, z)
        lanes.put_triples(conics, seen, yy * inverse, 0.0 - xy * inverse, xx * inverse)
        lanes.put_triples(factors, seen, yy * scale, 0.0 - xy * scale, lanes.root(determinant) * scale)
        lanes.put(compensations, seen, compensation)
        lanes.put_pairs(radii, seen, lanes.lesser(radius_x, RADIUS_MAX), lanes.lesser(radius_y, RADIUS_MAX))
        for lane in range(8):
            ids[seen + lane] = rows[start + lane]
        if kept == 255:
            seen += 8
            continue
        first_row = seen
        for lane in range(first_row, first_row + 8):
            ids[seen] = ids[lane]
            means2d[seen, 0], means2d[seen, 1] = means2d[lane, 0], means2d[lane, 1]
            means2d_low[seen, 0], means2d_low[seen, 1] = means2d_low[lane, 0], means2d_low[lane, 1]
            depths[seen] = depths[lane]
            conics[seen, 0], conics[seen, 1], conics[seen, 2] = conics[lane, 0], conics[lane, 1], conics[lane, 2]
            factors[seen, 0], factors[seen, 1], factors[seen, 2] = factors[lane, 0], factors[lane, 1], factors[lane, 2]
            compensations[seen] = compensations[lane]
            radii[seen, 0], radii[seen, 1] = radii[lane, 0], radii[lane, 1]
            seen += (kept >> (lane - first_row)) & 1
    counts[2] += frustum_count
    counts[3] += radius_count
    counts[4] += opacity_count
    counts[5] += degenerate_count
    return seen
