"""The light that a view's rays bring back: looks under sun, sky, lamps and headlights, seen through the air."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from mirror.arrays import Float32, Float64, Int32, Int64, Records, UInt8
from mirror.synth.light.sky import sky
from mirror.synth.model import Label, Material
from mirror.synth.render.coverage import SKY
from mirror.synth.render.facades import facade, shopfront, skyline, wall_grain
from mirror.synth.render.lens import TILE_PX
from mirror.synth.render.looks import lamp, picture, plain
from mirror.synth.render.shadows import CELL_M, sunlit
from mirror.synth.textures.sampling import grain_at, image_at

LAMP_CELL_M: Final = 1.0
BELOW_CELL_M: Final = 0.2
GROUND_CELL_M: Final = 2.0
_BRIGHTEST: Final = 4.0
_ROUGH_RAD: Final = 0.03

MAPS: Final = np.dtype(
    [
        ("sun_axes", np.float64, (2, 3)),
        ("still_origin", np.float64, 2),
        ("moving_origin", np.float64, 2),
        ("lamps_origin", np.float64, 2),
        ("below_origin", np.float64, 2),
        ("ground_origin", np.float64, 2),
        ("beam", np.float64, 6),
    ]
)
"""The axes across the sun's direction, the middles of the maps' first cells, and the place and direction of the
recording vehicle's headlights."""


class Surroundings(NamedTuple):
    """All that a picture depends on besides its camera.

    Attributes:
        faces: (F,) FACE, flat.
        corners: (C, 3).
        rounds: (R,) ROUND, flat.
        spheres: (F + R, 4) from `binning.spheres_of`.
        still: shadow map of what stands still.
        moving: shadow map of what moves.
        lamps: (rows, columns) over the ground: light of the street lamps.
        below: (rows, columns) over the ground: share of the sky's light that road users keep from it.
        ground: (rows, columns) heights of the ground.
        dome: of the clear sky.
        clouds: their field.
        layouts: (L, K) MARK, flat: markings of carriageways.
        setting: LIGHTING record, flat.
        maps: MAPS record, flat.
    """

    faces: Records
    corners: Float64
    rounds: Records
    spheres: Float64
    still: Float32
    moving: Float32
    lamps: Float32
    below: Float32
    ground: Float32
    dome: Float32
    clouds: Float32
    layouts: Records
    setting: Records
    maps: Records


@njit(cache=True, nogil=True, error_model="numpy")
def read(value: Float32, column: float, row: float) -> float:
    """Bilinear value of a map; 0 outside."""
    i, j = math.floor(row), math.floor(column)
    if not (0 <= j < value.shape[1] - 1 and 0 <= i < value.shape[0] - 1):
        return 0.0
    u, v = column - j, row - i
    before = (1 - u) * value[i, j] + u * value[i, j + 1]
    behind = (1 - u) * value[i + 1, j] + u * value[i + 1, j + 1]
    return (1 - v) * before + v * behind


@njit(cache=True, nogil=True, error_model="numpy")
def _beam_at(setting: Records, maps: Records, x: float, y: float, z: float, nx: float, ny: float, nz: float) -> float:
    """Light of the recording vehicle's headlights."""
    vx, vy, vz = x - maps.beam_0, y - maps.beam_1, z - maps.beam_2
    far = math.sqrt(vx * vx + vy * vy + vz * vz) + 1e-6
    ahead = (vx * maps.beam_3 + vy * maps.beam_4 + vz * maps.beam_5) / far
    if ahead < 0.75:
        return 0.0
    faces = -(nx * vx + ny * vy + nz * vz) / far
    wide = (ahead - 0.75) / 0.25
    return setting.headlight * wide * wide * max(0.25 * faces + 0.12, 0.0) * 14.0 / (4.0 + 0.09 * far * far)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def shade(
    faces: Records,
    rounds: Records,
    still: Float32,
    moving: Float32,
    lamps: Float32,
    below: Float32,
    ground: Float32,
    dome: Float32,
    clouds: Float32,
    setting: Records,
    maps: Records,
    grains: Float32,
    grain_index: Float64,
    images: UInt8,
    image_index: Int64,
    patterns: Records,
    index: int,
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
    ax: float,
    ay: float,
    az: float,
    bx: float,
    by: float,
    bz: float,
) -> tuple[float, float, float, float]:
    """Radiance along a ray, and how much of a mirrored ray's it adds (wet ground).

    Arrays come one by one: taking one out of a tuple costs two atomic counts a pixel.

    Args:
        index: of the surface that the ray meets, or SKY.
        ox: the camera's place.
        dx: the ray's unit direction.
        ax: how much the ray changes from a pixel to the next one on its right.
        bx: the same downwards.
    """
    if index == SKY:
        r, g, b = sky(dome, clouds, setting, dx, dy, dz, math.sqrt(ax * ax + ay * ay + az * az))
        return r, g, b, 0.0
    if index < len(faces):
        one = faces[index]
        nx, ny, nz = one.normal_0, one.normal_1, one.normal_2
        along = nx * dx + ny * dy + nz * dz
        t = (one.offset - nx * ox - ny * oy - nz * oz) / along
        x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
        # How far the place moves on the plane from pixel to pixel.
        slip = (nx * ax + ny * ay + nz * az) / along
        ax, ay, az = t * (ax - slip * dx), t * (ay - slip * dy), t * (az - slip * dz)
        slip = (nx * bx + ny * by + nz * bz) / along
        bx, by, bz = t * (bx - slip * dx), t * (by - slip * dy), t * (bz - slip * dz)
        if along > 0.0:
            nx, ny, nz = -nx, -ny, -nz
        u = one.u_axis_0 * x + one.u_axis_1 * y + one.u_axis_2 * z + one.u0
        v = one.v_axis_0 * x + one.v_axis_1 * y + one.v_axis_2 * z + one.v0
        u1 = one.u_axis_0 * ax + one.u_axis_1 * ay + one.u_axis_2 * az
        v1 = one.v_axis_0 * ax + one.v_axis_1 * ay + one.v_axis_2 * az
        u2 = one.u_axis_0 * bx + one.u_axis_1 * by + one.u_axis_2 * bz
        v2 = one.v_axis_0 * bx + one.v_axis_1 * by + one.v_axis_2 * bz
        material, label = one.material, one.label
        if (material == Material.IMAGE or material == Material.LIT_IMAGE) and one.image >= 0:
            fr, fg, fb, er, eg, eb, gloss = picture(images, image_index, one, u, v, u1, v1, u2, v2, setting)
        elif material >= Material.HEADLIGHT and material <= Material.SIGNAL:
            fr, fg, fb, er, eg, eb, gloss = lamp(one, setting)
        elif material == Material.FACADE:
            rough = grain_at(grains, grain_index, wall_grain(one, patterns), u, v, u1, v1, u2, v2)
            fr, fg, fb, er, eg, eb, gloss = facade(
                one, patterns, rough, u, v, abs(u1) + abs(u2), abs(v1) + abs(v2), setting
            )
        elif material == Material.SHOPFRONT:
            wide, high = 0.5 / one.half_0, 0.5 / one.half_1
            sr, sg, sb = image_at(
                images, image_index, one.image, 0.5 + u * wide, 0.5 + v * high,
                u1 * wide, v1 * high, u2 * wide, v2 * high,
            )  # fmt: skip
            fr, fg, fb, er, eg, eb, gloss = shopfront(
                one, sr, sg, sb, u, v, abs(u1) + abs(u2), abs(v1) + abs(v2), setting
            )
        elif material == Material.SKYLINE:
            fr, fg, fb, er, eg, eb, gloss = skyline(one, u, v, abs(u1) + abs(u2), abs(v1) + abs(v2))
        else:
            fr, fg, fb, er, eg, eb, gloss = plain(
                grains, grain_index, material, one.seed, (one.colour_0, one.colour_1, one.colour_2),
                u, v, u1, v1, u2, v2,
            )  # fmt: skip
    else:
        ball = rounds[index - len(faces)]
        material, label = ball.material, ball.label
        x, y, z = ox - ball.centre_0, oy - ball.centre_1, oz - ball.centre_2
        hx, hy, hz = 1.0 / ball.half_0, 1.0 / ball.half_1, 1.0 / ball.half_2
        px = (ball.axes_00 * x + ball.axes_01 * y + ball.axes_02 * z) * hx
        py = (ball.axes_10 * x + ball.axes_11 * y + ball.axes_12 * z) * hy
        pz = (ball.axes_20 * x + ball.axes_21 * y + ball.axes_22 * z) * hz
        vx = (ball.axes_00 * dx + ball.axes_01 * dy + ball.axes_02 * dz) * hx
        vy = (ball.axes_10 * dx + ball.axes_11 * dy + ball.axes_12 * dz) * hy
        vz = (ball.axes_20 * dx + ball.axes_21 * dy + ball.axes_22 * dz) * hz
        qa, qb = vx * vx + vy * vy + vz * vz, px * vx + py * vy + pz * vz
        qc = px * px + py * py + pz * pz - 1.0
        # A mean of rays beside the edge may miss it by a little: then it touches.
        t = (-qb - math.sqrt(max(qb * qb - qa * qc, 0.0))) / qa
        px, py, pz = px + t * vx, py + t * vy, pz + t * vz
        nx = ball.axes_00 * px * hx + ball.axes_10 * py * hy + ball.axes_20 * pz * hz
        ny = ball.axes_01 * px * hx + ball.axes_11 * py * hy + ball.axes_21 * pz * hz
        nz = ball.axes_02 * px * hx + ball.axes_12 * py * hy + ball.axes_22 * pz * hz
        scale = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx * scale, ny * scale, nz * scale
        x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
        wide = t * math.sqrt(ax * ax + ay * ay + az * az)
        if ball.image >= 0 and px > 0.0:
            step = 0.5 * wide
            fr, fg, fb = image_at(
                images, image_index, ball.image, 0.5 + 0.5 * py, 0.5 + 0.5 * pz, step * hy, 0.0, 0.0, step * hz
            )
            er, eg, eb, gloss = 0.0, 0.0, 0.0, 0.01
        else:
            fr, fg, fb, er, eg, eb, gloss = plain(
                grains, grain_index, material, ball.seed, (ball.colour_0, ball.colour_1, ball.colour_2),
                x + y, z + 0.5 * (x - y), wide, 0.0, 0.0, wide,
            )  # fmt: skip
    return _lit(
        still, moving, lamps, below, ground, dome, clouds, setting, maps, material, label, t, x, y, z, nx, ny, nz, dx, dy, dz,
        fr, fg, fb, er, eg, eb, gloss,
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _lit(
    still: Float32,
    moving: Float32,
    lamps: Float32,
    below: Float32,
    ground: Float32,
    dome: Float32,
    clouds: Float32,
    setting: Records,
    maps: Records,
    material: int,
    label: int,
    t: float,
    x: float,
    y: float,
    z: float,
    nx: float,
    ny: float,
    nz: float,
    dx: float,
    dy: float,
    dz: float,
    fr: float,
    fg: float,
    fb: float,
    er: float,
    eg: float,
    eb: float,
    gloss: float,
) -> tuple[float, float, float, float]:
    mirror, opening = 0.0, 1.0
    facing = -(dx * nx + dy * ny + dz * nz)
    if label <= Label.TERRAIN:
        opening = 1.0 - read(below, (x - maps.below_origin_0) / BELOW_CELL_M, (y - maps.below_origin_1) / BELOW_CELL_M)
        if setting.wet > 0.0 and nz > 0.5:
            wet = setting.wet * (1.0 if label == Label.ROAD else 0.5 if label == Label.PAVEMENT else 0.0)
            fr, fg, fb = fr * (1.0 - 0.42 * wet), fg * (1.0 - 0.42 * wet), fb * (1.0 - 0.42 * wet)
            mirror = wet * (0.025 + 0.62 * (1.0 - facing) ** 6)
    else:
        # Less of the sky is open to the foot of a wall.
        above = z - read(ground, (x - maps.ground_origin_0) / GROUND_CELL_M, (y - maps.ground_origin_1) / GROUND_CELL_M)
        opening = 0.72 + 0.28 * min(max(above / 4.0, 0.0), 1.0)
        if gloss > 0.0:
            polish = 1.0 if material == Material.PAINT or material == Material.GLASS else 0.3
            share = gloss + (1.0 - gloss) * (1.0 - max(facing, 0.0)) ** 5 * polish
            rz = dz + 2.0 * facing * nz
            sr, sg, sb = sky(dome, clouds, setting, dx + 2.0 * facing * nx, dy + 2.0 * facing * ny, abs(rz), _ROUGH_RAD)
            share *= 0.85 if rz > 0.0 else 0.25
            er, eg, eb = er + share * sr, eg + share * sg, eb + share * sb
    sun, lamplight, beam = 0.0, 0.0, 0.0
    if setting.sunlight_0 > 0.0:
        sun = max(nx * setting.sun_0 + ny * setting.sun_1 + nz * setting.sun_2, 0.0)
        if material == Material.LEAVES:
            # Leaves let light through.
            sun = 0.35 + 0.5 * sun
        if sun > 0.0:
            # A step off the surface keeps it out of its own shadow at the map's resolution.
            sx, sy, sz = x + 0.07 * nx, y + 0.07 * ny, z + 0.07 * nz
            a = maps.sun_axes_00 * sx + maps.sun_axes_01 * sy + maps.sun_axes_02 * sz
            c = maps.sun_axes_10 * sx + maps.sun_axes_11 * sy + maps.sun_axes_12 * sz
            # The slant of a surface within a cell.
            height = sx * setting.sun_0 + sy * setting.sun_1 + sz * setting.sun_2 + 0.06
            if setting.shadows > 0.0:
                column, row = a - maps.still_origin_0, c - maps.still_origin_1
                sun *= sunlit(still, column / CELL_M, row / CELL_M, height)
                column, row = a - maps.moving_origin_0, c - maps.moving_origin_1
                sun *= sunlit(moving, column / CELL_M, row / CELL_M, height)
    if setting.lamp_light_0 > 0.0:
        at_x, at_y = x + 0.6 * nx - maps.lamps_origin_0, y + 0.6 * ny - maps.lamps_origin_1
        lamplight = read(lamps, at_x / LAMP_CELL_M, at_y / LAMP_CELL_M)
        lamplight *= 0.45 + 0.55 * nz if nz > 0.0 else 0.35
    if setting.headlight > 0.0:
        beam = _beam_at(setting, maps, x, y, z, nx, ny, nz)
    over, under = opening * (0.5 + 0.5 * nz), opening * (0.5 - 0.5 * nz)
    clear = math.exp(-t * setting.haze_per_m)
    r = er + fr * (
        sun * setting.sunlight_0 + over * setting.sky_light_0 + under * setting.ground_light_0
        + lamplight * setting.lamp_light_0 + beam
    )  # fmt: skip
    g = eg + fg * (
        sun * setting.sunlight_1 + over * setting.sky_light_1 + under * setting.ground_light_1
        + lamplight * setting.lamp_light_1 + beam
    )  # fmt: skip
    b = eb + fb * (
        sun * setting.sunlight_2 + over * setting.sky_light_2 + under * setting.ground_light_2
        + lamplight * setting.lamp_light_2 + beam
    )  # fmt: skip
    return (
        setting.horizon_0 * (1.0 - clear) + clear * r,
        setting.horizon_1 * (1.0 - clear) + clear * g,
        setting.horizon_2 * (1.0 - clear) + clear * b,
        mirror * clear,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def radiance_of(
    faces: Records,
    rounds: Records,
    still: Float32,
    moving: Float32,
    lamps: Float32,
    below: Float32,
    ground: Float32,
    dome: Float32,
    clouds: Float32,
    setting: Records,
    maps: Records,
    grains: Float32,
    grain_index: Float64,
    images: UInt8,
    image_index: Int64,
    patterns: Records,
    rays: Float64,
    rotation: Float64,
    origin: Float64,
    offset: Float32,
    scale: float,
    centre: Int32,
    mixed: UInt8,
    which: Int32,
    share: Float32,
    wanted: Float32,
) -> Float32:
    """Radiance of a picture, from what `coverage.cover` found.

    Args:
        rays: (H, W, 3) of the lens.
        rotation: (3, 3) world_R_camera.
        origin: (3,) the camera's place.
        offset: (2,) of the ray that ``centre`` was found with, pixels.
        scale: width of the footprint that is averaged over, pixels.
        centre: from `cover`.
        mixed: from `cover`.
        which: from `cover`.
        share: from `cover`.
        wanted: as `cover` was given.

    Returns:
        (H, W, 4) red, green, blue, and how much a mirrored picture adds.
    """
    height, width = rays.shape[:2]
    out = np.zeros((height, width, 4), np.float32)
    ox, oy, oz = origin[0], origin[1], origin[2]
    at = 0
    for top in range(0, height, TILE_PX):
        for left in range(0, width, TILE_PX):
            bottom, right = min(top + TILE_PX, height) - 1, min(left + TILE_PX, width) - 1
            ax, ay, az, bx, by, bz = _steps(rays, rotation, top, left, bottom, right)
            for row in range(top, bottom + 1):
                for column in range(left, right + 1):
                    if wanted.shape[0] > 0 and wanted[row, column] <= 0.0:
                        while at < len(which) and which[at, 0] == row * width + column:
                            at += 1
                        continue
                    i, j, k = rays[row, column, 0], rays[row, column, 1], rays[row, column, 2]
                    x = rotation[0, 0] * i + rotation[0, 1] * j + rotation[0, 2] * k
                    y = rotation[1, 0] * i + rotation[1, 1] * j + rotation[1, 2] * k
                    z = rotation[2, 0] * i + rotation[2, 1] * j + rotation[2, 2] * k
                    r, g, b, m = 0.0, 0.0, 0.0, 0.0
                    first, last = at, at + 1
                    if mixed[row, column]:
                        while last < len(which) and which[last, 0] == which[first, 0]:
                            last += 1
                        at = last
                    for piece in range(first, last):
                        index, weight, u, v = centre[row, column], 1.0, offset[0], offset[1]
                        if mixed[row, column]:
                            index, weight, u, v = which[piece, 1], share[piece, 0], share[piece, 1], share[piece, 2]
                        dx, dy, dz = x + u * ax + v * bx, y + u * ay + v * by, z + u * az + v * bz
                        pr, pg, pb, pm = shade(
                            faces, rounds, still, moving, lamps, below, ground, dome, clouds, setting, maps,
                            grains, grain_index, images, image_index, patterns, index, ox, oy, oz, dx, dy, dz,
                            scale * ax, scale * ay, scale * az, scale * bx, scale * by, scale * bz,
                        )  # fmt: skip
                        # Lamps are clipped before they are averaged, or their edges stay hard.
                        r += weight * min(pr, _BRIGHTEST)
                        g += weight * min(pg, _BRIGHTEST)
                        b += weight * min(pb, _BRIGHTEST)
                        m += weight * pm
                    out[row, column, 0], out[row, column, 1], out[row, column, 2] = r, g, b
                    out[row, column, 3] = m
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _steps(
    rays: Float64, rotation: Float64, top: int, left: int, bottom: int, right: int
) -> tuple[float, float, float, float, float, float]:
    """How much a tile's rays change from pixel to pixel, rightwards and downwards, in the world."""
    row, column = (top + bottom) // 2, (left + right) // 2
    over, under = (left, right) if right > left else (max(left - 1, 0), right)
    above, below = (top, bottom) if bottom > top else (max(top - 1, 0), bottom)
    a, b = np.zeros(3), np.zeros(3)
    for axis in range(3):
        for k in range(3):
            a[axis] += rotation[axis, k] * (rays[row, under, k] - rays[row, over, k]) / max(under - over, 1)
            b[axis] += rotation[axis, k] * (rays[below, column, k] - rays[above, column, k]) / max(below - above, 1)
    return a[0], a[1], a[2], b[0], b[1], b[2]
