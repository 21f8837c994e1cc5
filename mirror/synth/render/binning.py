"""Visibility culling: lists the surfaces that each tile of a view may show, nearest first.

Most surfaces of a view that has few tiles are small beside a tile, and are hidden. Their tiles are looked up by
direction, and the coefficients of their rays are built when a tile tries them.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Float32, Float64, Int32, Int64, Records, UInt8
from mirror.compiled import inner_numpy_njit
from mirror.synth.model import Label
from mirror.synth.render.lens import FANOUT, LEVELS

_STACK: Final = 4 * LEVELS * FANOUT * FANOUT
_DIGIT: Final = 11


@njit(cache=True, nogil=True, error_model="numpy")
def bounding_spheres(faces: Records, corners: Float64, rounds: Records) -> Float64:
    """Return what `find_facing` reads of the faces and ellipsoids, in one line of the processor's cache each.

    Returns:
        (F + R, 9) centre and radius of a bounding sphere; normal and offset of a face, 0 and -1 of an ellipsoid, which
        faces every camera; number of rows of `fill_ray_tests`, negative if the surface has two sides.
    """
    out = np.empty((len(faces) + len(rounds), 9))
    for index in range(len(faces)):
        first, count = faces[index].first, faces[index].count
        x, y, z = 0.0, 0.0, 0.0
        for corner in range(first, first + count):
            x, y, z = x + corners[corner, 0], y + corners[corner, 1], z + corners[corner, 2]
        x, y, z = x / count, y / count, z / count
        most = 0.0
        for corner in range(first, first + count):
            dx, dy, dz = corners[corner, 0] - x, corners[corner, 1] - y, corners[corner, 2] - z
            most = max(most, dx * dx + dy * dy + dz * dz)
        out[index, 0], out[index, 1], out[index, 2], out[index, 3] = x, y, z, math.sqrt(most)
        face = faces[index]
        out[index, 4], out[index, 5], out[index, 6], out[index, 7] = (
            face.normal_0,
            face.normal_1,
            face.normal_2,
            face.offset,
        )
        out[index, 8] = -(1.0 + count) if face.two_sided else 1.0 + count
    for index in range(len(rounds)):
        ellipsoid, at = rounds[index], len(faces) + index
        out[at, 0], out[at, 1], out[at, 2] = ellipsoid.centre_0, ellipsoid.centre_1, ellipsoid.centre_2
        out[at, 3] = max(ellipsoid.half_0, ellipsoid.half_1, ellipsoid.half_2)
        out[at, 4], out[at, 5], out[at, 6], out[at, 7], out[at, 8] = 0.0, 0.0, 0.0, -1.0, 3.0
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def find_facing(
    faces: Records,
    spheres: Float64,
    cones: Float64,
    levels: Int64,
    rotation: Float64,
    x: float,
    y: float,
    z: float,
    least_rad: float,
    ground: bool,
) -> tuple[Int64, Float32, Float64, Int64]:
    """Find the surfaces in a view that face the camera and are large enough to be visible.

    Args:
        faces: (F,) FACE, flat.
        spheres: from `bounding_spheres`.
        cones: cones of the lens.
        levels: levels of the lens.
        rotation: (3, 3) world_R_camera.
        x: camera position, world metres.
        y: camera position, world metres.
        z: camera position, world metres.
        least_rad: half the angle below which a surface is left out.
        ground: whether faces of the ground are included.

    Returns:
        (N,) surface indices, nearest first; (N,) lower bounds of their distances, metres; (N, 5) cones around them:
        axis, cosine and sine of the half angle, and (0, 0, 0, -2, 1) where the camera is in the bounding sphere;
        (N + 1,) index of the first row of coefficients of each surface, for `fill_ray_tests`.
    """
    chosen, distances = np.empty(len(spheres), np.int64), np.empty(len(spheres), np.float32)
    needed, found = np.empty(len(spheres), np.int64), np.empty((len(spheres), 5))
    first, count = levels[LEVELS - 1, 0], levels[LEVELS - 1, 1] * levels[LEVELS - 1, 2]
    turned = _rotate_cones(cones[first : first + count], rotation)
    used = 0
    for index in range(len(spheres)):
        rows = spheres[index, 8]
        if not ground and index < len(faces) and faces[index].label <= Label.TERRAIN:
            continue
        out = spheres[index, 4] * x + spheres[index, 5] * y + spheres[index, 6] * z - spheres[index, 7]
        if abs(out) < 1e-7 or (out < 0.0 and rows > 0.0):
            continue
        dx, dy, dz = spheres[index, 0] - x, spheres[index, 1] - y, spheres[index, 2] - z
        far = math.sqrt(dx * dx + dy * dy + dz * dz)
        if spheres[index, 3] < least_rad * far:
            continue
        sine, cosine = 1.0, -2.0
        if far > spheres[index, 3]:
            sine = spheres[index, 3] / far
            cosine = math.sqrt(1.0 - sine * sine)
            dx, dy, dz = dx / far, dy / far, dz / far
            within = False
            for root in range(count):
                within = within or _sphere_may_meet(turned[root], dx, dy, dz, cosine, sine)
            if not within:
                continue
        else:
            dx, dy, dz = 0.0, 0.0, 0.0
        found[used, 0], found[used, 1], found[used, 2], found[used, 3], found[used, 4] = dx, dy, dz, cosine, sine
        chosen[used], distances[used], needed[used] = index, max(far - spheres[index, 3], 0.0), int(abs(rows))
        used += 1
    places = _sort_places(distances, used)
    order, nearest, starts = np.empty(used, np.int64), np.empty(used, np.float32), np.zeros(used + 1, np.int64)
    aims = np.empty((used, 5))
    for at in range(used):
        place = places[at]
        order[at], nearest[at] = chosen[place], distances[place]
        starts[at + 1] = starts[at] + needed[place]
        for part in range(5):
            aims[at, part] = found[place, part]
    return order, nearest, aims, starts


@inner_numpy_njit
def _sort_places(distances: Float32, used: int) -> Int64:
    """Sort the first distances, which are not negative: stably, by their bits, eleven at a time."""
    bits = distances.view(np.int32)
    places, other = np.arange(used), np.empty(used, np.int64)
    tally = np.empty(1 << _DIGIT, np.int64)
    for shift in (0, _DIGIT, 2 * _DIGIT):
        tally[:] = 0
        for at in range(used):
            tally[(bits[at] >> shift) & ((1 << _DIGIT) - 1)] += 1
        total = 0
        for digit in range(1 << _DIGIT):
            count = tally[digit]
            tally[digit] = total
            total += count
        for at in range(used):
            digit = (bits[places[at]] >> shift) & ((1 << _DIGIT) - 1)
            other[tally[digit]] = places[at]
            tally[digit] += 1
        places, other = other, places
    return places


@inner_numpy_njit
def _rotate_cones(cones: Float64, rotation: Float64) -> Float64:
    turned = np.empty((len(cones), 5))
    for index in range(len(cones)):
        a, b, c = cones[index, 0], cones[index, 1], cones[index, 2]
        turned[index, 0] = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c
        turned[index, 1] = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c
        turned[index, 2] = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c
        turned[index, 3], turned[index, 4] = cones[index, 3], cones[index, 4]
    return turned


@inner_numpy_njit
def fill_ray_tests(
    faces: Records, corners: Float64, rounds: Records, index: int, x: float, y: float, z: float, rows: Float32, at: int
) -> None:
    """Fill in the coefficients that test whether a ray from a position hits a surface, and at which distance.

    A face has one row of three numbers for its plane and one for each edge. The dot product of the first row and the
    ray is the inverse of the distance; the dot product of an edge's row and the ray is negative outside that edge.
    Both hold for every direction, also for corners behind the position.
    An ellipsoid has three rows. With p the position relative to its centre and M the scaling to the unit sphere, the
    dot product of the first row and the ray d is -b / c; the second and third rows hold the quadratic form of
    (b^2 - a c) / c^2, where a = |M d|^2, b = M p . M d, c = |M p|^2 - 1.

    Args:
        faces: (F,) FACE, flat.
        corners: (C, 3).
        rounds: (R,) ROUND, flat.
        index: the surface.
        x: position, world metres.
        y: position, world metres.
        z: position, world metres.
        rows: (rows, 3) coefficients of all surfaces, which are written.
        at: first row of the surface.
    """
    if index < len(faces):
        face = faces[index]
        beyond = face.offset - (face.normal_0 * x + face.normal_1 * y + face.normal_2 * z)
        rows[at, 0] = face.normal_0 / beyond
        rows[at, 1] = face.normal_1 / beyond
        rows[at, 2] = face.normal_2 / beyond
        sign = -1.0 if beyond < 0.0 else 1.0
        for corner in range(face.count):
            i, j = face.first + corner, face.first + (corner + 1) % face.count
            ax, ay, az = corners[i, 0] - x, corners[i, 1] - y, corners[i, 2] - z
            bx, by, bz = corners[j, 0] - x, corners[j, 1] - y, corners[j, 2] - z
            cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            scale = sign / max(math.sqrt(cx * cx + cy * cy + cz * cz), 1e-30)
            rows[at + 1 + corner, 0] = scale * cx
            rows[at + 1 + corner, 1] = scale * cy
            rows[at + 1 + corner, 2] = scale * cz
    else:
        _quadric(rounds[index - len(faces)], x, y, z, rows[at : at + 3])


@inner_numpy_njit
def _quadric(ellipsoid: Records, x: float, y: float, z: float, rows: Float32) -> None:
    dx, dy, dz = x - ellipsoid.centre_0, y - ellipsoid.centre_1, z - ellipsoid.centre_2
    ax, ay, az = (
        ellipsoid.axes_00 / ellipsoid.half_0,
        ellipsoid.axes_01 / ellipsoid.half_0,
        ellipsoid.axes_02 / ellipsoid.half_0,
    )
    bx, by, bz = (
        ellipsoid.axes_10 / ellipsoid.half_1,
        ellipsoid.axes_11 / ellipsoid.half_1,
        ellipsoid.axes_12 / ellipsoid.half_1,
    )
    cx, cy, cz = (
        ellipsoid.axes_20 / ellipsoid.half_2,
        ellipsoid.axes_21 / ellipsoid.half_2,
        ellipsoid.axes_22 / ellipsoid.half_2,
    )
    p, q, r = ax * dx + ay * dy + az * dz, bx * dx + by * dy + bz * dz, cx * dx + cy * dy + cz * dz
    c = p * p + q * q + r * r - 1.0
    # A camera inside an ellipsoid does not see it.
    scale = 1.0 / c if c > 1e-12 else 0.0
    ux, uy, uz = ax * p + bx * q + cx * r, ay * p + by * q + cy * r, az * p + bz * q + cz * r
    rows[0, 0], rows[0, 1], rows[0, 2] = -scale * ux, -scale * uy, -scale * uz
    square = scale * scale
    rows[1, 0] = square * (ux * ux - c * (ax * ax + bx * bx + cx * cx))
    rows[1, 1] = square * (uy * uy - c * (ay * ay + by * by + cy * cy))
    rows[1, 2] = square * (uz * uz - c * (az * az + bz * bz + cz * cz))
    rows[2, 0] = 2.0 * square * (ux * uy - c * (ax * ay + bx * by + cx * cy))
    rows[2, 1] = 2.0 * square * (ux * uz - c * (ax * az + bx * bz + cx * cz))
    rows[2, 2] = 2.0 * square * (uy * uz - c * (ay * az + by * bz + cy * cz))


@njit(cache=True, nogil=True, error_model="numpy")
def build_tile_lists(
    faces: Records,
    corners: Float64,
    rounds: Records,
    order: Int64,
    nearest: Float32,
    aims: Float64,
    starts: Int64,
    cones: Float64,
    levels: Int64,
    cells: Int64,
    cell_tiles: Int32,
    small: Float64,
    rotation: Float64,
    x: float,
    y: float,
    z: float,
) -> tuple[Int64, Int32, Float32, UInt8]:
    """List the surfaces, nearest first, that each of the smallest tiles may show.

    The rays of a tile lie in a cone, and the tests of the cone against a surface's sphere and edges are conservative:
    no visible surface is left out, for any lens. Surfaces behind a face that covers a whole tile are left out.

    Args:
        faces: (F,) FACE, flat.
        corners: (C, 3).
        rounds: (R,) ROUND, flat.
        order: (N,) surface indices, nearest first.
        nearest: (N,) lower bounds of their distances.
        aims: (N, 5) cones around the surfaces.
        starts: (N + 1,) first rows of the surfaces' coefficients.
        cones: cones of the lens.
        levels: levels of the lens.
        cells: cells of directions of the lens.
        cell_tiles: tiles of the cells.
        small: (2,) sines of the half angles below which the cells list all tiles of a surface.
        rotation: (3, 3) world_R_camera.
        x: camera position, world metres.
        y: camera position, world metres.
        z: camera position, world metres.

    Returns:
        (tiles + 1,) index at which each tile's list begins; the lists: positions in ``order``; (rows, 3) coefficients
        of `fill_ray_tests`; (N,) 1 for surfaces whose coefficients are filled in.
    """
    number = len(faces)
    turned = _rotate_cones(cones, rotation)
    tiles = levels[0, 1] * levels[0, 2]
    pairs = np.empty((8 * tiles + 4 * len(order) + 64, 2), np.int32)
    used = 0
    stack = np.empty((_STACK, 3), np.int64)
    top = LEVELS - 1
    # Beyond these distances a nearer face covers the whole tile.
    limits = np.full(len(cones), np.inf)
    rows, filled = np.empty((starts[len(order)], 3), np.float32), np.zeros(len(order), np.uint8)
    for place in range(len(order)):
        index, distance = order[place], nearest[place]
        dx, dy, dz, cosine, sine = aims[place, 0], aims[place, 1], aims[place, 2], aims[place, 3], aims[place, 4]
        # A list grows by at most one pair a tile.
        if used + tiles > len(pairs):
            longer = np.empty((2 * len(pairs) + tiles, 2), np.int32)
            # Not a slice: the error of shapes that differ takes three seconds to compile.
            for pair in range(used):
                longer[pair, 0], longer[pair, 1] = pairs[pair, 0], pairs[pair, 1]
            pairs = longer
        if sine < small[1]:
            size = 0 if sine < small[0] else 1
            cell = _find_cell(rotation, dx, dy, dz, cells.shape[1] - 1)
            for entry in range(cells[size, cell], cells[size, cell + 1]):
                at = cell_tiles[entry]
                if distance <= limits[at] and _sphere_may_meet(turned[at], dx, dy, dz, cosine, sine):
                    pairs[used, 0], pairs[used, 1] = at, place
                    used += 1
            continue
        fill_ray_tests(faces, corners, rounds, index, x, y, z, rows, starts[place])
        filled[place] = 1
        first, last = starts[place] + 1, starts[place + 1]
        if index >= number:
            last = first
        for root in range(levels[top, 1] * levels[top, 2]):
            depth = 1
            stack[0, 0], stack[0, 1], stack[0, 2] = top, root // levels[top, 2], root % levels[top, 2]
            while depth > 0:
                depth -= 1
                level, row, column = stack[depth, 0], stack[depth, 1], stack[depth, 2]
                at = levels[level, 0] + row * levels[level, 2] + column
                if distance > limits[at] or not _may_meet(turned[at], dx, dy, dz, cosine, sine, rows, first, last):
                    continue
                if index < number and sine > turned[at, 4]:
                    limit = _occlusion_distance(turned[at], rows, first, last)
                    if limit < limits[at]:
                        _lower_limits(limits, levels, level, row, column, limit)
                if level == 0:
                    pairs[used, 0], pairs[used, 1] = row * levels[0, 2] + column, place
                    used += 1
                    continue
                finer = level - 1
                for i in range(row * FANOUT, min((row + 1) * FANOUT, levels[finer, 1])):
                    for j in range(column * FANOUT, min((column + 1) * FANOUT, levels[finer, 2])):
                        stack[depth, 0], stack[depth, 1], stack[depth, 2] = finer, i, j
                        depth += 1
    begins = np.zeros(tiles + 1, np.int64)
    for pair in range(used):
        begins[pairs[pair, 0] + 1] += 1
    for tile in range(tiles):
        begins[tile + 1] += begins[tile]
    lists, fill = np.empty(used, np.int32), begins[:-1].copy()
    for pair in range(used):
        tile = pairs[pair, 0]
        lists[fill[tile]] = pairs[pair, 1]
        fill[tile] += 1
    return begins, lists, rows, filled


@inner_numpy_njit
def _find_cell(rotation: Float64, dx: float, dy: float, dz: float, cells: int) -> int:
    """Find the cell of a direction in the world; `lens.make_cells` has the order of the cells."""
    u = rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz
    v = rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz
    w = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
    side = int(math.sqrt(cells // 6) + 0.5)
    wide, high, deep = abs(u), abs(v), abs(w)
    if deep >= wide and deep >= high:
        face, i, j = (4 if w > 0.0 else 5), u / deep, v / deep
    elif wide >= high:
        face, i, j = (0 if u > 0.0 else 1), v / wide, w / wide
    else:
        face, i, j = (2 if v > 0.0 else 3), u / high, w / high
    row, column = int(0.5 * (j + 1.0) * side), int(0.5 * (i + 1.0) * side)
    return (face * side + min(row, side - 1)) * side + min(column, side - 1)


@inner_numpy_njit
def _lower_limits(limits: Float64, levels: Int64, level: int, row: int, column: int, limit: float) -> None:
    """Lower the limit of a tile, and of all finer tiles in it."""
    top, bottom, left, right = row, row + 1, column, column + 1
    for finer in range(level, -1, -1):
        bottom, right = min(bottom, levels[finer, 1]), min(right, levels[finer, 2])
        for i in range(top, bottom):
            for j in range(left, right):
                at = levels[finer, 0] + i * levels[finer, 2] + j
                limits[at] = min(limits[at], limit)
        top, bottom, left, right = FANOUT * top, FANOUT * bottom, FANOUT * left, FANOUT * right


@inner_numpy_njit
def _occlusion_distance(cone: Float64, rows: Float32, first: int, last: int) -> float:
    """Distance beyond which a face hides everything in a cone; infinite if the face does not cover the cone."""
    if cone[3] <= 0.0:
        return np.inf
    for row in range(first, last):
        if rows[row, 0] * cone[0] + rows[row, 1] * cone[1] + rows[row, 2] * cone[2] < cone[4]:
            return np.inf
    a, b, c = rows[first - 1, 0], rows[first - 1, 1], rows[first - 1, 2]
    # The smallest inverse distance in the cone.
    size = math.sqrt(a * a + b * b + c * c)
    along = (a * cone[0] + b * cone[1] + c * cone[2]) / size
    least = along * cone[3] - math.sqrt(max(1.0 - along * along, 0.0)) * cone[4]
    return 1.0 / (size * least) if least > 1e-6 else np.inf


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _may_meet(
    cone: Float64,
    dx: float,
    dy: float,
    dz: float,
    cosine: float,
    sine: float,
    rows: Float32,
    first: int,
    last: int,
) -> bool:
    if cosine > -1.5 and not _sphere_may_meet(cone, dx, dy, dz, cosine, sine):
        return False
    if cone[3] <= 0.0:
        return True
    for row in range(first, last):
        out = rows[row, 0] * cone[0] + rows[row, 1] * cone[1] + rows[row, 2] * cone[2]
        # The whole cone is outside of the edge.
        if out < -cone[4]:
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _sphere_may_meet(cone: Float64, dx: float, dy: float, dz: float, cosine: float, sine: float) -> bool:
    # Compares with cos(a + b), where a and b are the half angles, each below 90 degrees.
    return cone[3] <= 0.0 or dx * cone[0] + dy * cone[1] + dz * cone[2] >= cone[3] * cosine - cone[4] * sine
