"""Lighting of a surface point: sun, sky, lamps and headlights, reflected to the camera through haze."""

from __future__ import annotations

import math
from typing import Final

from mirror.arrays import Float32, Records
from mirror.compiled import inner_per_pixel
from mirror.portable import scalars
from mirror.synth.light.sky import sky
from mirror.synth.model import Label, Material
from mirror.synth.render.shadows import CELL_M, sun_visibility
from mirror.synth.render.surroundings import AMBIENT_OCCLUSION_CELL_M, GLOW_CELL_M, GROUND_CELL_M, LAMP_CELL_M

_GLASS_RAD: Final = 0.03
_PAINT_RAD: Final = 0.20
_SENT_BACK: Final = 5.0


@inner_per_pixel()
def read_map(value: Float32, column: float, row: float) -> float:
    """Interpolate a map bilinearly; 0 outside the map."""
    i, j = math.floor(row), math.floor(column)
    if not (0 <= j < value.shape[1] - 1 and 0 <= i < value.shape[0] - 1):
        return 0.0
    u, v = column - j, row - i
    before = (1 - u) * value[i, j] + u * value[i, j + 1]
    next_row = (1 - u) * value[i + 1, j] + u * value[i + 1, j + 1]
    return (1 - v) * before + v * next_row


@inner_per_pixel()
def _beam_at(setting: Records, maps: Records, x: float, y: float, z: float, nx: float, ny: float, nz: float) -> float:
    """Light from the recording vehicle's headlights."""
    vx, vy, vz = x - maps.beam_0, y - maps.beam_1, z - maps.beam_2
    far = math.sqrt(vx * vx + vy * vy + vz * vz) + 1e-6
    ahead = (vx * maps.beam_3 + vy * maps.beam_4 + vz * maps.beam_5) / far
    if ahead < 0.75:
        return 0.0
    faces = -(nx * vx + ny * vy + nz * vz) / far
    wide = (ahead - 0.75) / 0.25
    return setting.headlight * wide * wide * max(0.25 * faces + 0.12, 0.0) * 14.0 / (4.0 + 0.09 * far * far)


@inner_per_pixel(inline="always")
def shade_point(
    static_shadow: Float32,
    moving_shadow: Float32,
    lamps: Float32,
    glow: Float32,
    ambient_occlusion: Float32,
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
    """Compute the radiance of a surface point towards the camera, and the weight of the mirrored ray (wet ground).

    Args:
        static_shadow: shadow map of what never moves.
        moving_shadow: shadow map of road users and the recording vehicle.
        lamps: map of the street lamps' light over the ground.
        glow: map of the light of other vehicles' headlights over the ground.
        ambient_occlusion: share of the sky's light that road users keep from the ground.
        ground: map of the ground's heights.
        dome: radiance of the clear sky.
        clouds: density of the clouds.
        setting: LIGHTING, flat.
        maps: MAPS, flat.
        material: material of the surface.
        label: semantic class of the surface.
        t: distance from the camera, metres.
        x: the point, world metres.
        y: the point, world metres.
        z: the point, world metres.
        nx: unit normal towards the camera.
        ny: unit normal towards the camera.
        nz: unit normal towards the camera.
        dx: unit direction from the camera.
        dy: unit direction from the camera.
        dz: unit direction from the camera.
        fr: reflectance, red.
        fg: reflectance, green.
        fb: reflectance, blue.
        er: emission, red.
        eg: emission, green.
        eb: emission, blue.
        gloss: specular reflectance at normal incidence.
    """
    mirror, opening, above = 0.0, 1.0, 0.0
    facing = -(dx * nx + dy * ny + dz * nz)
    if label <= Label.TERRAIN:
        opening = 1.0 - read_map(
            ambient_occlusion,
            (x - maps.ambient_occlusion_origin_0) / AMBIENT_OCCLUSION_CELL_M,
            (y - maps.ambient_occlusion_origin_1) / AMBIENT_OCCLUSION_CELL_M,
        )
        if setting.wet > 0.0 and nz > 0.5:
            wet = setting.wet * (1.0 if label == Label.ROAD else 0.5 if label == Label.PAVEMENT else 0.0)
            fr, fg, fb = fr * (1.0 - 0.42 * wet), fg * (1.0 - 0.42 * wet), fb * (1.0 - 0.42 * wet)
            mirror = wet * (0.025 + 0.62 * (1.0 - facing) ** 6)
    else:
        # Less of the sky is visible from the foot of a wall.
        above = z - read_map(
            ground, (x - maps.ground_origin_0) / GROUND_CELL_M, (y - maps.ground_origin_1) / GROUND_CELL_M
        )
        opening = 0.72 + 0.28 * min(max(above / 4.0, 0.0), 1.0)
        if gloss > 0.0:
            polish = 1.0 if material == Material.PAINT or material == Material.GLASS else 0.3
            share = gloss + (1.0 - gloss) * (1.0 - max(facing, 0.0)) ** 5 * polish
            rz = dz + 2.0 * facing * nz
            rough = _PAINT_RAD if material == Material.PAINT else _GLASS_RAD
            sr, sg, sb = sky(dome, clouds, setting, dx + 2.0 * facing * nx, dy + 2.0 * facing * ny, abs(rz), rough)
            # Below the horizon the reflection shows the dark street; curved bodywork blurs the transition.
            share *= 0.25 + 0.60 * min(max(0.5 + 4.0 * rz, 0.0), 1.0)
            er, eg, eb = er + share * sr, eg + share * sg, eb + share * sb
    sun, lamplight, beam = 0.0, 0.0, 0.0
    if setting.sunlight_0 > 0.0:
        facing_sun = max(nx * setting.sun_0 + ny * setting.sun_1 + nz * setting.sun_2, 0.0)
        sun = facing_sun
        if material == Material.LEAVES:
            # Leaves transmit light.
            sun = 0.35 + 0.5 * sun
        if sun > 0.0:
            # An offset along the normal prevents self-shadowing at the map's resolution; larger for grazing sun.
            step = 0.06 + 0.14 * (1.0 - min(facing_sun, 1.0))
            sx, sy, sz = x + step * nx, y + step * ny, z + step * nz
            a = maps.sun_axes_00 * sx + maps.sun_axes_01 * sy + maps.sun_axes_02 * sz
            c = maps.sun_axes_10 * sx + maps.sun_axes_11 * sy + maps.sun_axes_12 * sz
            # The last term allows for the slope of a surface within a cell.
            height = sx * setting.sun_0 + sy * setting.sun_1 + sz * setting.sun_2 + 0.06
            if setting.shadows > 0.0:
                column, row = a - maps.static_shadow_origin_0, c - maps.static_shadow_origin_1
                sun *= sun_visibility(static_shadow, column / CELL_M, row / CELL_M, height)
                column, row = a - maps.moving_shadow_origin_0, c - maps.moving_shadow_origin_1
                sun *= sun_visibility(moving_shadow, column / CELL_M, row / CELL_M, height)
    if setting.lamp_light_0 > 0.0:
        at_x, at_y = x + 0.6 * nx - maps.lamps_origin_0, y + 0.6 * ny - maps.lamps_origin_1
        lamplight = read_map(lamps, at_x / LAMP_CELL_M, at_y / LAMP_CELL_M)
        lamplight *= 0.45 + 0.55 * nz if nz > 0.0 else 0.35
        if material == Material.PAINT:
            # Paint reflects most of the grazing light of lamps specularly, away from the camera.
            lamplight *= 0.55
    if setting.headlight > 0.0:
        beam = _beam_at(setting, maps, x, y, z, nx, ny, nz)
        column, row = (x - maps.glow_origin_0) / GLOW_CELL_M, (y - maps.glow_origin_1) / GLOW_CELL_M
        # Headlights shine on the ground and on low objects.
        upright = max(nz, 0.3) if label <= Label.TERRAIN else 0.3 * min(max(1.7 - above, 0.0), 1.0)
        beam += 0.5 * setting.headlight * read_map(glow, column, row) * upright
        if label == Label.TRAFFIC_SIGN:
            # Traffic signs are retroreflective.
            beam *= _SENT_BACK
    over, under = opening * (0.5 + 0.5 * nz), opening * (0.5 - 0.5 * nz)
    clear = scalars.exp(-t * setting.haze_per_m)
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
    # Haze has the colour of the sky above the horizon, which is brighter around the sun.
    glow_share = (0.5 + 0.5 * (dx * setting.sun_0 + dy * setting.sun_1)) ** 2
    dim = 1.0 - clear
    return (
        dim * (setting.horizon_away_0 + glow_share * setting.horizon_glow_0) + clear * r,
        dim * (setting.horizon_away_1 + glow_share * setting.horizon_glow_1) + clear * g,
        dim * (setting.horizon_away_2 + glow_share * setting.horizon_glow_2) + clear * b,
        mirror * clear,
    )
