"""The appearance of vehicles: paint with seams and dust, transparent glass, wheels and lamps.

Every pattern consists of bands and stripes, averaged over the footprint ``fu`` by ``fv`` in closed form.
`mirror.synth.road_users.coachwork.sheets.Panel`, the ``layout`` of a face, defines u and v on paint and glass.
"""

from __future__ import annotations

import math

from mirror.arrays import Records
from mirror.compiled import inner_per_pixel, per_pixel
from mirror.portable import scalars
from mirror.synth.model import Material, Side
from mirror.synth.render.appearance import Appearance
from mirror.synth.render.texture import band, hash_unit, stripes
from mirror.synth.road_users.coachwork.sheets import Panel


@per_pixel()
def bodywork(face: Records, u: float, v: float, fu: float, fv: float, setting: Records) -> Appearance:
    """Evaluate the appearance of a face of PAINT, GLASS, RIM, HEADLIGHT, TAIL_LIGHT or RUBBER.

    Args:
        face: the face, FACE, flat.
        u: texture coordinate.
        v: texture coordinate.
        fu: width of the footprint in u.
        fv: height of the footprint in v.
        setting: LIGHTING, flat.
    """
    material = face.material
    if material == Material.PAINT:
        return _paint(face, u, v, fu, fv)
    if material == Material.GLASS:
        return _glass(face, u, v, fu, fv, setting)
    if material == Material.RIM:
        return _rim(face, u, v, 0.5 * (fu + fv))
    if material == Material.HEADLIGHT:
        return _headlight(face, u, v, fu, fv, setting)
    if material == Material.TAIL_LIGHT:
        return _tail_light(face, v, fv, setting)
    return face.colour_0, face.colour_1, face.colour_2, 0.0, 0.0, 0.0, 0.01


@inner_per_pixel()
def _line(x: float, at: float, half: float, footprint: float) -> float:
    return band(x, at - half, at + half, footprint)


@inner_per_pixel()
def _paint(face: Records, u: float, v: float, fu: float, fv: float) -> Appearance:
    r, g, b = face.colour_0, face.colour_1, face.colour_2
    panel = face.layout
    if panel == Panel.PLAIN:
        return r, g, b, 0.0, 0.0, 0.0, 0.05
    seam, handle, low, gloss = 0.0, 0.0, 0.0, 0.05
    if panel == Panel.ROW:
        seam = stripes(u + 0.006, 1.0, 0.012, fu)
        gloss = 0.015
    elif panel == Panel.WING:
        seam = _line(u, 0.0, 0.008, fu)
    elif panel >= Panel.TWO_DOORS:
        tall = band(v, -0.62, 0.0, fv)
        seam = _line(u, 0.0, 0.004, fu) + _line(u, 1.0, 0.004, fu)
        handle = band(u, 0.05, 0.22, fu) * band(v, -0.125, -0.095, fv)
        back = 0.0
        if panel == Panel.FOUR_DOORS:
            back = -1.0
            seam += _line(u, -1.0, 0.004, fu)
            handle += band(u, -0.94, -0.77, fu) * band(v, -0.125, -0.095, fv)
        elif panel == Panel.SLIDING_DOOR:
            back = -1.25
            seam += _line(u, -1.25, 0.006, fu)
            handle += band(u, -0.16, -0.06, fu) * band(v, -0.32, -0.12, fv)
            seam += band(u, -2.6, -1.25, fu) * _line(v, -0.22, 0.012, fv)
        seam = max(seam * tall, band(u, back, 1.0, fu) * _line(v, -0.62, 0.006, fv))
        # Below its crease a flank leans outwards and reflects the street instead of the sky.
        low = 0.14 * band(v, -0.50, -0.19, max(fv, 0.05)) + 0.05 * band(v, -0.70, -0.50, max(fv, 0.05))
    tone = (1.0 - low) * (1.0 - 0.75 * min(seam, 1.0)) * (1.0 - 0.35 * handle)
    dust = min(max(-v - 0.42, 0.0) * 2.0, 1.0)
    dust *= 0.45 * dust * (0.25 + 0.75 * hash_unit(face.seed, 1, 2))
    return (
        r * tone * (1.0 - dust) + 0.125 * dust,
        g * tone * (1.0 - dust) + 0.110 * dust,
        b * tone * (1.0 - dust) + 0.090 * dust,
        0.0,
        0.0,
        0.0,
        gloss * (1.0 - 0.8 * dust) * (1.0 - min(seam, 1.0)),
    )


@inner_per_pixel()
def _glass(face: Records, u: float, v: float, fu: float, fv: float, setting: Records) -> Appearance:
    """Tinted glass: between seats and pillars the street on the other side is visible."""
    panel = face.layout
    pillar, hidden = 0.0, 0.0
    if panel == Panel.FOUR_DOORS or panel == Panel.TWO_DOORS or panel == Panel.SLIDING_DOOR:
        pillar = _line(u, 0.0, 0.045, fu)
        hidden = _seat(u, v, 0.28, fu, fv)
        if panel != Panel.SLIDING_DOOR:
            hidden += _seat(u, v, -0.74, fu, fv)
        if panel == Panel.FOUR_DOORS:
            pillar += _line(u, -1.0, 0.03, fu)
        if face.lights:
            hidden = max(hidden, band(u, 0.32, 0.50, fu) * band(v, 0.0, 0.33, fv))
    elif panel == Panel.ROW:
        pillar = stripes(u + 0.03, 1.0, 0.06, fu)
        hidden = 0.8 * band(v, -9.0, -0.5 * face.half_1, fv)
    elif panel == Panel.PLAIN:
        hidden = _line(u, 0.36, 0.14, fu) + _line(u, -0.36, 0.14, fu)
        hidden = max(min(hidden, 1.0) * band(v, -9.0, 0.1, fv), band(v, -9.0, 0.12 - face.half_1, fv))
        if face.side == Side.BACK:
            hidden = min(hidden + 0.3, 1.0)
    else:
        hidden = 0.75
    clear = max(1.0 - pillar - min(hidden, 1.0), 0.0)
    transmitted = 0.03 * clear
    r, g, b = face.colour_0, face.colour_1, face.colour_2
    inside = 0.006 * min(hidden, 1.0)
    return (
        r + inside,
        g + inside,
        b + inside,
        transmitted * (0.6 * setting.horizon_0 + setting.ground_light_0),
        transmitted * (0.6 * setting.horizon_1 + setting.ground_light_1),
        transmitted * (0.6 * setting.horizon_2 + setting.ground_light_2),
        0.05,
    )


@inner_per_pixel()
def _seat(u: float, v: float, at: float, fu: float, fv: float) -> float:
    """Coverage by a backrest with its headrest, seen from the side."""
    return max(
        band(u, at - 0.16, at + 0.10, fu) * band(v, -9.0, 0.19, fv),
        band(u, at - 0.13, at + 0.02, fu) * band(v, 0.0, 0.34, fv),
    )


@inner_per_pixel()
def _rim(face: Records, u: float, v: float, footprint: float) -> Appearance:
    """A tyre and a rim of one of four kinds."""
    step = max(footprint / face.half_0, 1e-4)
    away = math.sqrt(u * u + v * v) / face.half_0
    wheel = band(away, -1.0, 0.74, step)
    if wheel <= 0.0:
        return 0.024, 0.024, 0.025, 0.0, 0.0, 0.0, 0.01
    kind = int(4.0 * hash_unit(face.seed, 7, 3))
    count, duty = 5.0, 0.42
    if kind == 1:
        count, duty = 10.0, 0.40
    elif kind == 2:
        count, duty = 7.0, 0.55
    elif kind == 3:
        count, duty = 16.0, 0.62
    # Spokes have a constant angle, so they become narrower towards the hub.
    turn = scalars.atan2(v, u) / (2.0 * math.pi) * count
    spokes = stripes(turn + 0.5 * duty, 1.0, duty, min(step * count / (2.0 * math.pi * max(away, 0.05)), 50.0))
    gap = (1.0 - spokes) * band(away, 0.20, 0.66, step)
    # The brake disc is visible between the spokes.
    disc = gap * band(away, 0.20, 0.45, step)
    metal = max(wheel - gap, 0.0) * (1.0 - 0.7 * band(away, 0.045, 0.085, step))
    tyre = 1.0 - wheel
    r = metal * face.colour_0 + 0.024 * tyre + 0.015 * gap + 0.05 * disc
    g = metal * face.colour_1 + 0.024 * tyre + 0.015 * gap + 0.05 * disc
    b = metal * face.colour_2 + 0.025 * tyre + 0.015 * gap + 0.05 * disc
    return r, g, b, 0.0, 0.0, 0.0, 0.06 * metal + 0.01


@inner_per_pixel()
def _headlight(face: Records, u: float, v: float, fu: float, fv: float, setting: Records) -> Appearance:
    """Two lenses in a dark housing above a daytime running light."""
    wide, high = u / face.half_0, v / face.half_1
    across, up = fu / face.half_0, fv / face.half_1
    strip = band(high, -0.85, -0.5, up)
    lens = (band(wide, -0.75, -0.2, across) + band(wide, 0.2, 0.75, across)) * band(high, -0.3, 0.75, up)
    tone = 0.10 + 0.55 * strip + 0.42 * lens
    burn = float(face.lights) * (
        strip * (0.7 + 1.5 * setting.vehicle_lights) + (7.0 * lens + 2.5) * setting.vehicle_lights
    )
    return (
        tone * face.colour_0, tone * face.colour_1, tone * face.colour_2, burn, 0.95 * burn, 0.84 * burn, 0.06,
    )  # fmt: skip


@inner_per_pixel()
def _tail_light(face: Records, v: float, fv: float, setting: Records) -> Appearance:
    """A red housing with a strip that emits light."""
    strip = band(v / face.half_1, -0.1, 0.6, fv / face.half_1)
    tone = 0.40 + 0.60 * strip
    burn = float(face.lights) * setting.vehicle_lights * (0.45 + 1.3 * strip)
    return (
        tone * face.colour_0, tone * face.colour_1, tone * face.colour_2, burn, 0.035 * burn, 0.025 * burn, 0.06,
    )  # fmt: skip
