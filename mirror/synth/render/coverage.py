"""Computes the surfaces in each pixel and their shares: nine rays per pixel, tile by tile, in vectorised loops."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Float32, Float64, Int32, Int64, Records, UInt8
from mirror.compiled import inner_per_pixel
from mirror.portable import scalars
from mirror.synth.model.surfaces import MOST_CORNERS
from mirror.synth.render.binning import fill_ray_tests
from mirror.synth.render.lens import TILE_PX

SKY: Final = -1
_AREA: Final = TILE_PX * TILE_PX
_HIDDEN: Final = np.float32(1.0001)
"""A surface is hidden in a tile if its least distance exceeds those of all hits by this factor."""
_HIDDEN_BY_RAYS: Final = np.float32(1.005)
"""The same for some pixels of a tile: the factor covers the rounding of an ellipsoid's distance."""
_ROUNDING: Final = 4e-6
"""Square of the angle, radians, by which rounding to float32 widens the smallest ellipsoids."""
_MARGIN: Final = 1e-4
"""Angle, radians, by which rounding to float32 widens a surface at most."""
_INEXACT: Final = 2e-6
"""Bound of the rounding to float32 in a dot product of a ray and a unit vector."""

_TURN: Final = scalars.atan(0.5)
OFFSETS: Final = np.array(
    [(0.0, 0.0)]
    + [
        (
            scalars.cos(_TURN) * i / 3.0 - scalars.sin(_TURN) * j / 3.0,
            scalars.sin(_TURN) * i / 3.0 + scalars.cos(_TURN) * j / 3.0,
        )
        for i in (-1, 0, 1)
        for j in (-1, 0, 1)
        if i or j
    ],
    np.float32,
)
"""Rays of a pixel: the first passes through its centre and gives the ground truth, the others form a rotated grid."""


@njit(cache=True, nogil=True, error_model="numpy")
def compute_coverage(
    faces: Records,
    corners: Float64,
    rounds: Records,
    rays: Float64,
    rotation: Float64,
    x: float,
    y: float,
    z: float,
    offsets: Float32,
    cones: Float64,
    begins: Int64,
    lists: Int32,
    order: Int64,
    nearest: Float32,
    aims: Float64,
    starts: Int64,
    rows: Float32,
    filled: UInt8,
    mask: Float32,
) -> tuple[Int32, UInt8, Int32, Float32, Int64]:
    """Compute the surfaces of each pixel: one surface, or fragments of several.

    Args:
        faces: (F,) FACE, flat.
        corners: (C, 3).
        rounds: (R,) ROUND, flat.
        rays: (H, W, 3) rays of the lens.
        rotation: (3, 3) world_R_camera.
        x: camera position, world metres.
        y: camera position, world metres.
        z: camera position, world metres.
        offsets: (S, 2) rays of a pixel, in pixels right and down of its centre.
        cones: cones of the lens; those of the finest tiles come first.
        begins: from `binning.build_tile_lists`.
        lists: from `binning.build_tile_lists`.
        order: (N,) surface indices.
        nearest: (N,) lower bounds of the distances of the surfaces in ``order``, ascending.
        aims: (N, 5) cones around the surfaces.
        starts: (N + 1,) first rows of the surfaces' coefficients.
        rows: (rows, 3) coefficients of `binning.fill_ray_tests`; those that a tile tries are filled in.
        filled: (N,) 1 for surfaces whose coefficients are filled in; it is updated.
        mask: (H, W) mask: tiles that are 0 everywhere are skipped; (0, 0): no tile is skipped.

    Returns:
        (H, W) surface that the first ray hits, or SKY; (H, W) 1 where the rays of a pixel hit different surfaces; the
        fragments of these pixels: (K, 2) pixel and surface, (K, 3) share of the pixel's rays and their mean offset;
        counts of tiles, of tested pairs of tile and surface, and of pairs in the lists.
    """
    height, width = rays.shape[:2]
    down, across = -(-height // TILE_PX), -(-width // TILE_PX)
    number, samples = len(faces), len(offsets)
    count = samples * _AREA
    sx, sy, sz = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
    inverse, inside, found = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.int32)
    run, reach, lines = samples * TILE_PX, np.empty(_AREA, np.float32), np.empty((2, 2, TILE_PX))
    px, py, pz = np.empty(_AREA, np.float32), np.empty(_AREA, np.float32), np.empty(_AREA, np.float32)
    ahead, least = np.empty(_AREA, np.float32), np.empty(TILE_PX, np.float32)
    crossed = np.empty(MOST_CORNERS, np.int64)
    surfaces, sums = np.empty(samples, np.int32), np.empty((samples, 3), np.float32)
    differs = np.empty(_AREA, np.int32)
    room = height * width // 2 + count
    which, share = np.empty((room, 2), np.int32), np.empty((room, 3), np.float32)
    centre = np.full((height, width), SKY, np.int32)
    mixed = np.zeros((height, width), np.uint8)
    counts = np.zeros(3, np.int64)
    counts[2] = len(lists)
    spread = 0.0
    for sample in range(samples):
        spread = max(spread, abs(offsets[sample, 0]), abs(offsets[sample, 1]))
    spread += max(abs(offsets[0, 0]), abs(offsets[0, 1]))
    used = 0
    for tile in range(down * across):
        top, left = tile // across * TILE_PX, tile % across * TILE_PX
        if mask.shape[0] > 0 and not _is_any_set(mask, top, left):
            continue
        counts[0] += 1
        ax, ay, az, bx, by, bz = _spread_rays(rays, rotation, offsets, top, left, sx, sy, sz)
        i, j, k = cones[tile, 0], cones[tile, 1], cones[tile, 2]
        cx = rotation[0, 0] * i + rotation[0, 1] * j + rotation[0, 2] * k
        cy = rotation[1, 0] * i + rotation[1, 1] * j + rotation[1, 2] * k
        cz = rotation[2, 0] * i + rotation[2, 1] * j + rotation[2, 2] * k
        sine = cones[tile, 4] if cones[tile, 3] > 0.0 else 2.0
        # The dot products with u of a column's rays, and with v of a row's, lie in intervals.
        ux, uy, uz = _unit_normal(bx, by, bz, cx, cy, cz)
        vx, vy, vz = _unit_normal(cx, cy, cz, ax, ay, az)
        _bound_lines(sx, sy, sz, run, ux, uy, uz, vx, vy, vz, lines)
        wide = spread * (abs(ux * ax + uy * ay + uz * az) + abs(ux * bx + uy * by + uz * bz)) + _MARGIN
        high = spread * (abs(vx * ax + vy * ay + vz * az) + abs(vx * bx + vy * by + vz * bz)) + _MARGIN
        # The lengths of the rays lie within this of 1.
        bend = spread * (math.sqrt(ax * ax + ay * ay + az * az) + math.sqrt(bx * bx + by * by + bz * bz))
        for i in range(count):
            inverse[i], found[i] = np.float32(0.0), SKY
        for pixel in range(_AREA):
            reach[pixel] = np.float32(0.0)
            at = pixel // TILE_PX * run + pixel % TILE_PX
            px[pixel], py[pixel], pz[pixel] = sx[at], sy[at], sz[at]
        for row in range(TILE_PX):
            least[row] = np.float32(0.0)
        farthest = np.float32(0.0)
        for at in range(begins[tile], begins[tile + 1]):
            place = lists[at]
            if nearest[place] * farthest > _HIDDEN:
                break
            dx, dy, dz, cosine = aims[place, 0], aims[place, 1], aims[place, 2], aims[place, 3]
            # The chord of the half angle: no direction in the cone is farther from its axis.
            square = 2.0 - 2.0 * cosine + (0.0 if order[place] < number else _ROUNDING)
            apart = (1.0 + bend) * math.sqrt(square) if cosine > -1.5 else np.inf
            at_u, at_v = ux * dx + uy * dy + uz * dz, vx * dx + vy * dy + vz * dz
            start, stop = _find_lines(lines[0], at_u, apart + bend * abs(at_u) + wide)
            upper, lower = _find_lines(lines[1], at_v, apart + bend * abs(at_v) + high)
            if _is_hidden(reach, nearest[place], start, stop, upper, lower):
                continue
            first, last = starts[place], starts[place + 1]
            if filled[place] == 0:
                fill_ray_tests(faces, corners, rounds, order[place], x, y, z, rows, first)
                filled[place] = 1
            edges = 0
            if order[place] < number:
                edges = _list_edges(rows, first, last, cx, cy, cz, sine, crossed)
                if edges < 0:
                    continue
                begin, end = upper * TILE_PX, lower * TILE_PX
                above, below = _find_rows(
                    rows, first, crossed, edges, px[begin:end], py[begin:end], pz[begin:end],
                    ax, ay, az, bx, by, bz, spread, reach[begin:end], ahead,
                )  # fmt: skip
                if above == below:
                    continue
                upper, lower = upper + above, upper + below
            counts[1] += 1
            begin, end = upper * run, lower * run
            if order[place] < number:
                won = _try_face(
                    rows, first, crossed, edges, sx[begin:end], sy[begin:end], sz[begin:end], inside,
                    inverse[begin:end], found[begin:end], place,
                )  # fmt: skip
            else:
                won = _try_round(
                    rows, first, sx[begin:end], sy[begin:end], sz[begin:end], inverse[begin:end], found[begin:end],
                    place,
                )  # fmt: skip
            if won > 0:
                _lower_reach(inverse, samples, upper, lower, reach, least)
                farthest = least[0]
                for row in range(1, TILE_PX):
                    farthest = min(farthest, least[row])
        for pixel in range(_AREA):
            differs[pixel] = 0
        for row in range(TILE_PX):
            for sample in range(1, samples):
                for column in range(TILE_PX):
                    at = row * run + column
                    differs[row * TILE_PX + column] |= found[at + sample * TILE_PX] ^ found[at]
        if used + count > room:
            room = 2 * room + count
            longer, wider = np.empty((room, 2), np.int32), np.empty((room, 3), np.float32)
            # Not slices: the error of shapes that differ takes three seconds to compile.
            for at in range(used):
                longer[at, 0], longer[at, 1] = which[at, 0], which[at, 1]
                wider[at, 0], wider[at, 1], wider[at, 2] = share[at, 0], share[at, 1], share[at, 2]
            which, share = longer, wider
        for row in range(top, min(top + TILE_PX, height)):
            for column in range(left, min(left + TILE_PX, width)):
                pixel, ray = (row - top) * TILE_PX + column - left, (row - top) * run + column - left
                first_surface = found[ray]
                centre[row, column] = order[first_surface] if first_surface >= 0 else SKY
                if differs[pixel] == 0:
                    continue
                mixed[row, column] = 1
                kinds = 0
                for sample in range(samples):
                    surface = found[ray + sample * TILE_PX]
                    kind = 0
                    while kind < kinds and surfaces[kind] != surface:
                        kind += 1
                    if kind == kinds:
                        surfaces[kind], sums[kind, 0], sums[kind, 1], sums[kind, 2] = surface, 0.0, 0.0, 0.0
                        kinds += 1
                    sums[kind, 0] += 1.0
                    sums[kind, 1] += offsets[sample, 0]
                    sums[kind, 2] += offsets[sample, 1]
                for kind in range(kinds):
                    surface = surfaces[kind]
                    which[used, 0], which[used, 1] = row * width + column, order[surface] if surface >= 0 else SKY
                    share[used, 0] = sums[kind, 0] / samples
                    share[used, 1], share[used, 2] = sums[kind, 1] / sums[kind, 0], sums[kind, 2] / sums[kind, 0]
                    used += 1
    return centre, mixed, which[:used], share[:used], counts


@inner_per_pixel()
def _list_edges(
    rows: Float32, first: int, last: int, cx: float, cy: float, cz: float, sine: float, crossed: Int64
) -> int:
    """List the edges of a face that cross a tile; returns their number, or -1 if the tile lies outside an edge.

    A sine above 1 is that of no cone.
    """
    edges = 0
    for edge in range(first + 1, last):
        out = rows[edge, 0] * cx + rows[edge, 1] * cy + rows[edge, 2] * cz
        if out < -sine:
            return -1
        if out < sine:
            crossed[edges] = edge
            edges += 1
    return edges


@inner_per_pixel()
def _find_rows(
    rows: Float32, first: int, crossed: Int64, edges: int, px: Float32, py: Float32, pz: Float32,
    ax: float, ay: float, az: float, bx: float, by: float, bz: float, spread: float, reach: Float32,
    ahead: Float32,
) -> tuple[int, int]:  # fmt: skip
    """Find the rows of pixels that a face may touch, and where rays hit nothing nearer.

    A ray of a pixel is its first one and at most ``spread`` times the steps to its neighbours, so that the dot product
    with a row of coefficients changes by no more than that.

    Args:
        rows: coefficients of `binning.fill_ray_tests`.
        first: first row of the face.
        crossed: from `_list_edges`.
        edges: number of edges that cross the tile.
        px: x of the first rays of the pixels.
        py: y.
        pz: z.
        ax: change of the rays from pixel to pixel, to the right.
        ay: to the right.
        az: to the right.
        bx: downwards.
        by: downwards.
        bz: downwards.
        spread: largest difference of a pixel's offsets from its first, pixels.
        reach: least inverse distances of the rays of the pixels.
        ahead: buffer of a number for each pixel.

    Returns:
        The first row, and the one behind the last; the same if there are none.
    """
    a, b, c = rows[first, 0], rows[first, 1], rows[first, 2]
    slack = spread * (abs(a * ax + b * ay + c * az) + abs(a * bx + b * by + c * bz))
    more = np.float32(slack + _INEXACT * (abs(a) + abs(b) + abs(c)))
    count = len(px)
    for i in range(count):
        ahead[i] = a * px[i] + b * py[i] + c * pz[i] + more - reach[i]
    for at in range(edges):
        a, b, c = rows[crossed[at], 0], rows[crossed[at], 1], rows[crossed[at], 2]
        slack = spread * (abs(a * ax + b * ay + c * az) + abs(a * bx + b * by + c * bz))
        more = np.float32(slack + _INEXACT)
        for i in range(count):
            ahead[i] = min(ahead[i], a * px[i] + b * py[i] + c * pz[i] + more)
    upper, lower = 0, count // TILE_PX
    while upper < lower and not _is_any_ahead(ahead, upper):
        upper += 1
    while lower > upper and not _is_any_ahead(ahead, lower - 1):
        lower -= 1
    return upper, lower


@inner_per_pixel()
def _is_any_ahead(ahead: Float32, row: int) -> bool:
    found = 0
    for column in range(TILE_PX):
        found |= ahead[row * TILE_PX + column] >= np.float32(0.0)
    return found > 0


@inner_per_pixel()
def _is_any_set(mask: Float32, top: int, left: int) -> bool:
    for row in range(top, min(top + TILE_PX, mask.shape[0])):
        for column in range(left, min(left + TILE_PX, mask.shape[1])):
            if mask[row, column] > 0.0:
                return True
    return False


@inner_per_pixel()
def ray_steps(
    rays: Float64, rotation: Float64, top: int, left: int, bottom: int, right: int
) -> tuple[float, float, float, float, float, float]:
    """Return the change of a tile's rays from pixel to pixel, to the right and downwards, in the world frame."""
    row, column = (top + bottom) // 2, (left + right) // 2
    over, under = (left, right) if right > left else (max(left - 1, 0), right)
    above, below = (top, bottom) if bottom > top else (max(top - 1, 0), bottom)
    wide, high = 1.0 / max(under - over, 1), 1.0 / max(below - above, 1)
    i, j, k = (
        rays[row, under, 0] - rays[row, over, 0],
        rays[row, under, 1] - rays[row, over, 1],
        rays[row, under, 2] - rays[row, over, 2],
    )
    p, q, r = (
        rays[below, column, 0] - rays[above, column, 0],
        rays[below, column, 1] - rays[above, column, 1],
        rays[below, column, 2] - rays[above, column, 2],
    )
    return (
        wide * (rotation[0, 0] * i + rotation[0, 1] * j + rotation[0, 2] * k),
        wide * (rotation[1, 0] * i + rotation[1, 1] * j + rotation[1, 2] * k),
        wide * (rotation[2, 0] * i + rotation[2, 1] * j + rotation[2, 2] * k),
        high * (rotation[0, 0] * p + rotation[0, 1] * q + rotation[0, 2] * r),
        high * (rotation[1, 0] * p + rotation[1, 1] * q + rotation[1, 2] * r),
        high * (rotation[2, 0] * p + rotation[2, 1] * q + rotation[2, 2] * r),
    )


@inner_per_pixel()
def _spread_rays(
    rays: Float64, rotation: Float64, offsets: Float32, top: int, left: int, sx: Float32, sy: Float32, sz: Float32
) -> tuple[float, float, float, float, float, float]:
    """Fill in the tile's rays in the world frame; the lens is taken as linear within a pixel.

    Row by row, and in a row sample by sample, so that the rays of some rows follow each other.

    Returns:
        The change of the rays from pixel to pixel, to the right and downwards.
    """
    height, width = rays.shape[:2]
    bottom, right = min(top + TILE_PX, height) - 1, min(left + TILE_PX, width) - 1
    ax, ay, az, bx, by, bz = ray_steps(rays, rotation, top, left, bottom, right)
    run = len(offsets) * TILE_PX
    for pixel in range(_AREA):
        row, column = min(top + pixel // TILE_PX, bottom), min(left + pixel % TILE_PX, right)
        a, b, c = rays[row, column, 0], rays[row, column, 1], rays[row, column, 2]
        at = pixel // TILE_PX * run + pixel % TILE_PX
        sx[at] = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c
        sy[at] = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c
        sz[at] = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c
    # The first sample comes last, because the other samples start from the values at the pixel centres.
    for sample in range(len(offsets) - 1, -1, -1):
        u, v = offsets[sample, 0], offsets[sample, 1]
        x = np.float32(u * ax + v * bx)
        y = np.float32(u * ay + v * by)
        z = np.float32(u * az + v * bz)
        for row in range(TILE_PX):
            centre, first = row * run, row * run + sample * TILE_PX
            for column in range(TILE_PX):
                sx[first + column] = sx[centre + column] + x
                sy[first + column] = sy[centre + column] + y
                sz[first + column] = sz[centre + column] + z
    return ax, ay, az, bx, by, bz


@inner_per_pixel()
def _unit_normal(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> tuple[float, float, float]:
    """Return the unit vector perpendicular to two vectors; 0 if they are parallel."""
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    size = math.sqrt(x * x + y * y + z * z)
    scale = 1.0 / size if size > 0.0 else 0.0
    return scale * x, scale * y, scale * z


@inner_per_pixel()
def _bound_lines(
    sx: Float32, sy: Float32, sz: Float32, run: int, ux: float, uy: float, uz: float, vx: float, vy: float, vz: float,
    lines: Float64,
) -> None:  # fmt: skip
    """Bound the dot products of the first rays of pixels with u in each column, and with v in each row.

    Args:
        sx: x of the rays of a tile.
        sy: y.
        sz: z.
        run: number of rays in a row.
        ux: x of u.
        uy: y of u.
        uz: z of u.
        vx: x of v.
        vy: y of v.
        vz: z of v.
        lines: (2, 2, TILE_PX) output: least and greatest in each column, and in each row.
    """
    for line in range(TILE_PX):
        lines[0, 0, line], lines[0, 1, line], lines[1, 0, line], lines[1, 1, line] = np.inf, -np.inf, np.inf, -np.inf
    for row in range(TILE_PX):
        for column in range(TILE_PX):
            i = row * run + column
            u, v = ux * sx[i] + uy * sy[i] + uz * sz[i], vx * sx[i] + vy * sy[i] + vz * sz[i]
            lines[0, 0, column], lines[0, 1, column] = min(lines[0, 0, column], u), max(lines[0, 1, column], u)
            lines[1, 0, row], lines[1, 1, row] = min(lines[1, 0, row], v), max(lines[1, 1, row], v)


@inner_per_pixel()
def _find_lines(bounds: Float64, at: float, apart: float) -> tuple[int, int]:
    """Return the first line with a dot product within ``apart`` of ``at``, and the one behind the last."""
    start, stop = 0, TILE_PX
    while start < stop and bounds[1, start] < at - apart:
        start += 1
    while stop > start and bounds[0, stop - 1] > at + apart:
        stop -= 1
    return start, stop


@inner_per_pixel()
def _is_hidden(reach: Float32, nearest: float, left: int, right: int, top: int, bottom: int) -> bool:
    """Return whether all rays of some pixels hit something before a distance; True if there are no pixels."""
    for row in range(top, bottom):
        for column in range(left, right):
            if nearest * reach[row * TILE_PX + column] <= _HIDDEN_BY_RAYS:
                return False
    return True


@inner_per_pixel()
def _lower_reach(inverse: Float32, samples: int, top: int, bottom: int, reach: Float32, least: Float32) -> None:
    """Set the least inverse distance of the rays of each pixel in some rows of a tile, and of all rays of a row."""
    for row in range(top, bottom):
        first = row * samples * TILE_PX
        for column in range(TILE_PX):
            reach[row * TILE_PX + column] = inverse[first + column]
        for sample in range(1, samples):
            for column in range(TILE_PX):
                at = row * TILE_PX + column
                reach[at] = min(reach[at], inverse[first + sample * TILE_PX + column])
        least[row] = reach[row * TILE_PX]
        for column in range(1, TILE_PX):
            least[row] = min(least[row], reach[row * TILE_PX + column])


@inner_per_pixel()
def _try_face(
    rows: Float32,
    first: int,
    crossed: Int64,
    edges: int,
    sx: Float32,
    sy: Float32,
    sz: Float32,
    inside: Float32,
    inverse: Float32,
    found: Int32,
    place: int,
) -> int:
    """Try a face on the rays of some rows of a tile, and return how many it wins."""
    count = len(sx)
    for at in range(edges):
        a, b, c = rows[crossed[at], 0], rows[crossed[at], 1], rows[crossed[at], 2]
        if at > 0:
            for i in range(count):
                inside[i] = min(inside[i], a * sx[i] + b * sy[i] + c * sz[i])
        else:
            for i in range(count):
                inside[i] = a * sx[i] + b * sy[i] + c * sz[i]
    a, b, c = rows[first, 0], rows[first, 1], rows[first, 2]
    mark, won = np.int32(place), 0
    if edges > 0:
        for i in range(count):
            w = a * sx[i] + b * sy[i] + c * sz[i]
            nearer = (inside[i] >= np.float32(0.0)) & (w > inverse[i])
            inverse[i] = w if nearer else inverse[i]
            found[i] = mark if nearer else found[i]
            won += nearer
    else:
        for i in range(count):
            w = a * sx[i] + b * sy[i] + c * sz[i]
            nearer = w > inverse[i]
            inverse[i] = w if nearer else inverse[i]
            found[i] = mark if nearer else found[i]
            won += nearer
    return won


@inner_per_pixel()
def _try_round(
    rows: Float32, first: int, sx: Float32, sy: Float32, sz: Float32, inverse: Float32, found: Int32, place: int
) -> int:
    """Try an ellipsoid on the rays of some rows of a tile, and return how many it wins."""
    a, b, c = rows[first, 0], rows[first, 1], rows[first, 2]
    xx, yy, zz = rows[first + 1, 0], rows[first + 1, 1], rows[first + 1, 2]
    xy, xz, yz = rows[first + 2, 0], rows[first + 2, 1], rows[first + 2, 2]
    count, mark, won = len(sx), np.int32(place), 0
    for i in range(count):
        x, y, z = sx[i], sy[i], sz[i]
        ahead = a * x + b * y + c * z
        square = x * (xx * x + xy * y + xz * z) + y * (yy * y + yz * z) + zz * z * z
        w = ahead + math.sqrt(max(square, np.float32(0.0)))
        nearer = (square > np.float32(0.0)) & (ahead > np.float32(0.0)) & (w > inverse[i])
        inverse[i] = w if nearer else inverse[i]
        found[i] = mark if nearer else found[i]
        won += nearer
    return won
