"""The appearance of carriageways: asphalt with repairs, cracks and manhole covers, and the markings of the layout.

Markings are stripes within rectangles. The share of a footprint ``fu`` by ``fv`` that a mark covers has a closed form,
so lines of a few centimetres fade with distance without flicker.
"""

from __future__ import annotations

import math
from typing import Final

from mirror.arrays import Records
from mirror.compiled import inner_per_pixel, per_pixel
from mirror.synth.render.appearance import Appearance
from mirror.synth.render.texture import band, grain, hash_unit, noise

_BED_U_M: Final = 13.0
_BED_V_M: Final = 3.4
_PATCHED: Final = 0.10
_CRACK_M: Final = 2.3
_CRACK_HALF: Final = 0.005
_COVER_U_M: Final = 23.0
_COVER_RADIUS_M: Final = 0.33


@inner_per_pixel(inline="always")
def _striped_length(x: float, period: float, duty: float) -> float:
    """Total length of the stripes between 0 and x."""
    periods = math.floor(x / period)
    return period * (periods * duty + min(x / period - periods, duty))


@per_pixel(inline="always")
def stripe_share(x: float, width: float, low: float, high: float, period: float, duty: float, phase: float) -> float:
    """Return the share of the interval of ``width`` about x that lies on stripes between ``low`` and ``high``.

    Args:
        x: middle of the interval, metres.
        width: width of the interval, metres; above 0.
        low: lower end of the striped range.
        high: upper end of the striped range.
        period: period of the stripes; 0: the whole range is one stripe.
        duty: share of the period that a stripe fills.
        phase: start of one stripe.
    """
    start, end = max(x - 0.5 * width, low), min(x + 0.5 * width, high)
    if end <= start:
        return 0.0
    if period <= 0.0:
        return (end - start) / width
    return max(_striped_length(end - phase, period, duty) - _striped_length(start - phase, period, duty), 0.0) / width


@per_pixel()
def mark_share(mark: Records, u: float, v: float, fu: float, fv: float) -> float:
    """Return the share of a footprint that a MARK covers."""
    across = stripe_share(v, fv + mark.soft, mark.v_low, mark.v_high, mark.v_period, mark.v_duty, mark.v_phase)
    if across <= 0.0:
        return 0.0
    # Over the footprint's height a slanted stripe shifts along u.
    wide = fu + abs(mark.slant) * fv
    return across * stripe_share(
        u, wide, mark.u_low, mark.u_high, mark.u_period, mark.u_duty, mark.u_phase + mark.slant * v
    )


@per_pixel()
def carriageway(face: Records, layouts: Records, rough: float, u: float, v: float, fu: float, fv: float) -> Appearance:
    """Evaluate the appearance of a carriageway at a point.

    Args:
        face: the face, FACE, flat.
        layouts: (L, K) MARK.
        rough: filtered value of the asphalt's grain at the point.
        u: metres along the street.
        v: metres to the left of the street's middle.
        fu: width of the footprint along u, metres.
        fv: width of the footprint along v, metres.
    """
    fu, fv = max(fu, 1e-4), max(fv, 1e-4)
    tone = rough * _worn_tone(face.seed, u, v, fu, fv)
    r, g, b = face.colour_0 * tone, face.colour_1 * tone, face.colour_2 * tone
    layout, wide = face.layout, max(fu, fv)
    # The grain of the asphalt shows through the paint.
    paint, rubbed = 0.35 + 0.65 * rough, -1.0
    for place in range(layouts.shape[1]):
        mark = layouts[layout, place]
        if mark.strength <= 0.0:
            break
        part = mark_share(mark, u, v, fu, fv)
        if part > 0.0:
            if rubbed < 0.0:
                rubbed = (
                    0.5 + 0.45 * grain(u, v, 0.31, wide, face.seed + 11) + 0.45 * grain(u, v, 2.3, wide, face.seed + 12)
                )
                rubbed = min(max(rubbed, 0.0), 1.0)
            part *= mark.strength * (1.0 - mark.worn * rubbed)
            r += part * (mark.red * paint - r)
            g += part * (mark.green * paint - g)
            b += part * (mark.blue * paint - b)
    return r, g, b, 0.0, 0.0, 0.0, 0.0


@inner_per_pixel()
def _worn_tone(seed: int, u: float, v: float, fu: float, fv: float) -> float:
    """Factor of the asphalt's reflectance from repairs, cracks and manhole covers."""
    wide = max(fu, fv)
    tone = 1.0
    if wide < 0.5 * _BED_V_M:
        tone *= _patch_tone(seed, u, v, fu, fv)
    if wide < 0.25:
        tone *= _crack_tone(seed, u, v, wide)
    if wide < _COVER_RADIUS_M:
        cell = math.floor(u / _COVER_U_M)
        luck = hash_unit(cell, 3, seed)
        if luck < 0.5:
            # The lower digits of the random number set the position of the cover.
            du = u - (cell + 0.1 + 0.8 * (64.0 * luck - math.floor(64.0 * luck))) * _COVER_U_M
            dv = v - 4.4 * (4096.0 * luck - math.floor(4096.0 * luck) - 0.5)
            away = math.sqrt(du * du + dv * dv)
            disc = min(max((_COVER_RADIUS_M - away) / wide + 0.5, 0.0), 1.0)
            ring = min(max(1.0 - abs(away - _COVER_RADIUS_M) / (0.03 + wide), 0.0), 1.0) * 0.03 / (0.03 + wide)
            tone *= (1.0 - 0.3 * disc) * (1.0 - 0.6 * ring)
    return tone


@inner_per_pixel()
def _crack_tone(seed: int, u: float, v: float, wide: float) -> float:
    """Factor from jagged cracks: contour lines of a noise, displaced by other noise."""
    strength = noise(u / 17.0, v / 6.0, seed + 8) - 0.15
    if strength <= 0.0:
        return 1.0
    jag = 0.20 * noise(u / 0.37, v / 0.37, seed + 6) + 0.07 * noise(u / 0.11, v / 0.11, seed + 7)
    away = abs(noise((u + jag) / _CRACK_M, (v - jag) / _CRACK_M, seed + 5) - 0.25)
    half = _CRACK_HALF + 0.45 * wide / _CRACK_M
    return 1.0 - min(2.0 * strength, 0.6) * max(1.0 - away / half, 0.0) * _CRACK_HALF / half


@inner_per_pixel()
def _patch_tone(seed: int, u: float, v: float, fu: float, fv: float) -> float:
    """Factor from rectangular patches of newer or older asphalt with a dark seam."""
    i, j = math.floor(u / _BED_U_M), math.floor(v / _BED_V_M)
    if hash_unit(i, j, seed + 21) >= _PATCHED:
        return 1.0
    length, breadth = (
        _BED_U_M * (0.2 + 0.7 * hash_unit(i, j, seed + 22)),
        _BED_V_M * (0.3 + 0.6 * hash_unit(i, j, seed + 23)),
    )
    left = _BED_U_M * i + (_BED_U_M - length) * hash_unit(i, j, seed + 24)
    low = _BED_V_M * j + (_BED_V_M - breadth) * hash_unit(i, j, seed + 25)
    inside = band(u, left, left + length, fu) * band(v, low, low + breadth, fv)
    if inside <= 0.0:
        return 1.0
    inner = band(u, left + 0.04, left + length - 0.04, fu) * band(v, low + 0.04, low + breadth - 0.04, fv)
    change = 0.80 if hash_unit(i, j, seed + 26) < 0.65 else 1.13
    return 1.0 + inner * (change - 1.0) - 0.45 * (inside - inner)
