"""What is fitted to bodies: wheels, lamps, number plates, mirrors; and the colours that vehicles are painted in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.synth.model import Material, Side, ellipsoid
from mirror.synth.road_users.coachwork.sheets import Finish, Sheets
from mirror.synth.road_users.coachwork.shell import End, Shape
from mirror.synth.textures.catalogue import PLATES

PLATE_M: Final = (0.52, 0.11)
HEADLIGHT: Final = Finish((0.62, 0.63, 0.65), Material.HEADLIGHT)
TAIL_LIGHT: Final = Finish((0.30, 0.012, 0.014), Material.TAIL_LIGHT)
RUBBER: Final = Finish((0.022, 0.022, 0.023), Material.RUBBER)
BLACK: Final = Finish((0.016, 0.016, 0.017), Material.PLAIN)
# From behind, below the vehicle, a wheel's outer side is seen through the wheel.
RIM: Final = Finish((0.36, 0.37, 0.38), Material.RIM, two_sided=True)
STEEL_RIM: Final = RIM._replace(colour=(0.30, 0.31, 0.32))
_DARK_RIM: Final = RIM._replace(colour=(0.06, 0.06, 0.065))
_TYRE_CORNERS: Final = 16

# Shares of cars newly registered in Europe, rounded; tones vary from car to car.
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


def car_paint(rng: np.random.Generator) -> Finish:
    """Paint in one of the colours that cars have, as often as they have it."""
    shares = np.array([share for share, _ in _PAINTS])
    colour = np.array(_PAINTS[int(rng.choice(len(_PAINTS), p=shares / shares.sum()))][1])
    return Finish(tuple(np.clip(colour * rng.uniform(0.85, 1.15), 0.0, 0.68)), Material.PAINT)


def wheel(
    sheets: Sheets,
    x: float,
    outer_m: float,
    radius_m: float,
    width_m: float,
    *,
    rim: Finish = RIM,
    open_deg: float = 79.0,
    treads: int = 2,
) -> None:
    """A pair of wheels on the ground, of which the body hides the upper part.

    Args:
        sheets: what it is added to.
        x: of the axle.
        outer_m: y of the left wheel's outer side.
        radius_m: of the tyre.
        width_m: of the tyre.
        rim: of the wheel's outer side.
        open_deg: how far up from the ground the tread is seen, as an angle about the axle.
        treads: in how many sheets to the front, and as many to the back.
    """
    # The lowest corners of the tyre's outline lie on the ground.
    reach = radius_m / math.cos(math.pi / _TYRE_CORNERS)
    turn = 2.0 * math.pi * (np.arange(_TYRE_CORNERS) + 0.5) / _TYRE_CORNERS
    disc = np.c_[x + reach * np.sin(turn), np.full(_TYRE_CORNERS, outer_m), radius_m - reach * np.cos(turn)]
    sheets.sheet(disc, Side.LEFT, rim, both=True)
    angles = np.radians(np.linspace(180.0 / _TYRE_CORNERS, open_deg, treads + 1))
    for sign, side in ((1.0, Side.FRONT), (-1.0, Side.BACK)):
        for low, high in pairwise(angles):
            ends = [(x + sign * reach * math.sin(angle), radius_m - reach * math.cos(angle)) for angle in (low, high)]
            corners = [
                (ex, y, ez) for (ex, ez), ys in zip(ends, ((0, 1), (1, 0))) for y in _between(outer_m, width_m, ys)
            ]
            sheets.sheet(corners, side, RUBBER, both=True)


def _between(outer_m: float, width_m: float, order: tuple[int, int]) -> list[float]:
    return [outer_m - width_m * share for share in order]


def rim(rng: np.random.Generator) -> Finish:
    """Light alloy, or now and then black."""
    return _DARK_RIM if rng.random() < 0.22 else RIM._replace(colour=tuple(np.full(3, rng.uniform(0.26, 0.46))))


def lamp(
    sheets: Sheets,
    shape: Shape,
    end: End,
    finish: Finish,
    heights_m: tuple[float, float],
    *,
    inner: float,
    wrap: float,
    rise_m: float = 0.0,
    slant_m: float = 0.0,
) -> None:
    """A pair of lamps that go round the corners.

    Args:
        sheets: what it is added to.
        shape: of the body.
        end: front or back.
        finish: of the lamps.
        heights_m: of the lower and the upper edge at the corner's inner end.
        inner: share of the front's half width at which it ends.
        wrap: share of the corner that it covers.
        rise_m: how much higher its outer end is.
        slant_m: how much narrower it is at its inner end.
    """
    side = Side.FRONT if end is shape.front else Side.BACK
    low, high = heights_m
    front = [
        shape.face(end, inner, low + 0.5 * slant_m), shape.face(end, 1.0, low),
        shape.face(end, 1.0, high), shape.face(end, inner, high - 0.5 * slant_m),
    ]  # fmt: skip
    sheets.sheet(front, side, finish, lift_m=0.004, both=True)
    round_ = [
        shape.bend(end, 0.0, low), shape.bend(end, wrap, low + rise_m),
        shape.bend(end, wrap, high + rise_m), shape.bend(end, 0.0, high),
    ]  # fmt: skip
    sheets.sheet(round_, side, finish, lift_m=0.004, both=True)


def insert(
    sheets: Sheets,
    shape: Shape,
    end: End,
    finish: Finish,
    heights_m: tuple[float, float],
    widths: tuple[float, float],
    *,
    lift_m: float = 0.003,
) -> None:
    """Something flat on the front or the back: a grille, an air intake; as wide as these shares at its foot and top."""
    side = Side.FRONT if end is shape.front else Side.BACK
    low, high = (shape.face(end, share, z) for share, z in zip(widths, heights_m))
    mirror = np.array([1.0, -1.0, 1.0])
    sheets.sheet([low, low * mirror, high * mirror, high], side, finish, lift_m=lift_m)


def number_plate(sheets: Sheets, middle: Sequence[float], side: Side, number: int, *, share: float = 1.0) -> None:
    """An upright number plate, facing forwards or backwards; ``share`` of a car's in size."""
    x, y, z = middle
    half, tall = 0.5 * share * PLATE_M[0], 0.5 * share * PLATE_M[1]
    corners: Float64 = np.array([(x, y + a * half, z + b * tall) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    sheets.sheet(corners, side, Finish((0.8, 0.8, 0.8), Material.IMAGE, image=number))


def plates(rng: np.random.Generator) -> int:
    """A number."""
    return int(rng.choice(PLATES))


def mirrors(sheets: Sheets, place: Sequence[float], finish: Finish, size: Sequence[float] = (0.12, 0.20, 0.14)) -> None:
    """Outside mirrors, with their housings' middles at a place on the left and mirrored from it."""
    x, y, z = place
    for side in (y, -y):
        sheets.add(ellipsoid((x, side, z), size, finish.colour, finish.material, sheets.label, seed=sheets.seed))
