"""Cabs of trucks, above their engines."""

from __future__ import annotations

from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from mirror.synth.model import Side
from mirror.synth.road_users.coachwork.fittings import BLACK, HEADLIGHT, STEEL_RIM, add_number_plate, add_wheels
from mirror.synth.road_users.coachwork.sheets import Panel, SheetFinish, Sheets
from mirror.synth.road_users.coachwork.shell import DARK, DARK_PANE, PANE

WIDTH_M: Final = 2.44
FLOOR_M: Final = 1.08
_CORNER_M: Final = 0.20
_ALL: Final = (Side.FRONT, Side.BACK, Side.LEFT, Side.RIGHT, Side.TOP)


class Cab(NamedTuple):
    """Measures of a cab, in metres: x of its back and front, its height, and the radius of its wheels."""

    back: float
    front: float
    high: float
    wheel: float

    @property
    def axle(self) -> float:
        """X of the axle."""
        return self.front - 1.36


def add_cab_body(sheets: Sheets, cab: Cab, coat: SheetFinish, bumper: SheetFinish) -> None:
    """Add front, corners, flanks, windows and steps."""
    half, inner = 0.5 * WIDTH_M, 0.5 * WIDTH_M - _CORNER_M
    waist, brow = 1.72, cab.high - 0.32
    # Heights, and how far the front is set back at each.
    levels = ((0.38, 0.05), (FLOOR_M, 0.0), (waist, 0.02), (brow, 0.14), (cab.high, 0.34))
    for (low, back), (high, other) in pairwise(levels):
        finish = bumper if low < FLOOR_M else DARK_PANE if low == waist else coat
        ahead, above = cab.front - back, cab.front - other
        front = [(ahead, inner, low), (ahead, -inner, low), (above, -inner, high), (above, inner, high)]
        sheets.sheet(front, Side.FRONT, finish)
        corner = [
            (ahead, inner, low), (ahead - _CORNER_M, half, low),
            (above - _CORNER_M, half, high), (above, inner, high),
        ]  # fmt: skip
        sheets.sheet(corner, Side.FRONT, bumper if low < FLOOR_M else coat, both=True)
    edge = cab.front - _CORNER_M
    flank = [
        (cab.back, half, FLOOR_M), (edge, half, FLOOR_M), (edge - 0.02, half, waist), (edge - 0.14, half, brow),
        (edge - 0.34, half, cab.high), (cab.back, half, cab.high),
    ]  # fmt: skip
    door = coat._replace(panel=Panel.TWO_DOORS)
    sheets.sheet(
        flank, Side.LEFT, door,
        texture=lambda places: np.c_[(places[:, 0] - cab.front + 1.5) / 1.12, (places[:, 2] - waist) * 0.95], both=True,
    )  # fmt: skip
    glass = [
        (cab.front - 1.42, half, waist + 0.06), (cab.front - 0.46, half, waist - 0.04),
        (cab.front - 0.56, half, brow), (cab.front - 1.42, half, brow),
    ]  # fmt: skip
    sheets.sheet(glass, Side.LEFT, PANE, lift_m=0.004, both=True)
    outline = [(cab.axle + 0.60, 0.38), (edge - 0.05, 0.38), (edge, FLOOR_M), (cab.axle + 0.62, FLOOR_M)]
    step = [(x, half, z) for x, z in outline]
    sheets.sheet(step, Side.LEFT, bumper, both=True)
    top = edge - 0.34
    roof = [(cab.back, half), (top, half), (cab.front - 0.34, inner), (cab.front - 0.34, -inner), (top, -half)]
    sheets.sheet([(x, y, cab.high) for x, y in [*roof, (cab.back, -half)]], Side.TOP, coat)
    sheets.block((cab.back, -half, FLOOR_M), (cab.back + 0.1, half, cab.high), coat, (Side.BACK,))
    sheets.block((cab.back + 0.1, -0.92, 0.45), (cab.front - 0.4, 0.92, FLOOR_M), DARK, (Side.LEFT,), both=True)
    grille = [(cab.front, y, z) for y, z in ((0.78, 1.14), (-0.78, 1.14), (-0.78, 1.60), (0.78, 1.60))]
    grille = [(x - 0.02 * (z - FLOOR_M) / (waist - FLOOR_M), y, z) for x, y, z in grille]
    sheets.sheet(grille, Side.FRONT, BLACK, lift_m=0.004)


def add_cab_fittings(sheets: Sheets, cab: Cab, number: int) -> None:
    """Add lamps, wheels, mirrors and a plate."""
    half = 0.5 * WIDTH_M
    lamps = [
        (cab.front - 0.05 * (FLOOR_M - z) / 0.7, y, z)
        for y, z in ((0.60, 0.62), (0.98, 0.62), (0.98, 0.84), (0.60, 0.84))
    ]
    sheets.sheet(lamps, Side.FRONT, HEADLIGHT, lift_m=0.004, both=True)
    add_number_plate(sheets, (cab.front + 0.012, 0.0, 0.72), Side.FRONT, number)
    add_wheels(sheets, cab.axle, half - 0.03, cab.wheel, 0.32, rim=STEEL_RIM, open_deg=124.0, treads=3)
    x, y = cab.front - 0.42, half + 0.10
    sheets.block((x, y, 2.02), (x + 0.12, y + 0.20, 2.62), BLACK, _ALL, both=True)


def add_spoiler(sheets: Sheets, cab: Cab, coat: SheetFinish) -> None:
    """Add a roof spoiler that rises to the trailer's height."""
    half, low, high = 0.5 * WIDTH_M - 0.06, cab.high, 3.82
    foot, top = cab.front - 0.50, cab.back + 0.45
    sheets.sheet(
        [(foot, half, low), (foot, -half, low), (top, -half + 0.1, high), (top, half - 0.1, high)], Side.FRONT, coat
    )
    sheets.sheet(
        [(cab.back, half, low), (foot, half, low), (top, half - 0.1, high), (cab.back, half - 0.1, high)],
        Side.LEFT,
        coat,
        both=True,
    )
    sheets.sheet(
        [
            (x, y, high)
            for x, y in ((cab.back, half - 0.1), (top, half - 0.1), (top, 0.1 - half), (cab.back, 0.1 - half))
        ],
        Side.TOP,
        coat,
    )
