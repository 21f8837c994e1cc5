"""What a ray brings back: sunlight and shadows, lamps, headlights, mirrored sky and haze."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from mirror.arrays import Float32, Records
from mirror.synth.lighting import LIGHTING
from mirror.synth.render.casting import GROUND, SKY
from mirror.synth.render.materials import ground, sky, surface
from mirror.synth.render.primitives import GLASS, PAINT, local, normal

SHADOW_CELL_M: Final = 0.2
LAMP_CELL_M: Final = 1.0
BELOW_CELL_M: Final = 0.2

SETTING: Final = np.dtype(
    [
        *LIGHTING.descr,
        ("sun_axes", np.float64, (2, 3)),
        ("still_origin", np.float64, 2),
        ("moving_origin", np.float64, 2),
        ("lamps_origin", np.float64, 2),
        ("below_origin", np.float64, 2),
        ("beam", np.float64, 6),
        ("green", np.int64),
        ("seed", np.int64),
    ]
)
"""LIGHTING, the axes across the sun's direction, the first cells' centres of the maps, the place and direction of the
recording vehicle's headlights, whether the land is grass, and the seed of textures."""


class Surroundings(NamedTuple):
    """All that a picture depends on besides its camera.

    Attributes:
        streets: (S,) STREET.
        solids: (N,) SOLID.
        still: (rows, columns) over the plane across the sun's direction: how far towards the sun the last solid that
            stands still reaches.
        moving: the same of all that moves.
        lamps: (rows, columns) over the ground: light of the street lamps.
        below: (rows, columns) over the ground: share of the sky's light that road users keep from it.
        setting: SETTING record.
    """

    streets: Records
    solids: Records
    still: Float32
    moving: Float32
    lamps: Float32
    below: Float32
    setting: Records


@njit(cache=True, nogil=True, error_model="numpy")
def _sunlit(depth: Float32, column: float, row: float, height: float) -> float:
    """Share of sunlight at a place of a shadow map: over its four nearest cells."""
    i, j = math.floor(row), math.floor(column)
    if not (0 <= j < depth.shape[1] - 1 and 0 <= i < depth.shape[0] - 1):
        return 1.0
    u, v = column - j, row - i
    before = (1 - u) * (depth[i, j] <= height) + u * (depth[i, j + 1] <= height)
    behind = (1 - u) * (depth[i + 1, j] <= height) + u * (depth[i + 1, j + 1] <= height)
    return (1 - v) * before + v * behind


@njit(cache=True, nogil=True, error_model="numpy")
def _read(value: Float32, column: float, row: float) -> float:
    """Bilinear value of a map; 0 outside."""
    i, j = math.floor(row), math.floor(column)
    if not (0 <= j < value.shape[1] - 1 and 0 <= i < value.shape[0] - 1):
        return 0.0
    u, v = column - j, row - i
    before = (1 - u) * value[i, j] + u * value[i, j + 1]
    behind = (1 - u) * value[i + 1, j] + u * value[i + 1, j + 1]
    return (1 - v) * before + v * behind


@njit(cache=True, nogil=True, error_model="numpy")
def _beam_at(setting: Records, x: float, y: float, z: float, nx: float, ny: float, nz: float) -> float:
    """Light of the recording vehicle's headlights."""
    vx, vy, vz = x - setting.beam_0, y - setting.beam_1, z - setting.beam_2
    far = math.sqrt(vx * vx + vy * vy + vz * vz) + 1e-6
    ahead = (vx * setting.beam_3 + vy * setting.beam_4 + vz * setting.beam_5) / far
    if ahead < 0.75:
        return 0.0
    facing = -(nx * vx + ny * vy + nz * vz) / far
    wide = (ahead - 0.75) / 0.25
    return setting.headlight * wide * wide * max(0.25 * facing + 0.12, 0.0) * 14.0 / (4.0 + 0.09 * far * far)


@njit(cache=True, nogil=True, error_model="numpy")
def shade(
    streets: Records,
    solids: Records,
    still: Float32,
    moving: Float32,
    lamps: Float32,
    below: Float32,
    look: Records,
    pixel_rad: float,
    t: float,
    found: int,
    face: int,
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
) -> tuple[float, float, float, float]:
    """Radiance along a ray, and how much of a mirrored ray's it adds (wet ground).

    The parts of the surroundings come one by one: taking an array out of a tuple costs two atomic counts a pixel.
    """
    if found == SKY:
        r, g, b = sky(look, dx, dy, dz, look.seed)
        return r, g, b, 0.0
    x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
    footprint = t * pixel_rad
    nx, ny, nz, opening, mirror = 0.0, 0.0, 1.0, 1.0, 0.0
    if found == GROUND:
        flat = math.sqrt(dx * dx + dy * dy) + 1e-9
        fr, fg, fb, er, eg, eb, gloss = ground(
            streets, look.green, look.seed, look.wet, x, y, dx / flat, dy / flat, footprint, -footprint / dz
        )
        opening = 1.0 - _read(below, (x - look.below_origin_0) / BELOW_CELL_M, (y - look.below_origin_1) / BELOW_CELL_M)
        mirror = gloss * (0.025 + 0.62 * (1.0 + dz) ** 6)
    else:
        one = solids[found]
        px, py, pz = local(one, x, y, z)
        fr, fg, fb, er, eg, eb, gloss = surface(one, face, px, py, pz, footprint, look)
        nx, ny, nz = normal(one, face, px, py, pz)
        # Less of the sky is open to the foot of a wall.
        opening = 0.72 + 0.28 * min(z / 4.0, 1.0)
        if gloss > 0.0:
            facing = -(dx * nx + dy * ny + dz * nz)
            polish = 1.0 if one.material == PAINT or one.material == GLASS else 0.3
            share = gloss + (1.0 - gloss) * (1.0 - facing) ** 5 * polish
            rz = dz + 2.0 * facing * nz
            sr, sg, sb = sky(look, dx + 2.0 * facing * nx, dy + 2.0 * facing * ny, abs(rz), look.seed)
            share *= 0.85 if rz > 0.0 else 0.25
            er, eg, eb = er + share * sr, eg + share * sg, eb + share * sb
    sun, lamp, beam = 0.0, 0.0, 0.0
    if look.sunlight_0 > 0.0:
        sun = max(nx * look.sun_0 + ny * look.sun_1 + nz * look.sun_2, 0.0)
        if sun > 0.0:
            # A step off the surface keeps it out of its own shadow at the map's resolution.
            sx, sy, sz = x + 0.12 * nx, y + 0.12 * ny, z + 0.12 * nz
            a = look.sun_axes_00 * sx + look.sun_axes_01 * sy + look.sun_axes_02 * sz
            c = look.sun_axes_10 * sx + look.sun_axes_11 * sy + look.sun_axes_12 * sz
            # A tenth of a metre covers the slant of a surface within a cell.
            height = sx * look.sun_0 + sy * look.sun_1 + sz * look.sun_2 + 0.10
            sun *= _sunlit(
                still, (a - look.still_origin_0) / SHADOW_CELL_M, (c - look.still_origin_1) / SHADOW_CELL_M, height
            )
            sun *= _sunlit(
                moving, (a - look.moving_origin_0) / SHADOW_CELL_M, (c - look.moving_origin_1) / SHADOW_CELL_M, height
            )
    if look.lamp_light_0 > 0.0:
        at_x, at_y = x + 0.6 * nx - look.lamps_origin_0, y + 0.6 * ny - look.lamps_origin_1
        lamp = _read(lamps, at_x / LAMP_CELL_M, at_y / LAMP_CELL_M)
        lamp *= (0.45 + 0.55 * nz if nz > 0.0 else 0.35) / (1.0 + 0.04 * z * z)
    if look.headlight > 0.0:
        beam = _beam_at(look, x, y, z, nx, ny, nz)
    above, under = opening * (0.5 + 0.5 * nz), opening * (0.5 - 0.5 * nz)
    clear = math.exp(-t * look.haze_per_m)
    r = er + fr * (
        sun * look.sunlight_0 + above * look.sky_light_0 + under * look.ground_light_0 + lamp * look.lamp_light_0 + beam
    )
    g = eg + fg * (
        sun * look.sunlight_1 + above * look.sky_light_1 + under * look.ground_light_1 + lamp * look.lamp_light_1 + beam
    )
    b = eb + fb * (
        sun * look.sunlight_2 + above * look.sky_light_2 + under * look.ground_light_2 + lamp * look.lamp_light_2 + beam
    )
    return (
        look.horizon_0 * (1.0 - clear) + clear * r,
        look.horizon_1 * (1.0 - clear) + clear * g,
        look.horizon_2 * (1.0 - clear) + clear * b,
        mirror * clear,
    )
