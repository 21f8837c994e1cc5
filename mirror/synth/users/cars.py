"""Cars: hatchbacks, saloons, estates, sport utility vehicles, city cars, coupes, pickups and taxis."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from mirror.synth.model import Label, Material, Side, ellipsoid
from mirror.synth.users.body import Body, boxed
from mirror.synth.users.fittings import (
    BLACK,
    HEADLIGHT,
    TAIL_LIGHT,
    car_paint,
    insert,
    lamp,
    mirrors,
    number_plate,
    plates,
    rim,
    wheel,
)
from mirror.synth.users.sheets import Finish, Panel, Sheets
from mirror.synth.users.shell import DARK, PANE, End, Point, Shape, pane, shell

_CLADDING: Final = Finish((0.035, 0.035, 0.037), Material.PLAIN)
_TAXI_PAINTS: Final = ((0.62, 0.56, 0.40), (0.55, 0.33, 0.015), (0.015, 0.015, 0.017), (0.70, 0.70, 0.69))


@dataclass(frozen=True)
class Design:
    """A car as it is drawn: a shape, and what is fitted where.

    Attributes:
        shape: measures.
        windows: points of the side windows' outline in the side view, from the windscreen's foot along the waist to
            the back, and forward under the roof.
        rear_window: share of the rear window's height at which its glass begins.
        rear_inset_m: width of the pillars beside it.
        headlights_m: lower and upper edge.
        tail_lights_m: lower and upper edge.
        rear_plate_m: height of the plate's middle.
        sill: of the lowest band; None: painted as the rest.
        deck: behind the rear window; None: painted.
    """

    shape: Shape
    windows: tuple[Point, ...]
    rear_window: float
    rear_inset_m: float
    headlights_m: Point
    tail_lights_m: Point
    rear_plate_m: float
    sill: Finish | None = None
    deck: Finish | None = None


def car(rng: np.random.Generator) -> Body:
    """Any car, each kind about as often as it is seen in a city."""
    kinds = list(_SHARES)
    shares = np.array([_SHARES[kind] for kind in kinds])
    return kinds[int(rng.choice(len(kinds), p=shares / shares.sum()))](rng)


def hatchback(rng: np.random.Generator) -> Body:
    """A compact car with a steep back."""
    return _built(rng, _hatchback(rng))


def saloon(rng: np.random.Generator) -> Body:
    """A car with a boot."""
    return _built(rng, _saloon(rng))


def estate(rng: np.random.Generator) -> Body:
    """A saloon whose roof goes on to the end."""
    return _built(rng, _estate(rng))


def suv(rng: np.random.Generator) -> Body:
    """High, with large wheels and dark sills."""
    return _built(rng, _suv(rng))


def city_car(rng: np.random.Generator) -> Body:
    """Very short, with two doors."""
    return _built(rng, _city_car(rng))


def coupe(rng: np.random.Generator) -> Body:
    """Low, with a long bonnet and a sloping back."""
    return _built(rng, _coupe(rng))


def pickup(rng: np.random.Generator) -> Body:
    """A double cab with a covered bed."""
    return _built(rng, _pickup(rng))


def taxi(rng: np.random.Generator) -> Body:
    """A saloon or an estate with a sign on its roof."""
    design = _saloon(rng) if rng.random() < 0.5 else _estate(rng)
    colour = _TAXI_PAINTS[int(rng.integers(len(_TAXI_PAINTS)))]
    return _built(rng, design, paint=Finish(colour, Material.PAINT), sign=True)


_SHARES: Final[Mapping[Callable[[np.random.Generator], Body], float]] = {
    hatchback: 0.30, suv: 0.26, saloon: 0.14, estate: 0.12, city_car: 0.10, taxi: 0.04, coupe: 0.03, pickup: 0.01,
}  # fmt: skip


def _built(rng: np.random.Generator, design: Design, *, paint: Finish | None = None, sign: bool = False) -> Body:
    shape = design.shape
    coat = car_paint(rng) if paint is None else paint
    sheets = Sheets(Label.CAR, int(rng.integers(1 << 30)))
    shell(sheets, shape, coat, sill=design.sill or coat, deck=design.deck or coat)
    _windows(sheets, design)
    _face(sheets, design, coat)
    for x in shape.axles_m:
        outer = 0.5 * shape.width_m - 0.022
        wheel(sheets, x, outer, shape.wheel_m, 0.6 * shape.wheel_m, rim=rim(rng))
    front, back = (plates(rng),) * 2
    middle = shape.levels_m[1]
    number_plate(sheets, (shape.front.reach_m + 0.012, 0.0, middle - 0.02), Side.FRONT, front)
    x = float(shape.face(shape.back, 0.0, max(design.rear_plate_m - 0.06, middle))[0])
    number_plate(sheets, (x - 0.012, 0.0, design.rear_plate_m), Side.BACK, back)
    foot = shape.roof[0][0] - 0.42
    mirrors(sheets, (foot, shape.side_m(shape.waist_m) + 0.12, shape.waist_m + 0.075), coat)
    if sign:
        place = 0.5 * (shape.roof[1][0] + shape.roof[-2][0]), 0.0, max(z for _, z in shape.roof) + 0.06
        sheets.add(ellipsoid(place, (0.16, 0.48, 0.14), (0.75, 0.6, 0.12), Material.PLAIN, Label.CAR))
    return boxed("car", sheets.model())


def _windows(sheets: Sheets, design: Design) -> None:
    shape = design.shape
    panel = Panel.TWO_DOORS if shape.doors is Panel.TWO_DOORS else Panel.FOUR_DOORS
    corners = [shape.side(*point) for point in design.windows]
    sheets.sheet(corners, Side.LEFT, PANE._replace(panel=panel), texture=shape.shown, lift_m=0.004, both=True)
    foot, top = shape.waist_m, shape.roof[-2][1]
    low = foot + design.rear_window * (top - foot)
    behind = pane(shape, shape.rear_window, low, top - 0.05, design.rear_inset_m)
    sheets.sheet(behind, Side.BACK, PANE, lift_m=0.004)


def _face(sheets: Sheets, design: Design, coat: Finish) -> None:
    """Lamps, grille and air intakes."""
    shape = design.shape
    front, back = shape.front, shape.back
    low, middle = shape.levels_m[:2]
    under, over = design.headlights_m
    lamp(sheets, shape, front, HEADLIGHT, (under, over), inner=0.62, wrap=0.85, rise_m=0.03, slant_m=0.03)
    insert(sheets, shape, front, BLACK, (under - 0.06, over - 0.01), (0.5, 0.58))
    insert(sheets, shape, front, BLACK, (low + 0.05, middle - 0.09), (0.85, 0.7))
    under, over = design.tail_lights_m
    lamp(sheets, shape, back, TAIL_LIGHT, (under, over), inner=0.58, wrap=0.9, rise_m=0.01, slant_m=0.03)
    insert(sheets, shape, back, DARK, (low + 0.01, low + 0.45 * (middle - low)), (0.9, 0.8))


def _design(
    length: float,
    width: float,
    height: float,
    *,
    clearance: float,
    waist: float,
    wheel: float,
    overhangs: Point,
    cowl: float,
    screen_deg: float,
    nose: float,
    roof_end: Point,
    tail: float,
    pillar: float,
    rise: float = 0.05,
    doors: Panel = Panel.FOUR_DOORS,
    rear_window: float = 0.12,
    lean: float = 0.30,
) -> Design:
    """A design from a few measures, in metres.

    Args:
        length: of the body.
        width: of the body without mirrors.
        height: of the roof.
        clearance: of the sills.
        waist: height of the waistline.
        wheel: radius.
        overhangs: in front and behind.
        cowl: how far the windscreen's foot is ahead of the front axle.
        screen_deg: slope of the windscreen.
        nose: height of the bonnet's front edge.
        roof_end: x of the roof's end, from the tail, and how much lower it is there.
        tail: x of the rear window's foot, from the tail.
        pillar: width of the rear pillar.
        rise: how much higher the side windows begin behind.
        doors: seams of the flanks.
        rear_window: share of the rear window's height at which its glass begins.
        lean: of the sides of the greenhouse.
    """
    end = 0.5 * length
    axles = end - overhangs[0], overhangs[1] - end
    foot, crown = axles[0] + cowl, height - 0.035
    top = foot - (crown - waist) / math.tan(math.radians(screen_deg))
    back = roof_end[0] - end
    roof = (
        (foot, waist),
        (top, crown),
        (top + 0.30 * (back - top), height),
        (top + 0.70 * (back - top), height - 0.15 * roof_end[1]),
        (back, height - roof_end[1]),
        (tail - end, waist),
    )
    seam, last = axles[0] - 1.06 * wheel - 0.16, axles[1] + 0.14
    long_door = doors is Panel.TWO_DOORS
    door = (seam - 1.30, 1.30) if long_door else (0.5 * (seam + last), 0.5 * (seam - last))
    shape = Shape(
        width_m=width,
        clearance_m=clearance,
        waist_m=waist,
        wheel_m=wheel,
        axles_m=axles,
        front=End(end, (0.17, 0.30), 0.22, 0.30, 0.055, nose),
        back=End(end, (0.085, 0.26), 0.22, 0.10, 0.035, waist - 0.02),
        bonnet=((0.45 * foot + 0.55 * (end - 0.1), nose + 0.72 * (waist - nose)),),
        roof=roof,
        rail_m=height - max(0.085, roof_end[1] + 0.02),
        lean=lean,
        rail_lean=1.9,
        tuck_m=0.05,
        shoulder_m=0.055,
        doors=doors,
        door_m=door,
    )
    low, high = waist + 0.03, shape.rail_m - 0.012
    windows = (
        (shape.screen(low) - 0.14, low),
        (shape.rear_window(low + rise) + pillar, low + rise),
        (shape.rear_window(high) + pillar, high),
        (shape.screen(high) - 0.10, high),
    )
    middle = shape.levels_m[1]
    return Design(
        shape,
        windows,
        rear_window,
        0.09,
        (nose - 0.17, nose - 0.045),
        (waist - 0.23, waist - 0.07),
        0.5 * (middle + waist),
    )


def _hatchback(rng: np.random.Generator) -> Design:
    length, height = rng.uniform(4.0, 4.4), rng.uniform(1.43, 1.50)
    return _design(
        length,
        rng.uniform(1.75, 1.81),
        height,
        clearance=0.17,
        waist=0.635 * height,
        wheel=rng.uniform(0.312, 0.335),
        overhangs=(0.86, 0.74),
        cowl=rng.uniform(-0.30, -0.18),
        screen_deg=rng.uniform(27.0, 31.0),
        nose=0.74,
        roof_end=(rng.uniform(0.42, 0.60), 0.07),
        tail=0.16,
        pillar=rng.uniform(0.24, 0.36),
        rise=rng.uniform(0.03, 0.09),
    )


def _saloon(rng: np.random.Generator) -> Design:
    length, height = rng.uniform(4.6, 4.95), rng.uniform(1.42, 1.48)
    return _design(
        length,
        rng.uniform(1.80, 1.87),
        height,
        clearance=0.16,
        waist=0.655 * height,
        wheel=rng.uniform(0.325, 0.345),
        overhangs=(0.86, 1.08),
        cowl=rng.uniform(-0.46, -0.34),
        screen_deg=rng.uniform(27.0, 30.0),
        nose=0.72,
        roof_end=(rng.uniform(1.22, 1.42), 0.065),
        tail=rng.uniform(0.50, 0.66),
        pillar=0.14,
        rise=0.02,
        rear_window=0.05,
    )


def _estate(rng: np.random.Generator) -> Design:
    length, height = rng.uniform(4.55, 4.9), rng.uniform(1.45, 1.52)
    return _design(
        length,
        rng.uniform(1.80, 1.86),
        height,
        clearance=0.16,
        waist=0.64 * height,
        wheel=rng.uniform(0.322, 0.342),
        overhangs=(0.87, 1.0),
        cowl=rng.uniform(-0.44, -0.32),
        screen_deg=rng.uniform(27.0, 30.0),
        nose=0.73,
        roof_end=(rng.uniform(0.35, 0.50), 0.06),
        tail=0.155,
        pillar=rng.uniform(0.16, 0.22),
        rise=0.03,
    )


def _suv(rng: np.random.Generator) -> Design:
    length, height = rng.uniform(4.25, 4.75), rng.uniform(1.60, 1.72)
    design = _design(
        length,
        rng.uniform(1.82, 1.92),
        height,
        clearance=0.21,
        waist=0.64 * height,
        wheel=rng.uniform(0.348, 0.372),
        overhangs=(0.88, 0.86),
        cowl=rng.uniform(-0.40, -0.28),
        screen_deg=rng.uniform(31.0, 35.0),
        nose=0.90,
        roof_end=(rng.uniform(0.36, 0.56), 0.06),
        tail=0.165,
        pillar=rng.uniform(0.20, 0.32),
        rise=rng.uniform(0.03, 0.08),
        lean=0.27,
    )
    return replace(design, sill=_CLADDING if rng.random() < 0.75 else None)


def _city_car(rng: np.random.Generator) -> Design:
    length, height = rng.uniform(3.5, 3.75), rng.uniform(1.46, 1.54)
    return _design(
        length,
        rng.uniform(1.62, 1.68),
        height,
        clearance=0.165,
        waist=0.625 * height,
        wheel=rng.uniform(0.285, 0.30),
        overhangs=(0.72, 0.56),
        cowl=rng.uniform(-0.12, 0.0),
        screen_deg=rng.uniform(31.0, 35.0),
        nose=0.73,
        roof_end=(rng.uniform(0.30, 0.42), 0.06),
        tail=0.155,
        pillar=0.26,
        rise=0.06,
        doors=Panel.TWO_DOORS,
        lean=0.26,
    )


def _coupe(rng: np.random.Generator) -> Design:
    length, height = rng.uniform(4.3, 4.6), rng.uniform(1.28, 1.34)
    return _design(
        length,
        rng.uniform(1.83, 1.90),
        height,
        clearance=0.13,
        waist=0.67 * height,
        wheel=rng.uniform(0.335, 0.35),
        overhangs=(0.86, 0.92),
        cowl=rng.uniform(-0.66, -0.52),
        screen_deg=rng.uniform(26.0, 28.0),
        nose=0.70,
        roof_end=(rng.uniform(1.25, 1.45), 0.06),
        tail=rng.uniform(0.22, 0.32),
        pillar=0.52,
        rise=0.05,
        doors=Panel.TWO_DOORS,
        rear_window=0.22,
        lean=0.40,
    )


def _pickup(rng: np.random.Generator) -> Design:
    height = rng.uniform(1.78, 1.86)
    design = _design(
        rng.uniform(5.2, 5.4),
        rng.uniform(1.84, 1.90),
        height,
        clearance=0.30,
        waist=0.63 * height,
        wheel=rng.uniform(0.375, 0.39),
        overhangs=(0.90, 1.25),
        cowl=rng.uniform(-0.42, -0.34),
        screen_deg=34.0,
        nose=0.99,
        roof_end=(2.02, 0.04),
        tail=1.78,
        pillar=0.12,
        rise=0.02,
        rear_window=0.10,
        lean=0.25,
    )
    return replace(design, deck=Finish((0.02, 0.02, 0.02), Material.CLOTH), sill=_CLADDING)
