"""Computes the surfaces in each pixel and their shares: nine rays per pixel, tile by tile, in vectorised loops."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Float32, Float64, Int32, Int64, Records, UInt8
from mirror.compiled import inner_per_pixel
from mirror.synth.model.surfaces import MOST_CORNERS
from mirror.synth.render.binning import fill_ray_tests
from mirror.synth.render.lens import TILE_PX
from mirror.synth.render.sample_rays import spread_rays, unit_normal
from mirror.synth.render.touched_pixels import bound_lines, find_lines, find_rows, list_edges

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
        ax, ay, az, bx, by, bz = spread_rays(rays, rotation, offsets, top, left, sx, sy, sz)
        i, j, k = cones[tile, 0], cones[tile, 1], cones[tile, 2]
        cx = rotation[0, 0] * i + rotation[0, 1] * j + rotation[0, 2] * k
        cy = rotation[1, 0] * i + rotation[1, 1] * j + rotation[1, 2] * k
        cz = rotation[2, 0] * i + rotation[2, 1] * j + rotation[2, 2] * k
        sine = cones[tile, 4] if cones[tile, 3] > 0.0 else 2.0
        # The dot products with u of a column's rays, and with v of a row's, lie in intervals.
        ux, uy, uz = unit_normal(bx, by, bz, cx, cy, cz)
        vx, vy, vz = unit_normal(cx, cy, cz, ax, ay, az)
        bound_lines(sx, sy, sz, run, ux, uy, uz, vx, vy, vz, lines)
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
            start, stop = find_lines(lines[0], at_u, apart + bend * abs(at_u) + wide)
            upper, lower = find_lines(lines[1], at_v, apart + bend * abs(at_v) + high)
            if _is_hidden(reach, nearest[place], start, stop, upper, lower):
                continue
            first, last = starts[place], starts[place + 1]
            if filled[place] == 0:
                fill_ray_tests(faces, corners, rounds, order[place], x, y, z, rows, first)
                filled[place] = 1
            edges = 0
            if order[place] < number:
                edges = list_edges(rows, first, last, cx, cy, cz, sine, crossed)
                if edges < 0:
                    continue
                begin, end = upper * TILE_PX, lower * TILE_PX
                above, below = find_rows(
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
def _is_any_set(mask: Float32, top: int, left: int) -> bool:
    for row in range(top, min(top + TILE_PX, mask.shape[0])):
        for column in range(left, min(left + TILE_PX, mask.shape[1])):
            if mask[row, column] > 0.0:
                return True
    return False


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
