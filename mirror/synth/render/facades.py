"""The appearance of houses: walls with windows, shop fronts and distant woods, averaged exactly over a footprint.

A footprint is a rectangle ``fu`` by ``fv`` on a face. A wall consists of nested rectangles (a window in its surround,
panes in its frame, a curtain behind the panes), so the covered area of each has a closed form. Every window has its
own curtains and light; the code loops over the windows of the footprint.
"""

from __future__ import annotations

from typing import Final

from mirror.arrays import Records
from mirror.compiled import inner_per_pixel, per_pixel
from mirror.synth.render.appearance import Appearance
from mirror.synth.render.texture import grain, hash_unit

_LINTEL_M: Final = 0.13
"""Height of the shadow below the top of a window, because panes are recessed in the wall."""


@inner_per_pixel(inline="always")
def _overlap(low: float, high: float, start: float, end: float) -> float:
    """Length of the intersection of two intervals."""
    return max(min(high, end) - max(low, start), 0.0)


@inner_per_pixel()
def _panes(low: float, high: float, start: float, width: float, count: int, frame: float) -> float:
    """Length of the part of an interval that is on panes: ``count`` panes between frames, from ``start`` on."""
    pane = (width - (count + 1) * frame) / count
    length = 0.0
    for index in range(count):
        foot = start + frame + index * (pane + frame)
        length += _overlap(low, high, foot, foot + pane)
    return length


@inner_per_pixel()
def _panes_up(low: float, high: float, foot: float, height: float, transom: float, frame: float) -> float:
    """Height of the part of an interval that is on panes: one pane, or two with a bar between."""
    if transom <= 0.0:
        return _overlap(low, high, foot + frame, foot + height - frame)
    bar = foot + height * (1.0 - transom)
    return _overlap(low, high, foot + frame, bar - 0.5 * frame) + _overlap(
        low, high, bar + 0.5 * frame, foot + height - frame
    )


@inner_per_pixel()
def wall_grain(face: Records, patterns: Records) -> int:
    """Return the grain of the wall of a FACADE face."""
    return patterns[face.layout].grain


@per_pixel()
def facade(
    face: Records, patterns: Records, rough: float, u: float, v: float, fu: float, fv: float, setting: Records
) -> Appearance:
    """Evaluate the appearance of a wall with windows.

    Args:
        face: the face, FACE, flat; its ``layout`` is a row of ``patterns``.
        patterns: table from :func:`mirror.synth.street.houses.windows.pattern_table`. It is an argument because the
            cache of compiled kernels would keep the old value of a changed constant.
        rough: value of the wall's grain at the point, mean 1.
        u: metres to the right of the middle of the face.
        v: metres above the middle of the face.
        fu: width of the footprint, metres.
        fv: height of the footprint, metres.
        setting: LIGHTING, flat.
    """
    row = patterns[face.layout]
    wide, high = 2.0 * face.half_0, 2.0 * face.half_1
    columns, storeys = max(int(wide / row.pitch_m + 0.5), 1), max(int(high / row.storey_m + 0.5), 1)
    pitch, storey = wide / columns, high / storeys
    left, right = max(u + face.half_0 - 0.5 * fu, 0.0), min(u + face.half_0 + 0.5 * fu, wide)
    low, top = max(v + face.half_1 - 0.5 * fv, 0.0), min(v + face.half_1 + 0.5 * fv, high)
    # An empty footprint, or one outside the face, is replaced by a micrometre at the edge of the face.
    left, low = min(left, wide - 1e-6), min(low, high - 1e-6)
    right, top = max(right, left + 1e-6), max(top, low + 1e-6)
    r, g, b, er, eg, eb, gloss = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(int(left / pitch), min(int(right / pitch), columns - 1) + 1):
        x0, x1 = max(left - i * pitch, 0.0), min(right - i * pitch, pitch)
        for j in range(int(low / storey), min(int(top / storey), storeys - 1) + 1):
            y0, y1 = max(low - j * storey, 0.0), min(top - j * storey, storey)
            cell = _shade_cell(face, row, rough, i, j, pitch, x0, x1, y0, y1, setting)
            r, g, b, gloss = r + cell[0], g + cell[1], b + cell[2], gloss + cell[6]
            er, eg, eb = er + cell[3], eg + cell[4], eb + cell[5]
    share = 1.0 / ((right - left) * (top - low))
    return r * share, g * share, b * share, er * share, eg * share, eb * share, gloss * share


@inner_per_pixel()
def _shade_cell(
    face: Records,
    row: Records,
    rough: float,
    i: int,
    j: int,
    pitch: float,
    x0: float,
    x1: float,
    y0: float,
    y1: float,
    setting: Records,
) -> Appearance:
    """Appearance of one window with its part of the wall, integrated over (x0, x1) by (y0, y1), square metres."""
    cr, cg, cb = face.colour_0, face.colour_1, face.colour_2
    dx, dy = x1 - x0, y1 - y0
    joint_x, joint_y = _overlap(x0, x1, 0.0, row.joint_m), _overlap(y0, y1, 0.0, row.joint_m)
    joint = joint_x * dy + joint_y * dx - joint_x * joint_y
    course = dx * _overlap(y0, y1, row.joint_m, row.course_m)
    wall = dx * dy - joint - course
    plain = rough * (wall + 0.5 * joint)
    # The colour of the trim is between that of the wall and that of a light stone.
    near = row.trim
    tr, tg, tb = cr + (0.62 - cr) * near, cg + (0.60 - cg) * near, cb + (0.55 - cb) * near
    trim = course
    half = 0.5 * row.width_m
    middle, foot, head = 0.5 * pitch, row.sill_m, row.sill_m + row.height_m
    edge = max(row.surround_m, 0.05)
    beside = edge + row.shutter_m
    if row.width_m <= 0.0 or x1 <= middle - half - beside or x0 >= middle + half + beside:
        return cr * plain + tr * trim, cg * plain + tg * trim, cb * plain + tb * trim, 0.0, 0.0, 0.0, 0.0
    if y1 <= foot - edge or y0 >= head + edge:
        return cr * plain + tr * trim, cg * plain + tg * trim, cb * plain + tb * trim, 0.0, 0.0, 0.0, 0.0
    start, end = middle - half, middle + half
    across, up = _overlap(x0, x1, start, end), _overlap(y0, y1, foot, head)
    window = across * up
    sill = _overlap(x0, x1, start - edge, end + edge) * _overlap(y0, y1, foot - edge, foot)
    surround = 0.0
    if row.surround_m > 0.0:
        surround = _overlap(x0, x1, start - edge, end + edge) * _overlap(y0, y1, foot, head + edge) - window
    shutter = (
        _overlap(x0, x1, start - edge - row.shutter_m, start - edge)
        + _overlap(x0, x1, end + edge, end + edge + row.shutter_m)
    ) * up
    plain -= rough * (window + sill + surround + shutter)
    trim += sill + surround
    r, g, b = cr * plain + tr * trim, cg * plain + tg * trim, cb * plain + tb * trim
    if shutter > 0.0:
        hue = hash_unit(face.seed, 11, 5)
        r, g, b = r + shutter * (0.10 + 0.10 * hue), g + shutter * 0.16, b + shutter * (0.20 - 0.12 * hue)
    if window <= 0.0:
        return r, g, b, 0.0, 0.0, 0.0, 0.0
    panes_x = _panes(x0, x1, start, row.width_m, row.panes, row.frame_m)
    panes_y = _panes_up(y0, y1, foot, row.height_m, row.transom, row.frame_m)
    glass = panes_x * panes_y
    shade = across * _overlap(y0, y1, head - _LINTEL_M, head)
    frame = window - glass - 0.55 * max(shade - panes_x * _overlap(y0, y1, head - _LINTEL_M, head - row.frame_m), 0.0)
    frame *= row.frame
    r, g, b = r + frame, g + frame, b + 0.98 * frame
    if glass <= 0.0:
        return r, g, b, 0.0, 0.0, 0.0, 0.0
    return _add_interior(face, row, i, j, x0, x1, y0, y1, start, foot, panes_x, panes_y, setting, r, g, b)


@inner_per_pixel()
def _add_interior(
    face: Records,
    row: Records,
    i: int,
    j: int,
    x0: float,
    x1: float,
    y0: float,
    y1: float,
    start: float,
    foot: float,
    panes_x: float,
    panes_y: float,
    setting: Records,
    r: float,
    g: float,
    b: float,
) -> Appearance:
    """Add the interior behind a window's panes: curtains, blinds or a dark room, and light at night."""
    glass = panes_x * panes_y
    window_id = i + 89 * j
    kind, size, hue = (
        hash_unit(window_id, 1, face.seed),
        hash_unit(window_id, 2, face.seed),
        hash_unit(window_id, 3, face.seed),
    )
    covered = 0.0
    if kind < 0.45 * row.curtains:
        # Curtains on both sides.
        drape = (0.12 + 0.2 * size) * row.width_m
        sides = _panes(min(x0, start + drape), min(x1, start + drape), start, row.width_m, row.panes, row.frame_m)
        far = start + row.width_m - drape
        sides += _panes(max(x0, far), max(x1, far), start, row.width_m, row.panes, row.frame_m)
        covered = sides * panes_y
    elif kind < 0.8 * row.curtains:
        # A partly lowered blind.
        end = foot + row.height_m * (1.0 - 0.75 * size * size - 0.12)
        covered = panes_x * _panes_up(max(y0, end), max(y1, end), foot, row.height_m, row.transom, row.frame_m)
    elif kind < row.curtains:
        covered = glass
    tone = 0.22 + 0.26 * size
    bare = row.glass * (0.6 + 0.8 * hue) * (glass - covered)
    r += bare + tone * covered
    g += bare + (0.94 + 0.05 * hue) * tone * covered
    b += 1.1 * bare + (0.80 + 0.22 * hue) * tone * covered
    if hash_unit(window_id, 4, face.seed) >= setting.lit_windows * row.lit:
        return r, g, b, 0.0, 0.0, 0.0, row.gloss * glass
    room = 0.85 * (glass - covered)
    if kind >= row.curtains:
        # The ceiling is bright; furniture is dark against the rear wall.
        ceiling = foot + (0.72 + 0.14 * hue) * row.height_m
        room += 0.6 * panes_x * _panes_up(max(y0, ceiling), y1, foot, row.height_m, row.transom, row.frame_m)
        left, top = start + 0.6 * hue * row.width_m, foot + 0.5 * size * row.height_m
        stuff = _panes(max(x0, left), min(x1, left + 0.4 * row.width_m), start, row.width_m, row.panes, row.frame_m)
        room -= 0.6 * stuff * _panes_up(y0, min(y1, top), foot, row.height_m, row.transom, row.frame_m)
    light = (room + 0.55 * covered) * (0.45 + 0.9 * hash_unit(window_id, 5, face.seed))
    if hash_unit(window_id, 6, face.seed) < row.cool:
        return r, g, b, 0.46 * light, 0.50 * light, 0.48 * light, row.gloss * glass
    return r, g, b, 0.62 * light, (0.40 + 0.06 * hue) * light, (0.16 + 0.10 * hue) * light, row.gloss * glass


@per_pixel()
def shopfront(
    face: Records,
    red: float,
    green: float,
    blue: float,
    u: float,
    v: float,
    fu: float,
    fv: float,
    setting: Records,
) -> Appearance:
    """Evaluate the appearance of a shop window with its door, frames and interior, which is lit in the evening.

    Args:
        face: the face, FACE, flat; its colour is that of the frames.
        red: red of the image of the interior, averaged over the footprint.
        green: green of the same image.
        blue: blue of the same image.
        u: metres to the right of the middle of the face.
        v: metres above the middle of the face.
        fu: width of the footprint, metres.
        fv: height of the footprint, metres.
        setting: LIGHTING, flat.
    """
    wide, high = 2.0 * face.half_0, 2.0 * face.half_1
    left, right = max(u + face.half_0 - 0.5 * fu, 0.0), min(u + face.half_0 + 0.5 * fu, wide)
    low, top = max(v + face.half_1 - 0.5 * fv, 0.0), min(v + face.half_1 + 0.5 * fv, high)
    left, low = min(left, wide - 1e-6), min(low, high - 1e-6)
    right, top = max(right, left + 1e-6), max(top, low + 1e-6)
    # The door is at one end or in the middle; panes fill the rest.
    door_wide = 1.05
    place = int(3.0 * hash_unit(face.seed, 21, 0))
    door = 0.0 if place == 0 else (wide - door_wide if place == 1 else 0.5 * (wide - door_wide))
    riser = 0.25 + 0.35 * hash_unit(face.seed, 22, 0)
    bar = high - 0.28 * high
    before, behind = door, wide - door - door_wide
    glass = 0.0
    for start, width in ((0.0, before), (door + door_wide, behind)):
        if width > 0.4 and right > start and left < start + width:
            count = max(int(width / 2.1 + 0.5), 1)
            x = _panes(left, right, start, width, count, 0.07)
            glass += x * (_overlap(low, top, riser + 0.07, bar - 0.03) + _overlap(low, top, bar + 0.03, high - 0.07))
    x = _overlap(left, right, door + 0.14, door + door_wide - 0.14)
    y = _overlap(low, top, 0.22, bar - 0.12) + _overlap(low, top, bar + 0.03, high - 0.07)
    glass += x * y
    # A handle on the door.
    grip = _overlap(left, right, door + 0.17, door + 0.21) * _overlap(low, top, 0.9, 1.5)
    area = (right - left) * (top - low)
    glass, grip = glass / area, grip / area
    frame = 1.0 - glass
    burn = setting.lit_windows * (1.9 if hash_unit(face.seed, 23, 0) < 0.8 else 0.25)
    visible = glass - grip
    return (
        face.colour_0 * frame + 0.5 * red * visible + 0.5 * grip,
        face.colour_1 * frame + 0.5 * green * visible + 0.5 * grip,
        face.colour_2 * frame + 0.5 * blue * visible + 0.5 * grip,
        burn * red * visible,
        0.94 * burn * green * visible,
        0.80 * burn * blue * visible,
        0.12 * glass,
    )


@per_pixel()
def skyline(face: Records, u: float, v: float, fu: float, fv: float) -> Appearance:
    """Evaluate the appearance of a distant wood: clumps that fade out where the footprint is wider."""
    wide = 0.5 * (fu + fv)
    clump = 1.0 + 0.30 * grain(u, v, 2.6, wide, face.seed) + 0.25 * grain(u, v, 0.9, wide, face.seed + 1)
    # The top is lighter than the shaded foot.
    clump *= 0.85 + 0.3 * min(max((v + face.half_1) / max(2.0 * face.half_1, 1e-3), 0.0), 1.0)
    return face.colour_0 * clump, face.colour_1 * clump, face.colour_2 * clump, 0.0, 0.0, 0.0, 0.0
