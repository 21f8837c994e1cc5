"""Vans: high-roofed and compact delivery vans, and minibuses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mirror.portable import scalars
from mirror.synth.model import Label, Material, Side
from mirror.synth.road_users.body import Body, make_body
from mirror.synth.road_users.coachwork.design import CoachworkDesign, build_vehicle
from mirror.synth.road_users.coachwork.fittings import draw_car_paint
from mirror.synth.road_users.coachwork.sheets import Panel, SheetFinish, Sheets
from mirror.synth.road_users.coachwork.shell import PANE, End, Point, Shape
from mirror.synth.textures.catalogue import LIVERIES

_WHITE = SheetFinish((0.60, 0.60, 0.59), Material.PAINT)
_BUMPER = SheetFinish((0.05, 0.05, 0.052), Material.PLAIN)


def build_van(rng: np.random.Generator) -> Body:
    """Build a van of any kind."""
    kinds = (build_delivery_van, build_compact_van, build_minibus)
    return kinds[int(rng.choice(3, p=(0.55, 0.3, 0.15)))](rng)


def build_delivery_van(rng: np.random.Generator) -> Body:
    """Build a high-roofed van, mostly white, often with a company's image on its sides."""
    length, height = rng.uniform(5.4, 6.1), rng.uniform(2.42, 2.65)
    design = design_van(
        length, 2.0, height, waist=1.22, wheel=0.345, overhangs=(1.0, 1.02), cowl=0.12, screen_deg=44.0, nose=1.02
    )
    return _paint_van(rng, design, _WHITE if rng.random() < 0.65 else draw_car_paint(rng), livery_m=(1.9, 0.55))


def build_compact_van(rng: np.random.Generator) -> Body:
    """Build a compact van on a car's wheels."""
    length, height = rng.uniform(4.3, 4.6), rng.uniform(1.80, 1.90)
    design = design_van(
        length, 1.82, height, waist=1.06, wheel=0.315, overhangs=(0.90, 0.75), cowl=-0.10, screen_deg=36.0, nose=0.86
    )
    return _paint_van(rng, design, _WHITE if rng.random() < 0.5 else draw_car_paint(rng), livery_m=(1.1, 0.5))


def build_minibus(rng: np.random.Generator) -> Body:
    """Build a van with seats and windows along its whole length."""
    design = design_van(
        rng.uniform(4.9, 5.3), 1.93, rng.uniform(1.94, 2.02),
        waist=1.10, wheel=0.335, overhangs=(0.92, 0.98), cowl=-0.02, screen_deg=38.0, nose=0.90,
    )  # fmt: skip
    sheets = build_vehicle(rng, design, draw_car_paint(rng), Label.VAN)
    shape = design.shape
    low, high = shape.waist_m + 0.05, shape.rail_m - 0.03
    ahead = shape.door_m[0] - 0.06
    outline = (
        (shape.rear_window(low) + 0.12, low),
        (ahead, low),
        (ahead, high),
        (shape.rear_window(high) + 0.12, high),
    )
    sheets.sheet(
        [shape.side(*point) for point in outline],
        Side.LEFT,
        PANE._replace(panel=Panel.ROW),
        texture=lambda places: (places[:, [0, 2]] - (ahead, 0.5 * (low + high))) / (1.25, 1.0),
        lift_m=0.004,
        both=True,
    )
    return make_body("van", sheets.model())


def _paint_van(
    rng: np.random.Generator, design: CoachworkDesign, coat: SheetFinish, livery_m: tuple[float, float]
) -> Body:
    """Paint a van; two of three get an image on their sides, sized by a width and a share of the sides' height."""
    sheets = build_vehicle(rng, design, coat, Label.VAN)
    if rng.random() < 0.65:
        shape = design.shape
        middle = 0.5 * (shape.rear_window(shape.waist_m) + shape.door_m[0]) - 0.05
        tall = 0.5 * livery_m[0]
        low = 0.5 * (shape.waist_m + shape.rail_m) - livery_m[1] * tall
        ends = (middle - 0.5 * livery_m[0], middle + 0.5 * livery_m[0])
        add_livery(sheets, shape, ends, (low, min(low + tall, shape.rail_m - 0.02)), int(rng.choice(LIVERIES)))
    return make_body("van", sheets.model())


def add_livery(sheets: Sheets, shape: Shape, ends_m: Point, heights_m: Point, image: int) -> None:
    """Add an image on both sides of the greenhouse, between two x positions and two heights."""
    finish = SheetFinish((0.7, 0.7, 0.7), Material.IMAGE, image=image)
    (back, front), (low, high) = ends_m, heights_m
    left = np.array([shape.side(*point) for point in ((back, low), (front, low), (front, high), (back, high))])
    sheets.sheet(left, Side.LEFT, finish, lift_m=0.004)
    sheets.sheet(left * (1.0, -1.0, 1.0), Side.RIGHT, finish, lift_m=0.004)


def design_van(
    length: float,
    width: float,
    height: float,
    *,
    waist: float,
    wheel: float,
    overhangs: Point,
    cowl: float,
    screen_deg: float,
    nose: float,
) -> CoachworkDesign:
    """Design a box with a short bonnet; see `design_car` for the measures, in metres."""
    end = 0.5 * length
    axles = end - overhangs[0], overhangs[1] - end
    foot, brow = axles[0] + cowl, min(height - 0.06, waist + 0.86)
    rail = height - 0.14
    top = foot - (brow - waist) / scalars.tan(math.radians(screen_deg))
    roof: Sequence[Point] = (
        (foot, waist), (top, brow), (top - 0.05 - 1.8 * (height - brow), height),
        (0.28 - end, height - 0.02), (0.10 - end, waist),
    )  # fmt: skip
    seam = axles[0] - 1.06 * wheel - 0.10
    shape = Shape(
        width_m=width,
        clearance_m=0.19,
        waist_m=waist,
        wheel_m=wheel,
        axles_m=axles,
        front=End(end, (0.20, 0.34), 0.15, 0.22, 0.05, nose),
        back=End(end, (0.03, 0.12), 0.02, 0.02, 0.0, waist - 0.005),
        bonnet=(),
        roof=tuple(roof),
        rail_m=rail,
        lean=0.09,
        rail_lean=1.2,
        tuck_m=0.02,
        shoulder_m=0.03,
        doors=Panel.SLIDING_DOOR,
        door_m=(seam - 1.02, 1.02),
    )
    low, high = waist + 0.04, rail - 0.05
    windows = (
        (shape.screen(low) - 0.20, low), (seam - 1.0, low), (seam - 1.0, min(high, waist + 0.72)),
        (shape.screen(min(high, waist + 0.72)) - 0.12, min(high, waist + 0.72)),
    )  # fmt: skip
    design = CoachworkDesign(
        shape, windows, 0.12, 0.16, (nose - 0.22, nose - 0.05), (waist - 0.42, waist - 0.06), waist - 0.50, sill=_BUMPER
    )
    return replace(design, mirror_m=(0.28, 0.16), mirrors_painted=False)
