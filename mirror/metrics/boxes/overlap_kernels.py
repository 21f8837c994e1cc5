"""Compiled overlaps of oriented boxes: of pairs that share an axis by Green's theorem, of others by tetrahedra.

Everything is relative to the first box, and in units of the pair's longest side: offsets and sizes do not matter.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mirror.arrays import Float64, Int64
from mirror.compiled import inner_njit

# Below this sine of half the angle between their z axes, boxes count as upright towards each other.
_TILT = 1e-15
# A stack of tetrahedra: six at first; of each at most three parts wait for the next of six planes.
_WAITING = 32
# A box as six tetrahedra around the diagonal from corner 0 to corner 7; bit k of a corner is its side along axis k.
_TETRAHEDRA = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])


@inner_njit
def _side(x0: float, y0: float, x1: float, y1: float, left: float, right: float, low: float, high: float) -> float:
    """Integral of x dy along a segment whose x and y are held within bounds."""
    ya, yb = min(max(y0, low), high), min(max(y1, low), high)
    if ya == yb:
        return 0.0
    xa = x0 if ya == y0 else x0 + (ya - y0) / (y1 - y0) * (x1 - x0)
    xb = x1 if yb == y1 else x0 + (yb - y0) / (y1 - y0) * (x1 - x0)
    ca, cb = min(max(xa, left), right), min(max(xb, left), right)
    if ca == cb:
        return (yb - ya) * ca
    before, after = (ca - xa) / (xb - xa), (xb - cb) / (xb - xa)
    return (yb - ya) * (before * ca + after * cb + (1.0 - before - after) * 0.5 * (ca + cb))


@inner_njit
def _rectangles(
    dx: float, dy: float, cos: float, sin: float, length: float, width: float, length2: float, width2: float
) -> float:
    """Area shared by a rectangle along the axes and a turned one whose centre lies at (dx, dy)."""
    # Around the turned one's centre, where the coordinates are smallest.
    left, right, low, high = -0.5 * length - dx, 0.5 * length - dx, -0.5 * width - dy, 0.5 * width - dy
    ax, ay = 0.5 * length2 * cos, 0.5 * length2 * sin
    bx, by = -0.5 * width2 * sin, 0.5 * width2 * cos
    area = _side(ax - bx, ay - by, ax + bx, ay + by, left, right, low, high)
    area += _side(ax + bx, ay + by, bx - ax, by - ay, left, right, low, high)
    area += _side(bx - ax, by - ay, -ax - bx, -ay - by, left, right, low, high)
    area += _side(-ax - bx, -ay - by, ax - bx, ay - by, left, right, low, high)
    return area


@inner_njit
def _determinant(tetrahedron: Float64) -> float:
    """Six times the volume."""
    a, b, c = tetrahedron[1] - tetrahedron[0], tetrahedron[2] - tetrahedron[0], tetrahedron[3] - tetrahedron[0]
    return abs(
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0])
    )


@inner_njit
def _boxes(corners: Float64, half: Float64, stack: Float64, planes: Int64) -> float:
    """Volume that a box of eight corners shares with one along the axes: tetrahedra cut by its planes in turn."""
    for part in range(6):
        for vertex in range(4):
            stack[part, vertex] = corners[_TETRAHEDRA[part, vertex]]
        planes[part] = 0
    waiting, volume = 6, 0.0
    ordered = np.empty((4, 3))
    outside, beyond = np.empty(4), np.empty(4)
    cut = np.empty((2, 3, 3))
    while waiting:
        waiting -= 1
        plane = planes[waiting]
        if plane == 6:
            volume += _determinant(stack[waiting]) / 6.0
            continue
        axis, sign = plane // 2, 1.0 - 2.0 * (plane % 2)
        within = 0
        for vertex in range(4):
            beyond[vertex] = sign * stack[waiting, vertex, axis] - half[axis]
            within += beyond[vertex] <= 0.0
        if within == 0:
            continue
        if within == 4:
            planes[waiting] = plane + 1
            waiting += 1
            continue
        order = np.argsort(beyond)
        for vertex in range(4):
            ordered[vertex], outside[vertex] = stack[waiting, order[vertex]], beyond[order[vertex]]
        if within == 1:
            stack[waiting, 0] = ordered[0]
            for other in range(1, 4):
                stack[waiting, other] = _cut(ordered, outside, 0, other)
            planes[waiting] = plane + 1
            waiting += 1
            continue
        # What is left is a prism between two triangles.
        if within == 2:
            for end in range(2):
                cut[end, 0] = ordered[end]
                cut[end, 1], cut[end, 2] = _cut(ordered, outside, end, 2), _cut(ordered, outside, end, 3)
        else:
            for vertex in range(3):
                cut[0, vertex], cut[1, vertex] = ordered[vertex], _cut(ordered, outside, vertex, 3)
        for part in range(3):
            for vertex in range(4):
                end = int(vertex > 2 - part)
                stack[waiting, vertex] = cut[end, vertex - end]
            planes[waiting] = plane + 1
            waiting += 1
    return volume


@inner_njit
def _cut(ordered: Float64, outside: Float64, inner: int, outer: int) -> Float64:
    share = outside[inner] / (outside[inner] - outside[outer])
    return ordered[inner] + share * (ordered[outer] - ordered[inner])


@njit(cache=True, nogil=True)
def overlaps(
    rotation: Float64, translation: Float64, lwh: Float64, rotation2: Float64, translation2: Float64, lwh2: Float64
) -> tuple[Float64, Float64]:
    """Compute the intersection and union volumes of pairs of boxes, in cubes of each pair's longest side.

    Args:
        rotation: (N, 4) unit quaternions of the first boxes.
        translation: (N, 3) their centres.
        lwh: (N, 3) their sizes.
        rotation2: (N, 4) of the second boxes.
        translation2: (N, 3) their centres.
        lwh2: (N, 3) their sizes.

    Returns:
        (N,) intersections, (N,) unions.
    """
    count = len(lwh)
    intersection, union = np.zeros(count), np.zeros(count)
    stack, planes = np.empty((_WAITING, 4, 3)), np.empty(_WAITING, dtype=np.int64)
    corners, size, size2, offset = np.empty((8, 3)), np.empty(3), np.empty(3), np.empty(3)
    for pair in range(count):
        unit = 0.0
        for axis in range(3):
            unit = max(unit, lwh[pair, axis], lwh2[pair, axis])
        if unit == 0.0:
            continue
        reach, reach2, away = 0.0, 0.0, 0.0
        for axis in range(3):
            size[axis], size2[axis] = lwh[pair, axis] / unit, lwh2[pair, axis] / unit
            offset[axis] = (translation2[pair, axis] - translation[pair, axis]) / unit
            reach += size[axis] ** 2
            reach2 += size2[axis] ** 2
            away += offset[axis] ** 2
        volume, volume2 = size[0] * size[1] * size[2], size2[0] * size2[1] * size2[2]
        union[pair] = volume + volume2
        if volume == 0.0 or volume2 == 0.0 or math.sqrt(away) > 0.5 * (math.sqrt(reach) + math.sqrt(reach2)) * 1.000001:
            continue
        w, x, y, z = rotation[pair]
        w2, x2, y2, z2 = rotation2[pair]
        # The second box in the first one's frame; equal rotations cancel exactly.
        rw = (w * w2 + x * x2) + (y * y2 + z * z2)
        rx = (w * x2 - x * w2) - (y * z2 - z * y2)
        ry = (w * y2 - y * w2) - (z * x2 - x * z2)
        rz = (w * z2 - z * w2) - (x * y2 - y * x2)
        tx = 2.0 * (y * offset[2] - z * offset[1])
        ty = 2.0 * (z * offset[0] - x * offset[2])
        tz = 2.0 * (x * offset[1] - y * offset[0])
        dx = offset[0] - w * tx + (y * tz - z * ty)
        dy = offset[1] - w * ty + (z * tx - x * tz)
        dz = offset[2] - w * tz + (x * ty - y * tx)
        if math.hypot(rx, ry) <= _TILT:
            height = min(0.5 * size[2], dz + 0.5 * size2[2]) - max(-0.5 * size[2], dz - 0.5 * size2[2])
            if height <= 0.0:
                continue
            square = rw * rw + rz * rz
            cos, sin = (rw * rw - rz * rz) / square, 2.0 * rw * rz / square
            shared = _rectangles(dx, dy, cos, sin, size[0], size[1], size2[0], size2[1]) * height
        else:
            for corner in range(8):
                px = (0.5 if corner & 1 else -0.5) * size2[0]
                py = (0.5 if corner & 2 else -0.5) * size2[1]
                pz = (0.5 if corner & 4 else -0.5) * size2[2]
                ux, uy, uz = 2.0 * (ry * pz - rz * py), 2.0 * (rz * px - rx * pz), 2.0 * (rx * py - ry * px)
                corners[corner, 0] = dx + px + rw * ux + (ry * uz - rz * uy)
                corners[corner, 1] = dy + py + rw * uy + (rz * ux - rx * uz)
                corners[corner, 2] = dz + pz + rw * uz + (rx * uy - ry * ux)
            shared = _boxes(corners, 0.5 * size, stack, planes)
        # No more than either holds: what rounding may add.
        intersection[pair] = min(max(shared, 0.0), volume, volume2)
        union[pair] -= intersection[pair]
    return intersection, union
