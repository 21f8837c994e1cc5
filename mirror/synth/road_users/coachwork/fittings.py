"""Fittings of vehicle bodies: wheels, lamps, number plates and mirrors; and the paints of vehicles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.portable import arrays, scalars
from mirror.synth.model import Material, Side, ellipsoid
from mirror.synth.road_users.coachwork.sheets import SheetFinish, Sheets
from mirror.synth.road_users.coachwork.shell import End, Shape
from mirror.synth.textures.catalogue import PLATES

PLATE_M: Final = (0.52, 0.11)
HEADLIGHT: Final = SheetFinish((0.62, 0.63, 0.65), Material.HEADLIGHT)
TAIL_LIGHT: Final = SheetFinish((0.30, 0.012, 0.014), Material.TAIL_LIGHT)
RUBBER: Final = SheetFinish((0.022, 0.022, 0.023), Material.RUBBER)
BLACK: Final = SheetFinish((0.016, 0.016, 0.017), Material.PLAIN)
# Two-sided: from behind, below the vehicle, the outer side of a wheel is visible through the wheel.
RIM: Final = SheetFinish((0.36, 0.37, 0.38), Material.RIM, two_sided=True)
STEEL_RIM: Final = RIM._replace(colour=(0.30, 0.31, 0.32))
_DARK_RIM: Final = RIM._replace(colour=(0.06, 0.06, 0.065))
_TYRE_CORNERS: Final = 16

# Shares of newly registered cars in Europe, rounded; tones vary from car to car.
_PAINTS: Final[tuple[tuple[float, tuple[float, float, float]], ...]] = (
    (0.24, (0.60, 0.60, 0.59)),
    (0.21, (0.014, 0.014, 0.016)),
    (0.17, (0.115, 0.12, 0.127)),
    (0.07, (0.045, 0.048, 0.054)),
    (0.12, (0.40, 0.41, 0.42)),
    (0.07, (0.020, 0.050, 0.150)),
    (0.03, (0.060, 0.150, 0.270)),
    (0.06, (0.270, 0.012, 0.016)),
    (0.02, (0.025, 0.070, 0.045)),
    (0.03, (0.200, 0.165, 0.120)),
    (0.01, (0.500, 0.180, 0.015)),
)


def draw_car_paint(rng: np.random.Generator) -> SheetFinish:
    """Draw a car's paint, by the shares of newly registered cars."""
    shares = np.array([share for share, _ in _PAINTS])
    colour = np.array(_PAINTS[int(rng.choice(len(_PAINTS), p=shares / shares.sum()))][1])
    return SheetFinish(tuple(np.clip(colour * rng.uniform(0.85, 1.15), 0.0, 0.68)), Material.PAINT)


def add_wheels(
    sheets: Sheets,
    x: float,
    outer_m: float,
    radius_m: float,
    width_m: float,
    *,
    rim: SheetFinish = RIM,
    open_deg: float = 79.0,
    treads: int = 2,
) -> None:
    """Add a pair of wheels on the ground; the body hides their upper parts.

    Args:
        sheets: the sheets to add to.
        x: x of the axle.
        outer_m: y of the left wheel's outer side.
        radius_m: radius of the tyre.
        width_m: width of the tyre.
        rim: finish of the wheel's outer side.
        open_deg: angle around the axle, up from the ground, over which the tread is visible.
        treads: number of sheets of the tread towards the front, and the same number towards the back.
    """
    # The lowest corners of the tyre's outline lie on the ground.
    reach = radius_m / scalars.cos(math.pi / _TYRE_CORNERS)
    turn = 2.0 * math.pi * (np.arange(_TYRE_CORNERS) + 0.5) / _TYRE_CORNERS
    disc = np.c_[x + reach * arrays.sin(turn), np.full(_TYRE_CORNERS, outer_m), radius_m - reach * arrays.cos(turn)]
    sheets.sheet(disc, Side.LEFT, rim, both=True)
    angles = np.radians(np.linspace(180.0 / _TYRE_CORNERS, open_deg, treads + 1))
    for sign, side in ((1.0, Side.FRONT), (-1.0, Side.BACK)):
        for low, high in pairwise(angles):
            ends = [
                (x + sign * reach * scalars.sin(angle), radius_m - reach * scalars.cos(angle)) for angle in (low, high)
            ]
            corners = [
                (ex, y, ez) for (ex, ez), ys in zip(ends, ((0, 1), (1, 0))) for y in _tread_sides(outer_m, width_m, ys)
            ]
            sheets.sheet(corners, side, RUBBER, both=True)


def _tread_sides(outer_m: float, width_m: float, order: tuple[int, int]) -> list[float]:
    return [outer_m - width_m * share for share in order]


def draw_rim(rng: np.random.Generator) -> SheetFinish:
    """Draw a rim: light alloy, or less often black."""
    return _DARK_RIM if rng.random() < 0.22 else RIM._replace(colour=tuple(np.full(3, rng.uniform(0.26, 0.46))))


def add_lamps(
    sheets: Sheets,
    shape: Shape,
    end: End,
    finish: SheetFinish,
    heights_m: tuple[float, float],
    *,
    inner: float,
    wrap: float,
    rise_m: float = 0.0,
    slant_m: float = 0.0,
) -> None:
    """Add a pair of lamps that wrap around the corners.

    Args:
        sheets: the sheets to add to.
        shape: measures of the body.
        end: front or back.
        finish: finish of the lamps.
        heights_m: lower and upper edge at the corner's inner end.
        inner: inner end of the lamp, as a share of the front's half width.
        wrap: share of the corner that the lamp covers.
        rise_m: additional height at its outer end.
        slant_m: reduction of its height at its inner end.
    """
    side = Side.FRONT if end is shape.front else Side.BACK
    low, high = heights_m
    front = [
        shape.face(end, inner, low + 0.5 * slant_m), shape.face(end, 1.0, low),
        shape.face(end, 1.0, high), shape.face(end, inner, high - 0.5 * slant_m),
    ]  # fmt: skip
    sheets.sheet(front, side, finish, lift_m=0.004, both=True)
    round_ = [
        shape.corner_point(end, 0.0, low), shape.corner_point(end, wrap, low + rise_m),
        shape.corner_point(end, wrap, high + rise_m), shape.corner_point(end, 0.0, high),
    ]  # fmt: skip
    sheets.sheet(round_, side, finish, lift_m=0.004, both=True)


def add_insert(
    sheets: Sheets,
    shape: Shape,
    end: End,
    finish: SheetFinish,
    heights_m: tuple[float, float],
    widths: tuple[float, float],
    *,
    lift_m: float = 0.003,
) -> None:
    """Add a flat part on the front or the back (grille, air intake); ``widths`` are shares at its foot and top."""
    side = Side.FRONT if end is shape.front else Side.BACK
    low, high = (shape.face(end, share, z) for share, z in zip(widths, heights_m))
    mirror = np.array([1.0, -1.0, 1.0])
    sheets.sheet([low, low * mirror, high * mirror, high], side, finish, lift_m=lift_m)


def add_number_plate(sheets: Sheets, middle: Sequence[float], side: Side, number: int, *, share: float = 1.0) -> None:
    """Add an upright number plate that faces forwards or backwards; ``share`` is its size relative to a car's."""
    x, y, z = middle
    half, tall = 0.5 * share * PLATE_M[0], 0.5 * share * PLATE_M[1]
    corners: Float64 = np.array([(x, y + a * half, z + b * tall) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    sheets.sheet(corners, side, SheetFinish((0.8, 0.8, 0.8), Material.IMAGE, image=number))


def draw_plate_number(rng: np.random.Generator) -> int:
    """Draw the number of a plate."""
    return int(rng.choice(PLATES))


def add_mirrors(
    sheets: Sheets, place: Sequence[float], finish: SheetFinish, size: Sequence[float] = (0.12, 0.20, 0.14)
) -> None:
    """Add outside mirrors, with housings centred at a position on the left and at its mirror image on the right."""
    x, y, z = place
    for side in (y, -y):
        sheets.add(ellipsoid((x, side, z), size, finish.colour, finish.material, sheets.label, seed=sheets.seed))
