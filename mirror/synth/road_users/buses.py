"""Buses: city buses in their operators' colours, and coaches."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.synth.model import Label, Material, Side
from mirror.synth.road_users.body import Body, make_body
from mirror.synth.road_users.coachwork.fittings import (
    BLACK,
    HEADLIGHT,
    STEEL_RIM,
    TAIL_LIGHT,
    add_insert,
    add_lamps,
    add_number_plate,
    add_wheels,
    draw_car_paint,
    draw_plate_number,
)
from mirror.synth.road_users.coachwork.sheets import Panel, SheetFinish, Sheets
from mirror.synth.road_users.coachwork.shell import DARK, DARK_PANE, PANE, End, Shape, add_shell, window_corners
from mirror.synth.textures.catalogue import LIVERIES

_LIVERIES: Final[tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...]] = (
    ((0.66, 0.66, 0.65), (0.40, 0.02, 0.03)),
    ((0.56, 0.36, 0.02), (0.56, 0.36, 0.02)),
    ((0.42, 0.025, 0.03), (0.42, 0.025, 0.03)),
    ((0.62, 0.63, 0.64), (0.03, 0.12, 0.34)),
    ((0.05, 0.16, 0.36), (0.03, 0.05, 0.09)),
    ((0.62, 0.60, 0.52), (0.03, 0.22, 0.14)),
)
"""Colours of the upper and the lower body."""
_DISPLAY: Final = SheetFinish((0.42, 0.25, 0.03), Material.PLAIN)


def build_bus(rng: np.random.Generator) -> Body:
    """Build a city bus or, less often, a coach."""
    return build_city_bus(rng) if rng.random() < 0.8 else build_coach(rng)


def build_city_bus(rng: np.random.Generator) -> Body:
    """Build a city bus: low floor, three doors on the right, large windows, a destination display."""
    upper, lower = _LIVERIES[int(rng.integers(len(_LIVERIES)))]
    length = float(rng.choice((10.6, 12.0)))
    shape = design_bus(length, 3.0, waist=1.10, overhangs=(2.7, 3.1))
    sheets = Sheets(Label.BUS, int(rng.integers(1 << 30)))
    _add_bus(rng, sheets, shape, SheetFinish(upper, Material.PAINT), SheetFinish(lower, Material.PAINT), pitch_m=1.42)
    end, front = shape.front.reach_m, shape.axles_m[0]
    for middle, wide in ((end - 0.95, 1.2), (front - 2.5, 1.3), (shape.axles_m[1] + 1.45, 1.3)):
        _add_door(sheets, shape, middle, wide)
    z = shape.roof[1][1] - 0.19
    _add_displays(sheets, shape, z)
    sheets.block(
        (-0.30 * length, -0.8, 2.98), (0.10 * length, 0.8, 3.22), SheetFinish(upper, Material.PLAIN), _ROOF_SIDES
    )
    if rng.random() < 0.6:
        left, right = shape.axles_m[1] + 0.9, shape.axles_m[0] - 0.9
        _add_advertisement(sheets, shape, 0.5 * (left + right), int(rng.choice(LIVERIES)))
    return make_body("bus", sheets.model())


def build_coach(rng: np.random.Generator) -> Body:
    """Build a coach: high, with luggage space under dark windows."""
    shape = design_bus(12.4, 3.65, waist=1.72, overhangs=(2.6, 3.4))
    sheets = Sheets(Label.BUS, int(rng.integers(1 << 30)))
    coat = draw_car_paint(rng)
    _add_bus(rng, sheets, shape, coat, coat, pitch_m=1.7)
    _add_door(sheets, shape, shape.front.reach_m - 0.85, 0.95)
    return make_body("bus", sheets.model())


_ROOF_SIDES: Final = (Side.FRONT, Side.BACK, Side.LEFT, Side.RIGHT, Side.TOP)


def design_bus(
    length: float, height: float, *, waist: float, overhangs: tuple[float, float], width: float = 2.53
) -> Shape:
    """Return the shape of a box on two axles; lengths in metres, overhangs at the front and at the back."""
    end = 0.5 * length
    axles = end - overhangs[0], overhangs[1] - end
    return Shape(
        width_m=width,
        clearance_m=0.33,
        waist_m=waist,
        wheel_m=0.48,
        axles_m=axles,
        front=End(end, (0.13, 0.24), 0.04, 0.03, 0.0, waist - 0.01),
        back=End(end, (0.08, 0.16), 0.03, 0.01, 0.0, waist - 0.01),
        bonnet=(),
        roof=(
            (end - 0.17, waist), (end - 0.42, height - 0.12), (end - 0.75, height),
            (0.45 - end, height), (0.22 - end, height - 0.10), (0.12 - end, waist),
        ),
        rail_m=height - 0.22,
        lean=0.012,
        rail_lean=1.1,
        tuck_m=0.012,
        shoulder_m=0.0,
        doors=Panel.ROW,
        door_m=(axles[0] - 0.75, 1.42),
    )  # fmt: skip


def add_bus_body(sheets: Sheets, shape: Shape, upper: SheetFinish, lower: SheetFinish, *, pitch_m: float) -> None:
    """Add the body with its rows of windows and a pillar every ``pitch_m``."""
    add_shell(sheets, shape, upper, sill=lower, deck=upper, screen=DARK_PANE)
    low, high = shape.waist_m + 0.05, shape.rail_m - 0.14
    ahead = shape.screen(low) - 0.22
    outline = [(0.55 - shape.back.reach_m, low), (ahead, low), (shape.screen(high) - 0.16, high)]
    outline.append((0.55 - shape.back.reach_m, high))

    def row(places: Float64) -> Float64:
        return (places[:, [0, 2]] - (ahead, 0.5 * (low + high))) / (pitch_m, 1.0)

    sheets.sheet(
        [shape.side(*point) for point in outline],
        Side.LEFT, PANE._replace(panel=Panel.ROW), texture=row, lift_m=0.004, both=True,
    )  # fmt: skip
    rear = window_corners(shape, shape.rear_window, shape.waist_m + 0.35, shape.roof[-2][1] - 0.3, 0.22)
    sheets.sheet(rear, Side.BACK, DARK_PANE, lift_m=0.004)


def _add_bus(
    rng: np.random.Generator, sheets: Sheets, shape: Shape, upper: SheetFinish, lower: SheetFinish, *, pitch_m: float
) -> None:
    """Add body, lamps, plates, wheels and mirrors."""
    add_bus_body(sheets, shape, upper, lower, pitch_m=pitch_m)
    middle = shape.levels_m[1]
    add_lamps(sheets, shape, shape.front, HEADLIGHT, (middle + 0.03, middle + 0.22), inner=0.66, wrap=0.5)
    add_lamps(sheets, shape, shape.back, TAIL_LIGHT, (middle + 0.06, middle + 0.36), inner=0.86, wrap=0.2)
    add_insert(sheets, shape, shape.back, DARK, (middle + 0.42, shape.waist_m - 0.06), (0.7, 0.7))
    number = draw_plate_number(rng)
    add_number_plate(sheets, (shape.front.reach_m + 0.012, 0.0, middle - 0.06), Side.FRONT, number)
    add_number_plate(sheets, (-shape.back.reach_m - 0.012, 0.0, middle + 0.02), Side.BACK, number)
    for x in shape.axles_m:
        add_wheels(sheets, x, 0.5 * shape.width_m - 0.03, shape.wheel_m, 0.29, rim=STEEL_RIM)
    x, y, z = shape.screen(shape.rail_m) + 0.30, 0.5 * shape.width_m + 0.06, shape.rail_m - 0.44
    sheets.block((x, y, z - 0.22), (x + 0.12, y + 0.20, z + 0.22), BLACK, _ROOF_SIDES, both=True)
    sheets.block((x - 0.35, y + 0.02, z + 0.14), (x, y + 0.07, z + 0.20), BLACK, (Side.RIGHT, Side.LEFT), both=True)


def _add_door(sheets: Sheets, shape: Shape, middle: float, wide: float) -> None:
    """Add a door with two glass leaves on the right."""
    y = -0.5 * shape.width_m - 0.003
    low, high = shape.levels_m[0] + 0.05, shape.rail_m - 0.20
    ends = (middle - 0.5 * wide, middle + 0.5 * wide)
    corners = [(ends[0], y, low), (ends[1], y, low), (ends[1], y, high), (ends[0], y, high)]
    sheets.sheet(
        corners,
        Side.RIGHT,
        PANE._replace(panel=Panel.ROW),
        texture=lambda places: (places[:, [0, 2]] - (middle, 0.5 * (low + high))) / (0.5 * wide, 1.0),
    )


def _add_displays(sheets: Sheets, shape: Shape, z: float) -> None:
    """Add destination displays at the front and on the right."""
    low, high = z - 0.13, z + 0.13
    corners = np.array([(shape.screen(h), side * 0.72, h) for h, side in ((low, 1), (low, -1), (high, -1), (high, 1))])
    sheets.sheet(corners, Side.FRONT, BLACK, lift_m=0.006)
    inner = corners * (1.0, 0.8, 1.0) * (1.0, 1.0, 1.0)
    middle = inner.mean(axis=0)
    sheets.sheet(middle + (inner - middle) * (0.5, 1.0, 0.5), Side.FRONT, _DISPLAY, lift_m=0.010)


def _add_advertisement(sheets: Sheets, shape: Shape, middle: float, image: int) -> None:
    """Add an advertisement on the left side, from below the windows to the skirt."""
    y = 0.5 * shape.width_m + 0.003
    low, high = shape.levels_m[1] - 0.10, shape.waist_m - 0.03
    half = high - low
    corners = [(middle - half, y, low), (middle + half, y, low), (middle + half, y, high), (middle - half, y, high)]
    sheets.sheet(corners, Side.LEFT, SheetFinish((0.7, 0.7, 0.7), Material.IMAGE, image=image))
