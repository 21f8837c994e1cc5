"""Designs of vehicles: a shape with windows, lamps, wheels and number plates."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mirror.portable import scalars
from mirror.synth.model import Label, Side
from mirror.synth.road_users.coachwork.fittings import (
    BLACK,
    HEADLIGHT,
    TAIL_LIGHT,
    add_insert,
    add_lamps,
    add_mirrors,
    add_number_plate,
    add_wheels,
    draw_plate_number,
    draw_rim,
)
from mirror.synth.road_users.coachwork.sheets import Panel, SheetFinish, Sheets
from mirror.synth.road_users.coachwork.shell import DARK, PANE, End, Point, Shape, add_shell, window_corners


@dataclass(frozen=True)
class CoachworkDesign:
    """A shape and the positions of its fittings.

    Attributes:
        shape: measures of the body.
        windows: outline of the side windows in the side view, from the windscreen's foot along the waist to the back,
            and forward under the roof.
        rear_window: share of the rear window's height at which its glass begins.
        rear_inset_m: width of the pillars beside the rear window.
        headlights_m: lower and upper edge of the headlights.
        tail_lights_m: lower and upper edge of the tail lights.
        rear_plate_m: height of the rear plate's middle.
        sill: finish of the lowest band; None: the body's paint.
        deck: finish behind the rear window; None: the body's paint.
        mirror_m: distance of the mirrors behind the windscreen's foot, and their height above the waist.
        mirrors_painted: whether the mirrors have the body's paint.
    """

    shape: Shape
    windows: tuple[Point, ...]
    rear_window: float
    rear_inset_m: float
    headlights_m: Point
    tail_lights_m: Point
    rear_plate_m: float
    sill: SheetFinish | None = None
    deck: SheetFinish | None = None
    mirror_m: Point = (0.42, 0.075)
    mirrors_painted: bool = True


def build_vehicle(rng: np.random.Generator, design: CoachworkDesign, coat: SheetFinish, label: Label) -> Sheets:
    """Build a complete vehicle in its paint."""
    shape = design.shape
    sheets = Sheets(label, int(rng.integers(1 << 30)))
    add_body(sheets, design, coat)
    _add_face(sheets, design)
    metal = draw_rim(rng)
    for x in shape.axles_m:
        add_wheels(sheets, x, 0.5 * shape.width_m - 0.022, shape.wheel_m, 0.6 * shape.wheel_m, rim=metal)
    number = draw_plate_number(rng)
    middle = shape.levels_m[1]
    add_number_plate(sheets, (shape.front.reach_m + 0.012, 0.0, middle - 0.02), Side.FRONT, number)
    x = float(shape.face(shape.back, 0.0, max(design.rear_plate_m - 0.06, middle))[0])
    add_number_plate(sheets, (x - 0.012, 0.0, design.rear_plate_m), Side.BACK, number)
    place = (
        shape.roof[0][0] - design.mirror_m[0],
        shape.side_m(shape.waist_m) + 0.12,
        shape.waist_m + design.mirror_m[1],
    )
    add_mirrors(sheets, place, coat if design.mirrors_painted else BLACK)
    return sheets


def add_body(sheets: Sheets, design: CoachworkDesign, coat: SheetFinish) -> None:
    """Add the body with its windows."""
    shape = design.shape
    add_shell(sheets, shape, coat, sill=design.sill or coat, deck=design.deck or coat)
    corners = [shape.side(*point) for point in design.windows]
    sheets.sheet(
        corners, Side.LEFT, PANE._replace(panel=shape.doors), texture=shape.flank_texture, lift_m=0.004, both=True
    )
    foot, top = shape.waist_m, shape.roof[-2][1]
    low = foot + design.rear_window * (top - foot)
    behind = window_corners(shape, shape.rear_window, low, top - 0.05, design.rear_inset_m)
    sheets.sheet(behind, Side.BACK, PANE, lift_m=0.004)


def _add_face(sheets: Sheets, design: CoachworkDesign) -> None:
    """Add lamps, grille and air intakes."""
    shape = design.shape
    front, back = shape.front, shape.back
    low, middle = shape.levels_m[:2]
    under, over = design.headlights_m
    add_lamps(sheets, shape, front, HEADLIGHT, (under, over), inner=0.62, wrap=0.85, rise_m=0.03, slant_m=0.03)
    add_insert(sheets, shape, front, BLACK, (under - 0.06, over - 0.01), (0.5, 0.58))
    add_insert(sheets, shape, front, BLACK, (low + 0.05, middle - 0.09), (0.85, 0.7))
    under, over = design.tail_lights_m
    add_lamps(sheets, shape, back, TAIL_LIGHT, (under, over), inner=0.58, wrap=0.9, rise_m=0.01, slant_m=0.03)
    add_insert(sheets, shape, back, DARK, (low + 0.01, low + 0.45 * (middle - low)), (0.9, 0.8))


def design_car(
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
) -> CoachworkDesign:
    """Design a car from a few measures, in metres.

    Args:
        length: length of the body.
        width: width of the body without mirrors.
        height: height of the roof.
        clearance: height of the sills.
        waist: height of the waistline.
        wheel: radius of the wheels.
        overhangs: front and rear overhang.
        cowl: distance of the windscreen's foot ahead of the front axle.
        screen_deg: slope of the windscreen.
        nose: height of the bonnet's front edge.
        roof_end: distance of the roof's end from the tail, and how much lower the roof is there.
        tail: distance of the rear window's foot from the tail.
        pillar: width of the rear pillar.
        rise: additional height of the side windows' lower edge at the back.
        doors: seams of the flanks.
        rear_window: share of the rear window's height at which its glass begins.
        lean: inward lean of the greenhouse's sides.
    """
    end = 0.5 * length
    axles = end - overhangs[0], overhangs[1] - end
    foot, crown = axles[0] + cowl, height - 0.035
    top = foot - (crown - waist) / scalars.tan(math.radians(screen_deg))
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
        tuck_m=0.022,
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
    return CoachworkDesign(
        shape,
        windows,
        rear_window,
        0.09,
        (nose - 0.17, nose - 0.045),
        (waist - 0.23, waist - 0.07),
        0.5 * (middle + waist),
    )
