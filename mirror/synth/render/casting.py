"""Which solid a ray meets: tiles of a picture choose the solids that they may see, rays try those nearest first."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from mirror.arrays import Float64, Int32, Int64, Records
from mirror.errors import UsageError
from mirror.geometry.cameras import Camera
from mirror.synth.render.primitives import meet

TILE_PX: Final = 16
SKY: Final = -1
GROUND: Final = -2
_EDGE_PX: Final = 1.0


class Lens(NamedTuple):
    """The rays of a camera.

    Attributes:
        rays: (H, W, 3) unit directions through the pixel centres, camera frame.
        cones: (tiles down, tiles across, 5) axis of each tile's cone, cosine and sine of its half angle.
        pixel_rad: angle between neighbouring rays in the middle.
    """

    rays: Float64
    cones: Float64
    pixel_rad: float


def make_lens(camera: Camera) -> Lens:
    """The rays of a camera, and a cone about each tile's.

    Raises:
        UsageError: the camera has a pixel that nothing is imaged at.
    """
    rays = camera.rays()
    if not rays.valid.all():
        row, column = np.argwhere(~rays.valid)[0]
        raise UsageError(f"no ray at pixel ({column}, {row})", expected="a lens that fills its raster")
    height, width = rays.direction.shape[:2]
    down, across = -(-height // TILE_PX), -(-width // TILE_PX)
    cones = np.empty((down, across, 5))
    for i in range(down):
        for j in range(across):
            # One pixel more on every side: the rays between pixel centres are in the cone too.
            rows = slice(max(i * TILE_PX - 1, 0), (i + 1) * TILE_PX + 1)
            columns = slice(max(j * TILE_PX - 1, 0), (j + 1) * TILE_PX + 1)
            inside = rays.direction[rows, columns].reshape(-1, 3)
            axis = inside.mean(axis=0)
            axis /= np.linalg.norm(axis)
            half = np.arccos(min(float((inside @ axis).min()), 1.0)) + _EDGE_PX / camera.fx_px
            cones[i, j] = *axis, np.cos(half), np.sin(half)
    middle = rays.direction[height // 2, width // 2 - 1 : width // 2 + 1]
    return Lens(rays.direction, cones, float(np.arccos(middle[0] @ middle[1])))


@njit(cache=True, nogil=True, error_model="numpy")
def choose(
    cones: Float64, rotation: Float64, origin: Float64, solids: Records, radii: Float64
) -> tuple[Int64, Int32, Float64]:
    """Solids that each tile may see, nearest first.

    A tile is a cone of directions and a solid is in a sphere: no solid that a tile sees is left out, whatever the lens.

    Returns:
        (tiles + 1,) where each tile's list starts; the lists; (N,) distances of the boxes round the solids.
    """
    count = len(solids)
    away = np.empty((count, 3))
    near = np.empty(count)
    spread = np.empty((count, 2))
    for index in range(count):
        one = solids[index]
        x, y, z = one.centre_0 - origin[0], one.centre_1 - origin[1], one.centre_2 - origin[2]
        far = math.sqrt(x * x + y * y + z * z)
        over_x = max(abs(one.axes_00 * x + one.axes_01 * y + one.axes_02 * z) - one.half_0, 0.0)
        over_y = max(abs(one.axes_10 * x + one.axes_11 * y + one.axes_12 * z) - one.half_1, 0.0)
        over_z = max(abs(one.axes_20 * x + one.axes_21 * y + one.axes_22 * z) - one.half_2, 0.0)
        near[index] = math.sqrt(over_x * over_x + over_y * over_y + over_z * over_z)
        away[index, 0], away[index, 1], away[index, 2] = x, y, z
        # A camera within the sphere may see the solid anywhere: the cone is all directions.
        spread[index, 0], spread[index, 1] = -1.0, 0.0
        if far > radii[index]:
            sine = radii[index] / far
            spread[index, 0], spread[index, 1] = math.sqrt(1.0 - sine * sine), sine
            for axis in range(3):
                away[index, axis] /= far
    order = np.argsort(near)
    down, across = cones.shape[:2]
    starts = np.zeros(down * across + 1, np.int64)
    lists = np.empty(32 * count + down * across, np.int32)
    used = 0
    for tile in range(down * across):
        cone = cones[tile // across, tile % across]
        x = rotation[0, 0] * cone[0] + rotation[0, 1] * cone[1] + rotation[0, 2] * cone[2]
        y = rotation[1, 0] * cone[0] + rotation[1, 1] * cone[1] + rotation[1, 2] * cone[2]
        z = rotation[2, 0] * cone[0] + rotation[2, 1] * cone[1] + rotation[2, 2] * cone[2]
        if used + count > len(lists):
            longer = np.empty(2 * len(lists) + count, np.int32)
            longer[:used] = lists[:used]
            lists = longer
        for index in order:
            cosine = away[index, 0] * x + away[index, 1] * y + away[index, 2] * z
            # cos(a + b) of the cone's and the sphere's half angles; both are below 90 degrees.
            if spread[index, 0] < 0.0 or cosine >= cone[3] * spread[index, 0] - cone[4] * spread[index, 1]:
                lists[used] = index
                used += 1
        starts[tile + 1] = used
    return starts, lists[:used], near


@njit(cache=True, nogil=True, error_model="numpy")
def cast(
    solids: Records,
    candidates: Int32,
    near: Float64,
    with_ground: bool,
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
) -> tuple[float, int, int]:
    """Distance, solid (or SKY, GROUND) and face that a ray meets first."""
    best, found, face = 1e9, SKY, 0
    if with_ground and dz < -1e-9:
        best, found = -oz / dz, GROUND
    for place in range(len(candidates)):
        index = candidates[place]
        if near[index] >= best:
            break
        t, side = meet(solids[index], ox, oy, oz, dx, dy, dz, best)
        if side >= 0:
            best, found, face = t, index, side
    return best, found, face


@njit(cache=True, nogil=True)
def turn(rotation: Float64, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector turned by a matrix (3, 3)."""
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
    )


@njit(cache=True, nogil=True)
def between(rays: Float64, row: int, column: int, du: float, dv: float) -> tuple[float, float, float]:
    """The ray beside a pixel's centre, along the chords to its neighbours."""
    height, width = rays.shape[:2]
    left, right = max(column - 1, 0), min(column + 1, width - 1)
    above, below = max(row - 1, 0), min(row + 1, height - 1)
    fu, fv = du / (right - left), dv / (below - above)
    x = rays[row, column, 0] + fu * (rays[row, right, 0] - rays[row, left, 0])
    y = rays[row, column, 1] + fu * (rays[row, right, 1] - rays[row, left, 1])
    z = rays[row, column, 2] + fu * (rays[row, right, 2] - rays[row, left, 2])
    x += fv * (rays[below, column, 0] - rays[above, column, 0])
    y += fv * (rays[below, column, 1] - rays[above, column, 1])
    z += fv * (rays[below, column, 2] - rays[above, column, 2])
    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
    return x * scale, y * scale, z * scale
