"""Which solid a ray meets: tiles of a picture choose the solids that they may see, rays try those nearest first."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from mirror.arrays import Float64, Int32, Int64, Records
from mirror.errors import UsageError
from mirror.geometry.cameras import Camera
from mirror.synth.render.primitives import meet, radius_m

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
    # One pixel more on every side: the rays between pixel centres are in the cone too.
    edge = ((1, down * TILE_PX - height + 1), (1, across * TILE_PX - width + 1), (0, 0))
    around = np.pad(rays.direction, edge, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(around, (TILE_PX + 2, TILE_PX + 2), axis=(0, 1))
    tiles = windows[::TILE_PX, ::TILE_PX].reshape(down, across, 3, -1)
    axis = tiles.mean(axis=3)
    axis /= np.linalg.norm(axis, axis=2, keepdims=True)
    cosine = np.einsum("ijk,ijkn->ijn", axis, tiles).min(axis=2)
    half = np.arccos(np.minimum(cosine, 1.0)) + _EDGE_PX / camera.fx_px
    cones = np.concatenate([axis, np.cos(half)[..., None], np.sin(half)[..., None]], axis=2)
    middle = rays.direction[height // 2, width // 2 - 1 : width // 2 + 1]
    return Lens(rays.direction, cones, float(np.arccos(middle[0] @ middle[1])))


class Sight(NamedTuple):
    """How N solids lie round a place.

    Attributes:
        away: (N, 3) unit directions of their centres.
        spread: (N, 2) cosine and sine of the half angles of cones that hold them; cosine -1 where that is every way.
        near: (N,) distances of the boxes round them.
        order: (N,) by those distances.
    """

    away: Float64
    spread: Float64
    near: Float64
    order: Int64


def sight(solids: Records, origin: Float64) -> Sight:
    """How solids (N,) SOLID lie round a place (3,)."""
    offset = solids["centre"] - origin
    far = np.linalg.norm(offset, axis=1)
    along = np.abs(np.einsum("nij,nj->ni", solids["axes"], offset))
    near = np.linalg.norm(np.maximum(along - solids["half"], 0.0), axis=1)
    radius = radius_m(solids)
    outside = far > radius
    sine = np.divide(radius, far, out=np.zeros(len(far)), where=outside)
    spread = np.stack([np.where(outside, np.sqrt(1.0 - sine * sine), -1.0), sine], axis=1)
    return Sight(offset / np.maximum(far, 1e-9)[:, None], spread, near, np.argsort(near, kind="stable"))


@njit(cache=True, nogil=True, error_model="numpy")
def choose(cones: Float64, rotation: Float64, away: Float64, spread: Float64, order: Int64) -> tuple[Int64, Int32]:
    """Solids that each tile may see, nearest first.

    A tile is a cone of directions and a solid is in a sphere: no solid that a tile sees is left out, whatever the lens.

    Returns:
        (tiles + 1,) where each tile's list starts; the lists.
    """
    down, across = cones.shape[:2]
    starts = np.zeros(down * across + 1, np.int64)
    lists = np.empty(down * across * len(order), np.int32)
    used = 0
    for tile in range(down * across):
        i, j = tile // across, tile % across
        x, y, z = turn(rotation, cones[i, j, 0], cones[i, j, 1], cones[i, j, 2])
        for place in range(len(order)):
            index = order[place]
            cosine = away[index, 0] * x + away[index, 1] * y + away[index, 2] * z
            # cos(a + b) of the cone's and the sphere's half angles; both are below 90 degrees.
            if (
                spread[index, 0] < 0.0
                or cosine >= cones[i, j, 3] * spread[index, 0] - cones[i, j, 4] * spread[index, 1]
            ):
                lists[used] = index
                used += 1
        starts[tile + 1] = used
    return starts, lists


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
