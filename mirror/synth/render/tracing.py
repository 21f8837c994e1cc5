"""One picture: every pixel's ray is cast and shaded, edges with three; then the picture is developed."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Bool, Float32, Float64, Int32, Int64, Records, UInt8
from mirror.synth.render.casting import TILE_PX, Lens, between, cast, choose, sight, turn
from mirror.synth.render.primitives import SOLID
from mirror.synth.render.shading import Surroundings, shade
from mirror.synth.render.texture import chance

_DRAWN_OUT_PX: Final = 5
_LEAST_SHARE: Final = 0.03
_CURVE: Final = 4096
_WHITE: Final = 5.0
_OFFSETS: Final = ((0.0, 0.0), (0.34, 0.22), (-0.34, -0.22))


def trace(scene: Surroundings, lens: Lens, rotation: Float64, origin: Float64) -> tuple[Float32, Float32, Int32]:
    """Trace one picture; pixels on edges get three rays.

    Args:
        scene: what there is to see.
        lens: the camera.
        rotation: (3, 3) world_R_camera.
        origin: (3,) the camera's place.

    Returns:
        (H, W, 4) radiance and mirror share; (H, W) distances along the rays; (H, W) solids, SKY or GROUND.
    """
    everywhere = np.ones(lens.rays.shape[:2], np.bool_)
    return _traced(scene, lens, rotation, origin, everywhere, with_ground=True, smooth=True)


def trace_mirrored(scene: Surroundings, lens: Lens, rotation: Float64, origin: Float64, share: Float32) -> Float32:
    """What the wet ground mirrors: the picture of a camera below it that looks up as the camera looks down.

    Args:
        scene: what there is to see.
        lens: the camera.
        rotation: (3, 3) world_R_camera of the camera itself.
        origin: (3,) its place.
        share: (H, W) how much each pixel mirrors; where none near does, nothing is traced.

    Returns:
        (H, W, 4) radiance, and 0.
    """
    import cv2

    flip = np.array([1.0, 1.0, -1.0])
    rows = np.ones((4 * _DRAWN_OUT_PX + 1, 1), np.uint8)
    wanted = cv2.dilate((share > _LEAST_SHARE).astype(np.uint8), rows).astype(np.bool_)
    turned = flip[:, None] * rotation
    return _traced(scene, lens, turned, flip * origin, wanted, with_ground=False, smooth=False)[0]


def seen_by(scene: Surroundings, lens: Lens, rotation: Float64, origin: Float64) -> Int32:
    """The solids (H, W) that a camera sees of those that there are, SKY where none: no ground, no light."""
    everywhere = np.ones(lens.rays.shape[:2], np.bool_)
    return _traced(scene, lens, rotation, origin, everywhere, with_ground=False, smooth=False)[2]


def _traced(
    scene: Surroundings,
    lens: Lens,
    rotation: Float64,
    origin: Float64,
    wanted: Bool,
    *,
    with_ground: bool,
    smooth: bool,
) -> tuple[Float32, Float32, Int32]:
    seen = sight(scene.solids.view(SOLID), origin)
    # Taken apart: the compiler's cache cannot read back functions of tuples whose class has changed since.
    return _trace(
        scene.streets, scene.solids, scene.still, scene.moving, scene.lamps, scene.below, scene.setting,
        lens.rays, lens.cones, lens.pixel_rad, seen.away, seen.spread, seen.near, seen.order,
        np.ascontiguousarray(rotation), origin, wanted, with_ground, smooth,
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _trace(
    streets: Records,
    solids: Records,
    still: Float32,
    moving: Float32,
    lamps: Float32,
    below: Float32,
    setting: Records,
    rays: Float64,
    cones: Float64,
    pixel_rad: float,
    away: Float64,
    spread: Float64,
    near: Float64,
    order: Int64,
    rotation: Float64,
    origin: Float64,
    wanted: Bool,
    with_ground: bool,
    smooth: bool,
) -> tuple[Float32, Float32, Int32]:
    height, width = rays.shape[:2]
    starts, lists = choose(cones, rotation, away, spread, order)
    picture = np.zeros((height, width, 4), np.float32)
    distance = np.empty((height, width), np.float32)
    seen = np.empty((height, width), np.int32)
    sides = np.empty((height, width), np.int32)
    ox, oy, oz = origin[0], origin[1], origin[2]
    down, across = cones.shape[:2]
    for tile in range(down * across):
        top, left = tile // across * TILE_PX, tile % across * TILE_PX
        candidates = lists[starts[tile] : starts[tile + 1]]
        for row in range(top, min(top + TILE_PX, height)):
            for column in range(left, min(left + TILE_PX, width)):
                if not wanted[row, column]:
                    continue
                dx, dy, dz = turn(rotation, rays[row, column, 0], rays[row, column, 1], rays[row, column, 2])
                t, found, face = cast(solids, candidates, near, with_ground, ox, oy, oz, dx, dy, dz)
                distance[row, column], seen[row, column], sides[row, column] = t, found, face
    for tile in range(down * across):
        top, left = tile // across * TILE_PX, tile % across * TILE_PX
        candidates = lists[starts[tile] : starts[tile + 1]]
        for row in range(top, min(top + TILE_PX, height)):
            for column in range(left, min(left + TILE_PX, width)):
                if not wanted[row, column]:
                    continue
                samples = len(_OFFSETS) if smooth and _is_edge(seen, sides, row, column) else 1
                t, found, face = distance[row, column], seen[row, column], sides[row, column]
                x, y, z = rays[row, column, 0], rays[row, column, 1], rays[row, column, 2]
                r, g, b, m = 0.0, 0.0, 0.0, 0.0
                for sample in range(samples):
                    if sample > 0:
                        x, y, z = between(rays, row, column, _OFFSETS[sample][0], _OFFSETS[sample][1])
                    dx, dy, dz = turn(rotation, x, y, z)
                    if sample > 0:
                        t, found, face = cast(solids, candidates, near, with_ground, ox, oy, oz, dx, dy, dz)
                    pr, pg, pb, pm = shade(
                        streets,
                        solids,
                        still,
                        moving,
                        lamps,
                        below,
                        setting,
                        pixel_rad,
                        t,
                        found,
                        face,
                        ox,
                        oy,
                        oz,
                        dx,
                        dy,
                        dz,
                    )
                    # Lamps are clipped before they are averaged, or their edges stay hard.
                    r, g, b, m = r + min(pr, 3.0), g + min(pg, 3.0), b + min(pb, 3.0), m + pm
                picture[row, column, 0], picture[row, column, 1] = r / samples, g / samples
                picture[row, column, 2], picture[row, column, 3] = b / samples, m / samples
    return picture, distance, seen


@njit(cache=True, nogil=True)
def _is_edge(seen: Int32, sides: Int32, row: int, column: int) -> bool:
    height, width = seen.shape
    here, side = seen[row, column], sides[row, column]
    for i, j in ((row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)):
        if 0 <= i < height and 0 <= j < width and (seen[i, j] != here or sides[i, j] != side):
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def develop(picture: Float32, reflection: Float32, look: Records, seed: int) -> UInt8:
    """Radiance (H, W, 4) to an 8-bit picture (H, W, 3), blue first: exposure, film curve, vignette, noise."""
    height, width = picture.shape[:2]
    out = np.empty((height, width, 3), np.uint8)
    wet = reflection.shape[0] == height
    curve = np.empty(_CURVE + 1, np.float32)
    for step in range(_CURVE + 1):
        curve[step] = 255.0 * (1.0 - math.exp(-_WHITE * step / _CURVE)) ** (1.0 / 1.95) + 0.5
    for row in range(height):
        v = (row + 0.5) / height - 0.5
        for column in range(width):
            u = (column + 0.5) / width - 0.5
            bright = look.exposure * (1.0 - 0.45 * (u * u + v * v)) * (_CURVE / _WHITE)
            mirror = picture[row, column, 3]
            noise = 255.0 * look.noise * (chance(row, column, seed) + chance(row, column, seed + 1) - 1.0)
            for channel in range(3):
                value = picture[row, column, channel]
                if wet and mirror > 0.0:
                    # Ripples and the roughness of the road draw a reflection out lengthwise.
                    drawn = 0.0
                    for step in range(-2, 3):
                        at = min(max(row + _DRAWN_OUT_PX * step, 0), height - 1)
                        drawn += reflection[at, column, channel]
                    value = value * (1.0 - 0.5 * mirror) + mirror * drawn / 5.0
                level = curve[int(min(value * bright, float(_CURVE)))] + noise
                out[row, column, 2 - channel] = int(min(max(level, 0.0), 255.0))
    return out
