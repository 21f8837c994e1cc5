"""What surfaces look like: the ground, the solids and the sky, as reflectance, emission and gloss."""

from __future__ import annotations

import math

from numba import njit

from mirror.arrays import Records
from mirror.synth.render.primitives import (
    BACK,
    BARK,
    BOTTOM,
    CONTAINER,
    FACADE,
    FRONT,
    GLASS,
    LAMP,
    LEAVES,
    PAINT,
    RIGHT,
    ROOF,
    SKYLINE,
    TOP,
    TYRE,
)
from mirror.synth.render.texture import band, chance, grain, noise, stripes

Look = tuple[float, float, float, float, float, float, float]
"""Reflectance of red, green and blue; emission of them; share of light that is mirrored at normal incidence."""


@njit(cache=True, nogil=True, error_model="numpy")
def ground(
    streets: Records,
    green: bool,
    seed: int,
    wet: float,
    x: float,
    y: float,
    dx: float,
    dy: float,
    near: float,
    far: float,
) -> Look:
    """The ground at (x, y).

    Args:
        streets: (N,) STREET.
        green: whether the land beside the streets is grass.
        seed: of the textures.
        wet: 0 dry, 1 wet.
        x: world metres.
        y: world metres.
        dx: horizontal viewing direction, unit.
        dy: horizontal viewing direction, unit.
        near: footprint of the pixel across that direction, metres.
        far: footprint along it.
    """
    rough = 1.0 + 0.10 * grain(x, y, 0.09, far, seed) + 0.10 * grain(x, y, 0.7, far, seed + 1)
    gap, own = 1e9, 0
    for index in range(len(streets)):
        street = streets[index]
        side = abs(street.direction_0 * (y - street.origin_1) - street.direction_1 * (x - street.origin_0))
        if side - street.half_road < gap:
            gap, own = side - street.half_road, index
    if gap > streets[own].pavement:
        if green:
            blade = 0.22 * grain(x, y, 0.25, far, seed + 3) + 0.25 * grain(x, y, 3.0, far, seed + 4)
            return 0.11 * (1.0 + blade), 0.19 * (1.0 + blade), 0.05 * (1.0 + blade), 0.0, 0.0, 0.0, 0.0
        slab = 0.30 * rough
        return slab, 0.97 * slab, 0.92 * slab, 0.0, 0.0, 0.0, 0.1 * wet
    if gap > 0.0:
        return _pavement(streets, seed, wet, x, y, dx, dy, near, far, gap, rough)
    tone = 0.098 * rough * (1.0 + 0.14 * grain(x, y, 9.0, far, seed + 2))
    if far < 0.3 and abs(grain(x, y, 2.7, far, seed + 5) - 0.35) < 0.018:
        tone *= 0.80
    white = _markings(streets, own, x, y, dx, dy, near, far)
    if white > 0.0:
        white *= 0.86 + 0.16 * grain(x, y, 0.5, far, seed + 6)
    tone = tone * (1.0 - 0.42 * wet) * (1.0 - white) + 0.66 * white * (1.0 - 0.2 * wet)
    puddle = wet * (0.75 + 0.25 * grain(x, y, 1.7, far, seed + 7)) if wet > 0.0 else 0.0
    return tone, tone, 1.02 * tone, 0.0, 0.0, 0.0, puddle


@njit(cache=True, nogil=True, error_model="numpy")
def _pavement(
    streets: Records,
    seed: int,
    wet: float,
    x: float,
    y: float,
    dx: float,
    dy: float,
    near: float,
    far: float,
    gap: float,
    rough: float,
) -> Look:
    wide = 0.5 * (near + far)
    curb = band(gap, 0.0, 0.16, wide)
    gutter = band(gap, 0.0, 0.03, wide)
    first = streets[0]
    along = first.direction_0 * x + first.direction_1 * y
    across = first.direction_0 * y - first.direction_1 * x
    c, s = (
        abs(first.direction_0 * dx + first.direction_1 * dy),
        abs(first.direction_0 * dy - first.direction_1 * dx),
    )
    joint = max(stripes(along, 0.9, 0.03, near * s + far * c), stripes(across, 0.9, 0.03, near * c + far * s))
    slab = chance(math.floor(along / 0.9), math.floor(across / 0.9), seed) if wide < 0.9 else 0.5
    tone = (0.30 + 0.05 * (slab - 0.5)) * rough * (1.0 - 0.35 * joint) * (1.0 - 0.3 * wet)
    tone = tone * (1.0 - curb) + 0.42 * curb
    tone *= 1.0 - 0.6 * gutter
    return tone, 0.985 * tone, 0.95 * tone, 0.0, 0.0, 0.0, 0.35 * wet


@njit(cache=True, nogil=True, error_model="numpy")
def _markings(streets: Records, own: int, x: float, y: float, dx: float, dy: float, near: float, far: float) -> float:
    """Share of white paint on a street: lane lines, stop lines and zebra crossings; none within a crossing."""
    street = streets[own]
    ux, uy = street.direction_0, street.direction_1
    along = ux * (x - street.origin_0) + uy * (y - street.origin_1)
    side = ux * (y - street.origin_1) - uy * (x - street.origin_0)
    gap, ahead = 1e9, True
    for other in range(len(streets)):
        crossing = streets[other]
        turn = crossing.direction_0 * uy - crossing.direction_1 * ux
        if abs(turn) > 0.5:
            off = crossing.direction_0 * (y - crossing.origin_1) - crossing.direction_1 * (x - crossing.origin_0)
            if abs(off) - crossing.half_road < gap:
                # Moving along the street changes ``off`` by ``turn`` a metre.
                gap, ahead = abs(off) - crossing.half_road, off * turn < 0.0
    if gap < 0.0:
        return 0.0
    c, s = abs(ux * dx + uy * dy), abs(ux * dy - uy * dx)
    fine, long = near * c + far * s, near * s + far * c
    aside = abs(side)
    if gap < 5.1 + long:
        zebra = band(gap, 0.9, 3.9, long) * stripes(side + 50.0, 1.0, 0.5, fine)
        # Traffic keeps right: it stops where the crossing lies ahead.
        if (side < 0.0) == ahead:
            zebra = max(zebra, band(gap, 4.7, 5.1, long) * band(aside, 0.25, street.lane_line, fine))
        if gap < 5.1 - long:
            return zebra
    else:
        zebra = 0.0
    if aside < 0.07 + fine:
        return max(zebra, band(aside, 0.0, 0.07, fine) * stripes(along, 7.0, 0.45, long))
    if abs(aside - street.lane_line) < 0.06 + fine:
        line = band(aside, street.lane_line - 0.06, street.lane_line + 0.06, fine)
        return max(zebra, line * stripes(along, 3.15, 0.6, long))
    return zebra


@njit(cache=True, nogil=True, error_model="numpy")
def surface(one: Records, face: int, px: float, py: float, pz: float, footprint: float, look: Records) -> Look:
    """A solid at a point (px, py, pz) of its own frame."""
    r, g, b = one.colour_0, one.colour_1, one.colour_2
    material, seed = one.material, one.seed
    if material == FACADE:
        return _facade(one, face, px, py, pz, footprint, look)
    if material == LEAVES:
        clump = (
            1.0
            + 0.45 * grain(px + pz, py - pz, 0.55, footprint, seed)
            + 0.35 * grain(px - py, pz, 0.17, footprint, seed)
        )
        autumn = look.season * chance(seed, 3, 1)
        r, g, b = r * (1 + 3.2 * autumn) * clump, g * (1 + 0.25 * autumn) * clump, b * clump
        return r, g, b, 0.0, 0.0, 0.0, 0.0
    if material == ROOF:
        tile = 1.0 - 0.22 * stripes(pz if face != TOP else px, 0.3, 0.2, footprint)
        return r * tile, g * tile, b * tile, 0.0, 0.0, 0.0, 0.03
    if material == BARK:
        rough = 1.0 + 0.3 * grain(px + py, pz * 0.2, 0.05, footprint, seed)
        return r * rough, g * rough, b * rough, 0.0, 0.0, 0.0, 0.0
    if material == SKYLINE:
        return _far_house(one, face, py, pz, footprint, look)
    if material == PAINT:
        return _paintwork(one, face, px, py, pz, look)
    if material == GLASS:
        up = (pz + one.half_2) / (2.0 * one.half_2)
        edge = one.half_0 - one.slope_0 * (pz + one.half_2)
        pillar = 0.0
        if face >= 2 and face < TOP:
            pillar = band(px, -0.18 * one.half_0 - 0.05, -0.18 * one.half_0 + 0.05, footprint) + band(
                px, edge - 0.12, edge, footprint
            )
        if face == TOP or pillar > 0.5 or up < 0.04:
            return r, g, b, 0.0, 0.0, 0.0, 0.05
        return 0.015, 0.018, 0.02, 0.0, 0.0, 0.0, 0.10
    if material == CONTAINER:
        rib = 1.0 - 0.12 * stripes(px if face >= 2 else py, 0.45, 0.12, footprint)
        return r * rib, g * rib, b * rib, 0.0, 0.0, 0.0, 0.03
    if material == TYRE and face >= 2 and face <= RIGHT:
        hub = math.sqrt(px * px + pz * pz) / one.half_0
        if hub < 0.62:
            spoke = 0.5 + 0.5 * math.cos(5.0 * math.atan2(pz, px))
            tone = 0.10 + 0.28 * spoke
            return tone, tone, tone, 0.0, 0.0, 0.0, 0.05
    if material == LAMP and face == BOTTOM:
        return r, g, b, 6.0 * look.lamp_light_0, 6.0 * look.lamp_light_1, 6.0 * look.lamp_light_2, 0.0
    return r, g, b, 0.0, 0.0, 0.0, 0.02


@njit(cache=True, nogil=True, error_model="numpy")
def _paintwork(one: Records, face: int, px: float, py: float, pz: float, look: Records) -> Look:
    """Bodywork with lamps, number plates and dark sills."""
    r, g, b = one.colour_0, one.colour_1, one.colour_2
    up, out = pz / one.half_2, abs(py) / one.half_1
    burn = look.dark if one.lights else 0.0
    if face in (FRONT, BACK):
        if up > 0.05 and up < 0.62 and out > 0.62 and out < 0.95:
            if face == FRONT:
                return 0.7, 0.7, 0.7, 5.0 * burn, 4.6 * burn, 3.9 * burn, 0.1
            return 0.36, 0.02, 0.02, 0.10 + 2.4 * burn, 0.06 * burn, 0.04 * burn, 0.1
        if up > -0.55 and up < -0.2 and abs(py) < 0.27:
            return 0.72, 0.72, 0.66, 0.02 * burn, 0.02 * burn, 0.02 * burn, 0.02
        if face == FRONT and up > -0.12 and up < 0.45 and out < 0.5:
            return 0.02, 0.02, 0.022, 0.0, 0.0, 0.0, 0.04
    if up < -0.68:
        return 0.03, 0.03, 0.03, 0.0, 0.0, 0.0, 0.01
    if face >= 2 and face < TOP:
        for axle in (0.62, -0.60):
            if (px - axle * one.half_0) ** 2 + (pz + one.half_2 - 0.14) ** 2 < 0.40**2:
                return 0.012, 0.012, 0.012, 0.0, 0.0, 0.0, 0.0
        seam = abs(px - 0.24 * one.half_0) < 0.012 or abs(px + 0.22 * one.half_0) < 0.012
        if seam and up > -0.6:
            return 0.4 * r, 0.4 * g, 0.4 * b, 0.0, 0.0, 0.0, 0.02
    return r, g, b, 0.0, 0.0, 0.0, 0.06


@njit(cache=True, nogil=True, error_model="numpy")
def _facade(one: Records, face: int, px: float, py: float, pz: float, footprint: float, look: Records) -> Look:
    """A wall of bricks or plaster with a grid of windows; shops or doors on the ground floor towards the street."""
    r, g, b = one.colour_0, one.colour_1, one.colour_2
    seed = one.seed
    if face in (TOP, BOTTOM):
        return 0.2, 0.2, 0.2, 0.0, 0.0, 0.0, 0.0
    side = face >= 2
    width = one.half_0 if side else one.half_1
    along = (px if side else py) + width
    up = pz + one.half_2
    rough = 1.0 + 0.06 * grain(along, up, 0.35, footprint, seed) + 0.06 * grain(along, up, 4.0, footprint, seed)
    if seed % 2 == 0:
        course = math.floor(up / 0.09)
        mortar = max(stripes(up, 0.09, 0.14, footprint), stripes(along + 0.13 * (course % 2), 0.26, 0.05, footprint))
        rough *= 1.0 - 0.30 * mortar
    r, g, b = r * rough, g * rough, b * rough
    columns = max(math.floor(2.0 * width / 3.0), 1.0)
    pitch = 2.0 * width / columns
    column = math.floor(along / pitch)
    inner = along - column * pitch
    if up < 3.9:
        return _ground_floor(one, face, inner, up, column, pitch, footprint, look, r, g, b)
    storey = math.floor((up - 3.9) / 3.1)
    high = up - 3.9 - 3.1 * storey
    broad = 0.52 + 0.2 * chance(seed, 5, 0)
    low, top = 0.75, 2.45
    if 3.9 + 3.1 * storey + top > 2.0 * one.half_2 - 0.3:
        return r, g, b, 0.0, 0.0, 0.0, 0.0
    aside, spread = inner - 0.5 * pitch, 0.5 * broad * pitch
    glass = band(aside, -spread, spread, footprint) * band(high, low, top, footprint)
    inside = band(aside, 0.08 - spread, spread - 0.08, footprint) * band(high, low + 0.08, top - 0.08, footprint)
    frame = glass * max(1.0 - inside, band(aside, -0.035, 0.035, footprint))
    sill = band(aside, -1.1 * spread, 1.1 * spread, footprint) * band(high, low - 0.14, low, footprint)
    cell = chance(int(column) + 31 * int(storey), face, seed)
    lit = 1.0 if cell < look.lit_windows else 0.0
    pane = max(glass - frame, 0.0)
    wall = 1.0 - min(glass + sill, 1.0)
    curtain = 0.25 + 0.35 * chance(int(column), int(storey), seed + 1) if cell > 0.55 else 0.03
    white = 0.55 * frame + 0.48 * sill
    warm = pane * lit * (0.75 + 0.5 * chance(int(column), int(storey), seed + 2))
    return (
        r * wall + white + pane * curtain * 0.9,
        g * wall + white + pane * curtain * 0.9,
        b * wall + white + pane * curtain,
        0.62 * warm,
        0.43 * warm,
        0.21 * warm,
        0.22 * pane,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _ground_floor(
    one: Records,
    face: int,
    inner: float,
    up: float,
    column: float,
    pitch: float,
    footprint: float,
    look: Records,
    r: float,
    g: float,
    b: float,
) -> Look:
    seed = one.seed
    plinth = band(up, 0.0, 0.5, footprint)
    r, g, b = r * (1.0 - 0.5 * plinth), g * (1.0 - 0.5 * plinth), b * (1.0 - 0.5 * plinth)
    if face != RIGHT or chance(seed, int(column), 9) < 0.25:
        door = band(inner, 0.5 * pitch - 0.55, 0.5 * pitch + 0.55, footprint) * band(up, 0.1, 2.4, footprint)
        if face != RIGHT or chance(seed, int(column), 8) < 0.5:
            door = 0.0
        return (
            r * (1.0 - door) + 0.10 * door,
            g * (1.0 - door) + 0.06 * door,
            b * (1.0 - door) + 0.04 * door,
            0.0,
            0.0,
            0.0,
            0.0,
        )
    sign = band(up, 2.95, 3.6, footprint) * band(inner, 0.2, pitch - 0.2, footprint)
    letters = band(up, 3.1, 3.45, footprint) * stripes(
        inner + 0.3 * chance(seed, int(column), 7), 0.38, 0.55, footprint
    )
    letters *= band(inner, 0.5, pitch - 0.5, footprint)
    glass = band(up, 0.55, 2.75, footprint) * band(inner, 0.25, pitch - 0.25, footprint)
    hue = chance(seed, int(column) // 2, 6)
    sr, sg, sb = 0.06 + 0.5 * hue * hue, 0.05 + 0.22 * (1.0 - hue), 0.06 + 0.34 * (1.0 - hue) ** 2
    glow = look.lit_windows * (0.9 if chance(seed, int(column) // 2, 5) < 0.7 else 0.15)
    wall = 1.0 - sign - glass
    ink = letters * sign
    shelf = 0.04 + 0.14 * band(up, 0.6, 1.4, footprint) * (0.5 + 0.5 * noise(inner * 3.0, up * 3.0, seed))
    return (
        r * wall + (sign - ink) * sr + 0.8 * ink + glass * shelf,
        g * wall + (sign - ink) * sg + 0.8 * ink + glass * shelf,
        b * wall + (sign - ink) * sb + 0.8 * ink + glass * shelf,
        glow * (0.95 * glass + 1.6 * ink + 1.2 * (sign - ink) * sr),
        glow * (0.78 * glass + 1.6 * ink + 1.2 * (sign - ink) * sg),
        glow * (0.5 * glass + 1.6 * ink + 1.2 * (sign - ink) * sb),
        0.18 * glass,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _far_house(one: Records, face: int, py: float, pz: float, footprint: float, look: Records) -> Look:
    r, g, b = one.colour_0, one.colour_1, one.colour_2
    if g > 1.2 * r:
        rough = 1.0 + 0.5 * grain(py, pz, 1.6, footprint, one.seed)
        return r * rough, g * rough, b * rough, 0.0, 0.0, 0.0, 0.0
    pane = stripes(py, 3.0, 0.55, footprint) * stripes(pz, 3.2, 0.55, footprint)
    lit = 1.0 if chance(math.floor(py / 3.0), math.floor(pz / 3.2), one.seed) < 0.8 * look.lit_windows else 0.0
    dim = 1.0 - 0.5 * pane
    return r * dim, g * dim, b * dim, 0.5 * pane * lit, 0.36 * pane * lit, 0.19 * pane * lit, 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def sky(look: Records, dx: float, dy: float, dz: float, seed: int) -> tuple[float, float, float]:
    """Radiance of the sky in a direction."""
    up = max(dz, 0.0)
    share = math.sqrt(up)
    r = look.horizon_0 + (look.zenith_0 - look.horizon_0) * share
    g = look.horizon_1 + (look.zenith_1 - look.horizon_1) * share
    b = look.horizon_2 + (look.zenith_2 - look.horizon_2) * share
    if up > 0.02:
        x, y = dx / (up + 0.12), dy / (up + 0.12)
        puff = 0.55 * noise(1.1 * x, 1.1 * y, seed) + 0.28 * noise(2.6 * x, 2.6 * y, seed + 1)
        puff += 0.14 * noise(6.0 * x, 6.0 * y, seed + 2)
        cover = (
            min(max((puff - 0.42 + 0.85 * look.cloud) * 2.2, 0.0), 1.0) * min(up * 6.0, 1.0) * (1.0 - 0.55 * look.cloud)
        )
        bright = 0.40 * (look.sky_light_0 + look.sky_light_1 + look.sky_light_2) + 0.30 * look.sunlight_1
        r, g, b = r + (bright - r) * cover, g + (bright - g) * cover, b + (1.02 * bright - b) * cover
    facing = dx * look.sun_0 + dy * look.sun_1 + dz * look.sun_2
    if facing > 0.0:
        low = 1.0 - min(abs(look.sun_2) * 2.0, 1.0)
        glow = facing**6 * 0.25 * low * (look.horizon_0 + look.horizon_1)
        disc = (facing**900) * 6.0 * (1.0 - look.cloud) if look.sunlight_0 > 0.0 else 0.0
        r += glow + disc * look.sunlight_0
        g += 0.75 * glow + disc * look.sunlight_1
        b += 0.45 * glow + disc * look.sunlight_2
    return r, g, b
