"""Motorcycles, scooters, bicycles and cargo bikes, ridden or parked."""

from __future__ import annotations

import math
from typing import Final, Literal

import numpy as np

from mirror.portable import arrays, scalars
from mirror.synth.model import Label, Material, Side, ellipsoid, tube
from mirror.synth.model.surfaces import merge_models
from mirror.synth.road_users.body import Body, Saddle, make_body
from mirror.synth.road_users.coachwork.fittings import (
    BLACK,
    HEADLIGHT,
    RIM,
    RUBBER,
    TAIL_LIGHT,
    add_number_plate,
    draw_car_paint,
    draw_plate_number,
)
from mirror.synth.road_users.coachwork.sheets import Colour, SheetFinish, Sheets
from mirror.synth.road_users.people import build_rider

_STEEL: Final = (0.30, 0.31, 0.32)
_BLACK: Final = BLACK.colour
_TYRE: Final = SheetFinish((0.02, 0.02, 0.021), Material.RUBBER, two_sided=True)
_FRAMES: Final[tuple[Colour, ...]] = (
    (0.02, 0.02, 0.022),
    (0.02, 0.02, 0.022),
    (0.42, 0.42, 0.41),
    (0.30, 0.02, 0.025),
    (0.03, 0.10, 0.28),
    (0.05, 0.20, 0.12),
    (0.10, 0.10, 0.11),
    (0.50, 0.32, 0.04),
)
_PLATE_SHARE: Final = 0.55
_CORNERS: Final = 16
_SPOKE_M: Final = 0.17

Point = tuple[float, float]


def build_motorcycle(rng: np.random.Generator, *, ridden: bool = True) -> Body:
    """Build a two-wheeler with a motor."""
    return (build_scooter if rng.random() < 0.4 else build_roadster)(rng, ridden=ridden)


def build_bicycle(rng: np.random.Generator, *, ridden: bool = True) -> Body:
    """Build a two-wheeler without a motor."""
    return (build_cargo_bike if rng.random() < 0.1 else build_city_bicycle)(rng, ridden=ridden)


def build_roadster(rng: np.random.Generator, *, ridden: bool = True) -> Body:
    """Build a motorcycle without fairing."""
    sheets = Sheets(Label.MOTORCYCLE, int(rng.integers(1 << 30)))
    coat = draw_car_paint(rng)
    radius, back, front = 0.315, -0.72, 0.72
    for x in (back, front):
        _add_solid_wheel(sheets, x, radius, 0.14)
    fork, head = (front - 0.01, radius), (front - 0.33, 0.98)
    for y in (0.10, -0.10):
        _add_bar(sheets, (*_xy(fork, y),), (*_xy(head, y),), 0.026, _STEEL)
    _add_bar(sheets, (head[0] - 0.05, 0.36, 1.06), (head[0] - 0.05, -0.36, 1.06), 0.016, _BLACK)
    for y in (0.10, -0.10):
        _add_bar(sheets, (back, y, radius), (-0.18, y, 0.40), 0.03, _STEEL)
    _add_ball(sheets, (0.12, 0.0, 0.86), (0.56, 0.32, 0.30), coat)
    _add_ball(sheets, (-0.42, 0.0, 0.83), (0.72, 0.30, 0.16), BLACK)
    _add_ball(sheets, (-0.74, 0.0, 0.80), (0.46, 0.18, 0.16), coat)
    _add_ball(sheets, (front, 0.0, 2.0 * radius - 0.02), (0.46, 0.16, 0.12), coat)
    sheets.block((-0.30, -0.20, 0.24), (0.30, 0.20, 0.66), SheetFinish((0.07, 0.07, 0.072), Material.METAL), _SIDES)
    _add_bar(sheets, (0.22, -0.17, 0.30), (-0.72, -0.22, 0.42), 0.055, _STEEL)
    _add_ball(sheets, (head[0] + 0.10, 0.0, 0.96), (0.16, 0.20, 0.20), BLACK)
    _add_lights(sheets, head[0] + 0.185, (0.09, 0.88, 1.04), -0.96, (0.09, 0.76, 0.84))
    _add_small_plate(sheets, -0.985, 0.62, draw_plate_number(rng))
    for y in (0.40, -0.40):
        _add_ball(sheets, (head[0] - 0.02, y, 1.20), (0.05, 0.14, 0.09), BLACK)
    seat = Saddle((-0.28, 0.0, 0.88), (head[0] - 0.08, 0.34, 1.07), (-0.16, 0.22, 0.36), (-0.16, -0.22, 0.36))
    return _make_body(rng, sheets, seat, "motorcycle", ridden, motorcycle=True)


def build_scooter(rng: np.random.Generator, *, ridden: bool = True) -> Body:
    """Build a motor scooter with a leg shield, some with a delivery box."""
    sheets = Sheets(Label.MOTORCYCLE, int(rng.integers(1 << 30)))
    coat = draw_car_paint(rng)
    radius, back, front = 0.235, -0.60, 0.66
    for x in (back, front):
        _add_solid_wheel(sheets, x, radius, 0.11)
    head = (0.46, 0.98)
    outline = ((0.16, 0.30), (-0.16, 0.30), (-0.22, 0.60), (-0.15, 0.92), (0.15, 0.92), (0.22, 0.60))
    shield = [(0.48 - 0.13 * z, y, z) for y, z in outline]
    sheets.sheet(shield, Side.FRONT, coat._replace(two_sided=True))
    _add_ball(sheets, (0.47, 0.0, 0.72), (0.20, 0.26, 0.46), coat)
    _add_ball(sheets, (front, 0.0, 0.44), (0.44, 0.17, 0.18), coat)
    _add_bar(sheets, (front, 0.0, radius), (0.52, 0.0, 0.62), 0.05, _BLACK)
    sheets.block((-0.22, -0.19, 0.24), (0.44, 0.19, 0.31), coat, (Side.LEFT, Side.RIGHT, Side.TOP))
    side = ((-0.86, 0.50), (-0.62, 0.32), (-0.20, 0.26), (-0.16, 0.72), (-0.84, 0.76))
    flank = np.array([(x, 0.2384 - 0.12 * z, z) for x, z in side])
    sheets.sheet(flank, Side.LEFT, coat, both=True)
    for ends, way in (([0, 4], Side.BACK), ([2, 3], Side.FRONT)):
        sheets.sheet(np.concatenate([flank[ends], flank[ends][::-1] * (1.0, -1.0, 1.0)]), way, coat)
    _add_ball(sheets, (-0.50, 0.0, 0.77), (0.72, 0.30, 0.14), BLACK)
    _add_bar(sheets, (head[0] - 0.14, 0.33, 1.02), (head[0] - 0.14, -0.33, 1.02), 0.018, _BLACK)
    _add_ball(sheets, (head[0] - 0.10, 0.0, 1.0), (0.24, 0.26, 0.16), coat)
    _add_lights(sheets, head[0] + 0.025, (0.08, 0.95, 1.05), -0.872, (0.10, 0.62, 0.70))
    _add_small_plate(sheets, -0.885, 0.52, draw_plate_number(rng))
    if rng.random() < 0.35:
        case = SheetFinish(_FRAMES[int(rng.integers(2, len(_FRAMES)))], Material.PLAIN)
        sheets.block((-1.02, -0.24, 0.84), (-0.56, 0.24, 1.28), case, (*_SIDES, Side.TOP))
    for y in (0.36, -0.36):
        _add_ball(sheets, (head[0] - 0.10, y, 1.20), (0.04, 0.12, 0.08), BLACK)
    seat = Saddle((-0.34, 0.0, 0.84), (head[0] - 0.18, 0.31, 1.03), (0.14, 0.14, 0.31), (0.14, -0.14, 0.31))
    return _make_body(rng, sheets, seat, "motorcycle", ridden, motorcycle=True)


def build_city_bicycle(rng: np.random.Generator, *, ridden: bool = True) -> Body:
    """Build a city or sports bicycle."""
    sheets = Sheets(Label.BICYCLE, int(rng.integers(1 << 30)))
    frame = _FRAMES[int(rng.integers(len(_FRAMES)))]
    radius, back, front = 0.345, -0.52, 0.54
    for x in (back, front):
        _add_open_wheel(sheets, x, radius)
    crank, head, top = (-0.08, 0.28), (0.40, 0.80), (0.36, 0.92)
    post = (-0.24, 0.80 if rng.random() < 0.6 else 0.62)
    for start, end in (
        (crank, head), (crank, (-0.30, 0.96)), (post, top), (crank, (back, radius)), (post, (back, radius)),
        (head, (front, radius)),
    ):  # fmt: skip
        _add_bar(sheets, _xy(start, 0.0), _xy(end, 0.0), 0.019, frame)
    _add_bar(sheets, _xy(head, 0.0), (0.32, 0.0, 1.05), 0.016, _STEEL)
    _add_bar(sheets, (0.28, 0.30, 1.06), (0.28, -0.30, 1.06), 0.015, _BLACK)
    _add_ball(sheets, (-0.29, 0.0, 0.98), (0.27, 0.17, 0.07), BLACK)
    if rng.random() < 0.45:
        case = SheetFinish(_FRAMES[int(rng.integers(len(_FRAMES)))], Material.CLOTH)
        sheets.block((-0.72, 0.07, 0.40), (-0.40, 0.20, 0.72), case, (*_SIDES, Side.TOP))
        sheets.block((-0.72, -0.20, 0.40), (-0.40, -0.07, 0.72), case, (*_SIDES, Side.TOP))
    return _make_body(rng, sheets, _add_cranks(rng, sheets, crank), "cyclist", ridden)


def build_cargo_bike(rng: np.random.Generator, *, ridden: bool = True) -> Body:
    """Build a bicycle with a box in front of its rider."""
    sheets = Sheets(Label.BICYCLE, int(rng.integers(1 << 30)))
    frame = _FRAMES[int(rng.integers(len(_FRAMES)))]
    back, front = -1.05, 1.10
    _add_open_wheel(sheets, back, 0.345)
    _add_open_wheel(sheets, front, 0.255)
    shift = -0.53
    crank, head = (-0.08 + shift, 0.28), (0.40 + shift, 0.80)
    for start, end in (
        (crank, head), (crank, (-0.30 + shift, 0.96)), ((-0.24 + shift, 0.70), head), (crank, (back, 0.345)),
        ((-0.24 + shift, 0.70), (back, 0.345)), (head, (0.02, 0.33)), ((0.02, 0.33), (0.88, 0.36)),
        ((0.84, 0.62), (front, 0.255)),
    ):  # fmt: skip
        _add_bar(sheets, _xy(start, 0.0), _xy(end, 0.0), 0.022, frame)
    _add_bar(sheets, _xy(head, 0.0), (0.30 + shift, 0.0, 1.05), 0.016, _STEEL)
    _add_bar(sheets, (0.28 + shift, 0.30, 1.06), (0.28 + shift, -0.30, 1.06), 0.015, _BLACK)
    _add_ball(sheets, (-0.29 + shift, 0.0, 0.98), (0.27, 0.17, 0.07), BLACK)
    wood = SheetFinish((0.30, 0.20, 0.11) if rng.random() < 0.5 else (0.03, 0.03, 0.033), Material.WOOD)
    low, high = [(0.05, 0.22), (0.74, 0.20)], [(-0.02, 0.31), (0.90, 0.29)]
    rim = [(x, y, 0.84) for x, y in high]
    foot = [(x, y, 0.40) for x, y in low]
    _add_box(sheets, foot, rim, wood)
    return _make_body(rng, sheets, _add_cranks(rng, sheets, crank, shift), "cyclist", ridden)


_SIDES: Final = (Side.FRONT, Side.BACK, Side.LEFT, Side.RIGHT)


def _xy(point: Point, y: float) -> tuple[float, float, float]:
    return point[0], y, point[1]


def _add_bar(
    sheets: Sheets, start: tuple[float, float, float], end: tuple[float, float, float], radius: float, colour: Colour
) -> None:
    sheets.add(tube(start, end, radius, colour, Material.METAL, sheets.label, corners=4))


def _add_ball(
    sheets: Sheets, centre: tuple[float, float, float], size: tuple[float, float, float], finish: SheetFinish
) -> None:
    sheets.add(ellipsoid(centre, size, finish.colour, finish.material, sheets.label, seed=sheets.seed))


def _add_box(
    sheets: Sheets,
    foot: list[tuple[float, float, float]],
    rim: list[tuple[float, float, float]],
    finish: SheetFinish,
) -> None:
    """Add four walls that lean outwards, and a dark lid."""
    mirror = np.array([1.0, -1.0, 1.0])
    (back, front), (over_back, over_front) = np.array(foot), np.array(rim)
    sheets.sheet([back, back * mirror, over_back * mirror, over_back], Side.BACK, finish)
    sheets.sheet([front, front * mirror, over_front * mirror, over_front], Side.FRONT, finish)
    # The flank is split into two triangles because its four corners are not coplanar.
    sheets.sheet([back, front, over_front], Side.LEFT, finish, both=True)
    sheets.sheet([back, over_front, over_back], Side.LEFT, finish, both=True)
    sheets.sheet([over_back, over_front, over_front * mirror, over_back * mirror], Side.TOP, BLACK)


def _add_solid_wheel(sheets: Sheets, x: float, radius: float, width: float) -> None:
    """Add a motorcycle's wheel."""
    turn = 2.0 * math.pi * (np.arange(_CORNERS) + 0.5) / _CORNERS
    reach = radius / scalars.cos(math.pi / _CORNERS)
    disc = np.c_[x + reach * arrays.sin(turn), np.full(_CORNERS, 0.5 * width), radius - reach * arrays.cos(turn)]
    sheets.sheet(disc, Side.LEFT, RIM._replace(two_sided=False), both=True)
    _add_tread(sheets, disc, width)


def _add_open_wheel(sheets: Sheets, x: float, radius: float) -> None:
    """Add a bicycle's wheel: an open tyre and its hub."""
    turn = 2.0 * math.pi * (np.arange(_CORNERS) + 0.5) / _CORNERS
    reach = radius / scalars.cos(math.pi / _CORNERS)
    outer = np.c_[x + reach * arrays.sin(turn), np.zeros(_CORNERS), radius - reach * arrays.cos(turn)]
    middle = np.array([x, 0.0, radius])
    inner = middle + (outer - middle) * (1.0 - 0.042 / radius)
    for i in range(_CORNERS):
        j = (i + 1) % _CORNERS
        sheets.sheet([outer[i], outer[j], inner[j], inner[i]], Side.LEFT, _TYRE)
    _add_tread(sheets, outer[::2] + np.array([0.0, 0.018, 0.0]), 0.036)
    sheets.add(ellipsoid((x, 0.0, radius), (0.06, 0.11, 0.06), _STEEL, Material.METAL, sheets.label))


def _add_tread(sheets: Sheets, disc: np.ndarray, width: float) -> None:
    """Add the parts of the tyre that are visible from the front and the back, from the outline of its left side."""
    other = disc - (0.0, width, 0.0)
    count = len(disc)
    for i in range(count):
        j = (i + 1) % count
        middle = 0.5 * (disc[i] + disc[j]) - disc.mean(axis=0)
        if abs(middle[2]) > 0.94 * arrays.norm(middle):
            side = Side.TOP if middle[2] > 0.0 else Side.BOTTOM
        else:
            side = Side.FRONT if middle[0] > 0.0 else Side.BACK
        if side is not Side.BOTTOM:
            sheets.sheet([disc[i], disc[j], other[j], other[i]], side, RUBBER)


def _add_lights(
    sheets: Sheets, front: float, head: tuple[float, float, float], back: float, tail: tuple[float, float, float]
) -> None:
    """Add a headlight and a tail light: half width, lower and upper edge of each."""
    for x, (half, low, high), side, finish in (
        (front, head, Side.FRONT, HEADLIGHT),
        (back, tail, Side.BACK, TAIL_LIGHT),
    ):
        sheets.sheet([(x, half, low), (x, -half, low), (x, -half, high), (x, half, high)], side, finish)


def _add_small_plate(sheets: Sheets, x: float, z: float, number: int) -> None:
    add_number_plate(sheets, (x, 0.0, z), Side.BACK, number, share=_PLATE_SHARE)


def _add_cranks(rng: np.random.Generator, sheets: Sheets, crank: Point, shift: float = 0.0) -> Saddle:
    """Add cranks at a random angle; return the rider's contact points."""
    turn = rng.uniform(0.0, 2.0 * math.pi)
    dx, dz = _SPOKE_M * scalars.cos(turn), _SPOKE_M * scalars.sin(turn)
    left, right = (crank[0] + dx, 0.12, crank[1] + dz), (crank[0] - dx, -0.12, crank[1] - dz)
    for x, y, z in (left, right):
        sheets.block((x - 0.05, y - 0.05, z - 0.02), (x + 0.05, y + 0.05, z), BLACK, (Side.TOP, Side.FRONT))
    return Saddle((-0.27 + shift, 0.0, 1.0), (0.28 + shift, 0.28, 1.08), left, right)


def _make_body(
    rng: np.random.Generator,
    sheets: Sheets,
    saddle: Saddle,
    category: Literal["motorcycle", "cyclist"],
    ridden: bool,
    *,
    motorcycle: bool = False,
) -> Body:
    machine = sheets.model()
    if not ridden:
        return make_body("bicycle" if category == "cyclist" else category, machine)
    return make_body(category, merge_models([machine, build_rider(rng, saddle, motorcycle=motorcycle)]))
