"""Computes the surfaces in each pixel and their shares: nine rays per pixel, tile by tile, in vectorised loops."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Float32, Float64, Int32, Int64, Records, UInt8
from mirror.compiled import inner_per_pixel
from mirror.portable import scalars
from mirror.synth.render.binning import fill_ray_tests
from mirror.synth.render.lens import TILE_PX

SKY: Final = -1
_AREA: Final = TILE_PX * TILE_PX

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
    surfaces, sums = np.empty(samples, np.int32), np.empty((samples, 3), np.float32)
    differs, bits, pattern = np.empty(_AREA, np.int32), inverse.view(np.int32), np.empty(1, np.int32)
    room = height * width // 2 + count
    which, share = np.empty((room, 2), np.int32), np.empty((room, 3), np.float32)
    centre = np.full((height, width), SKY, np.int32)
    mixed = np.zeros((height, width), np.uint8)
    counts = np.zeros(3, np.int64)
    counts[2] = len(lists)
    used = 0
    for tile in range(down * across):
        top, left = tile // across * TILE_PX, tile % across * TILE_PX
        if mask.shape[0] > 0 and not _is_any_set(mask, top, left):
            continue
        counts[0] += 1
        _spread_rays(rays, rotation, offsets, top, left, sx, sy, sz)
        i, j, k = cones[tile, 0], cones[tile, 1], cones[tile, 2]
        cx = rotation[0, 0] * i + rotation[0, 1] * j + rotation[0, 2] * k
        cy = rotation[1, 0] * i + rotation[1, 1] * j + rotation[1, 2] * k
        cz = rotation[2, 0] * i + rotation[2, 1] * j + rotation[2, 2] * k
        sine = cones[tile, 4] if cones[tile, 3] > 0.0 else 2.0
        for i in range(count):
            inverse[i], found[i] = np.float32(0.0), SKY
        farthest = np.float32(0.0)
        for at in range(begins[tile], begins[tile + 1]):
            place = lists[at]
            if nearest[place] * farthest > np.float32(1.0001):
                break
            first, last = starts[place], starts[place + 1]
            if filled[place] == 0:
                fill_ray_tests(faces, corners, rounds, order[place], x, y, z, rows, first)
                filled[place] = 1
            if order[place] < number and _is_outside(rows, first, last, cx, cy, cz, sine):
                continue
            counts[1] += 1
            if order[place] < number:
                _try_face(rows, first, last, cx, cy, cz, sine, sx, sy, sz, inside, inverse, found, place)
            else:
                _try_round(rows, first, sx, sy, sz, inverse, found, place)
            if counts[1] & 3 == 0:
                # Positive floats have the order of their bits, and the compiler vectorises the minimum of integers.
                least = bits[0]
                for i in range(count):
                    least = min(least, bits[i])
                pattern[0] = least
                farthest = pattern.view(np.float32)[0]
        for pixel in range(_AREA):
            differs[pixel] = 0
        for sample in range(1, samples):
            for pixel in range(_AREA):
                differs[pixel] |= found[sample * _AREA + pixel] ^ found[pixel]
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
                pixel = (row - top) * TILE_PX + column - left
                first_surface = found[pixel]
                centre[row, column] = order[first_surface] if first_surface >= 0 else SKY
                if differs[pixel] == 0:
                    continue
                mixed[row, column] = 1
                kinds = 0
                for sample in range(samples):
                    surface = found[sample * _AREA + pixel]
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
def _is_outside(rows: Float32, first: int, last: int, cx: float, cy: float, cz: float, sine: float) -> bool:
    """Return whether a tile lies outside an edge of a face; a sine above 1 is that of no cone."""
    outside = False
    for edge in range(first + 1, last):
        outside = outside or rows[edge, 0] * cx + rows[edge, 1] * cy + rows[edge, 2] * cz < -sine
    return outside


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
) -> None:
    """Fill in the tile's rays in the world frame, sample by sample; the lens is taken as linear within a pixel."""
    height, width = rays.shape[:2]
    bottom, right = min(top + TILE_PX, height) - 1, min(left + TILE_PX, width) - 1
    ax, ay, az, bx, by, bz = ray_steps(rays, rotation, top, left, bottom, right)
    for pixel in range(_AREA):
        row, column = min(top + pixel // TILE_PX, bottom), min(left + pixel % TILE_PX, right)
        a, b, c = rays[row, column, 0], rays[row, column, 1], rays[row, column, 2]
        sx[pixel] = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c
        sy[pixel] = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c
        sz[pixel] = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c
    # The first sample comes last, because the other samples start from the values at the pixel centres.
    for sample in range(len(offsets) - 1, -1, -1):
        u, v = offsets[sample, 0], offsets[sample, 1]
        x = np.float32(u * ax + v * bx)
        y = np.float32(u * ay + v * by)
        z = np.float32(u * az + v * bz)
        first = sample * _AREA
        for pixel in range(_AREA):
            sx[first + pixel] = sx[pixel] + x
            sy[first + pixel] = sy[pixel] + y
            sz[first + pixel] = sz[pixel] + z


@inner_per_pixel()
def _try_face(
    rows: Float32,
    first: int,
    last: int,
    cx: float,
    cy: float,
    cz: float,
    sine: float,
    sx: Float32,
    sy: Float32,
    sz: Float32,
    inside: Float32,
    inverse: Float32,
    found: Int32,
    place: int,
) -> None:
    count = len(sx)
    crossed = False
    for edge in range(first + 1, last):
        a, b, c = rows[edge, 0], rows[edge, 1], rows[edge, 2]
        # The whole tile is inside this edge.
        if a * cx + b * cy + c * cz >= sine:
            continue
        if crossed:
            for i in range(count):
                inside[i] = min(inside[i], a * sx[i] + b * sy[i] + c * sz[i])
        else:
            crossed = True
            for i in range(count):
                inside[i] = a * sx[i] + b * sy[i] + c * sz[i]
    a, b, c = rows[first, 0], rows[first, 1], rows[first, 2]
    mark = np.int32(place)
    if crossed:
        for i in range(count):
            w = a * sx[i] + b * sy[i] + c * sz[i]
            nearer = (inside[i] >= np.float32(0.0)) & (w > inverse[i])
            inverse[i] = w if nearer else inverse[i]
            found[i] = mark if nearer else found[i]
    else:
        for i in range(count):
            w = a * sx[i] + b * sy[i] + c * sz[i]
            nearer = w > inverse[i]
            inverse[i] = w if nearer else inverse[i]
            found[i] = mark if nearer else found[i]


@inner_per_pixel()
def _try_round(
    rows: Float32, first: int, sx: Float32, sy: Float32, sz: Float32, inverse: Float32, found: Int32, place: int
) -> None:
    count = len(sx)
    a, b, c = rows[first, 0], rows[first, 1], rows[first, 2]
    xx, yy, zz = rows[first + 1, 0], rows[first + 1, 1], rows[first + 1, 2]
    xy, xz, yz = rows[first + 2, 0], rows[first + 2, 1], rows[first + 2, 2]
    mark = np.int32(place)
    for i in range(count):
        x, y, z = sx[i], sy[i], sz[i]
        ahead = a * x + b * y + c * z
        square = x * (xx * x + xy * y + xz * z) + y * (yy * y + yz * z) + zz * z * z
        w = ahead + math.sqrt(max(square, np.float32(0.0)))
        nearer = (square > np.float32(0.0)) & (ahead > np.float32(0.0)) & (w > inverse[i])
        inverse[i] = w if nearer else inverse[i]
        found[i] = mark if nearer else found[i]
