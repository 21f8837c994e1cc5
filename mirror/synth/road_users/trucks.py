"""Trucks with the cab above the engine: box bodies, tippers, and tractors with a trailer."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.synth.model import Label, Material, Side
from mirror.synth.road_users.body import Body, make_body
from mirror.synth.road_users.coachwork.cab import Cab, add_cab_body, add_cab_fittings, add_spoiler
from mirror.synth.road_users.coachwork.fittings import (
    BLACK,
    STEEL_RIM,
    TAIL_LIGHT,
    add_number_plate,
    add_wheels,
    draw_car_paint,
    draw_plate_number,
)
from mirror.synth.road_users.coachwork.sheets import Colour, Panel, SheetFinish, Sheets
from mirror.synth.road_users.coachwork.shell import DARK
from mirror.synth.textures.catalogue import LIVERIES

_BODY_COLOURS: Final[tuple[Colour, ...]] = (
    (0.60, 0.60, 0.59),
    (0.60, 0.60, 0.59),
    (0.42, 0.43, 0.44),
    (0.05, 0.13, 0.32),
    (0.36, 0.03, 0.03),
    (0.50, 0.30, 0.02),
    (0.04, 0.17, 0.10),
)


def build_truck(rng: np.random.Generator) -> Body:
    """Build a truck of any kind."""
    kinds = (build_box_truck, build_tipper, build_articulated_truck)
    return kinds[int(rng.choice(3, p=(0.55, 0.2, 0.25)))](rng)


def build_box_truck(rng: np.random.Generator) -> Body:
    """Build a truck with two axles and a closed body, often with a company's image."""
    sheets = Sheets(Label.TRUCK, int(rng.integers(1 << 30)))
    long, high = rng.uniform(5.4, 6.6), rng.uniform(3.3, 3.6)
    number = draw_plate_number(rng)
    _add_cab(rng, sheets, Cab(long, long + 1.85, 2.72, 0.46), number)
    _add_frame(sheets, 0.1, long + 1.2)
    add_wheels(sheets, 1.75, 1.22, 0.46, 0.50, rim=STEEL_RIM, open_deg=124.0, treads=3)
    _add_box_body(sheets, (0.0, long - 0.12), (1.02, high), _draw_colour(rng), rng)
    _add_tail(sheets, 0.0, 0.62, number)
    return make_body("truck", sheets.model())


def build_tipper(rng: np.random.Generator) -> Body:
    """Build a tipper with three axles and an open skip."""
    sheets = Sheets(Label.TRUCK, int(rng.integers(1 << 30)))
    number = draw_plate_number(rng)
    _add_cab(rng, sheets, Cab(5.35, 7.25, 2.86, 0.50), number)
    _add_frame(sheets, 0.2, 6.4)
    for x in (1.15, 2.50):
        add_wheels(sheets, x, 1.23, 0.50, 0.52, rim=STEEL_RIM, open_deg=124.0)
    skip = SheetFinish(_BODY_COLOURS[int(rng.integers(3, len(_BODY_COLOURS)))], Material.METAL)
    low, high, ends = 1.12, rng.uniform(2.15, 2.45), (0.0, 5.1)
    half, top = 1.12, 1.24
    flank = [(ends[0] + 0.12, half, low), (ends[1], half, low), (ends[1], top, high), (ends[0], top, high)]
    ribs = skip._replace(material=Material.PAINT, panel=Panel.ROW)
    sheets.sheet(flank, Side.LEFT, ribs, texture=lambda places: places[:, [0, 2]] / (0.85, 1.0), both=True)
    for x, other, side in ((ends[0] + 0.12, ends[0], Side.BACK), (ends[1], ends[1], Side.FRONT)):
        sheets.sheet([(x, half, low), (x, -half, low), (other, -top, high), (other, top, high)], side, skip)
    load = SheetFinish((0.16, 0.13, 0.10), Material.GRAVEL)
    sheets.sheet(
        [
            (ends[0], top, high - 0.1),
            (ends[0], -top, high - 0.1),
            (ends[1], -top, high - 0.1),
            (ends[1], top, high - 0.1),
        ],
        Side.TOP,
        load,
    )
    # A board above the cab.
    sheets.block((ends[1], -top, high), (5.9, top, high + 0.55), skip, (Side.FRONT, Side.LEFT, Side.RIGHT, Side.TOP))
    _add_tail(sheets, 0.05, 0.72, number)
    return make_body("truck", sheets.model())


def build_articulated_truck(rng: np.random.Generator) -> Body:
    """Build a tractor with a trailer of three axles, in line."""
    sheets = Sheets(Label.TRUCK, int(rng.integers(1 << 30)))
    cab, number = Cab(14.15, 16.2, 3.05, 0.50), draw_plate_number(rng)
    add_spoiler(sheets, cab, _add_cab(rng, sheets, cab, number))
    _add_frame(sheets, 10.1, 15.4)
    _add_frame(sheets, 0.1, 9.9)
    add_wheels(sheets, 11.15, 1.23, 0.50, 0.52, rim=STEEL_RIM, open_deg=124.0)
    for x in (1.75, 3.06, 4.37):
        add_wheels(sheets, x, 1.25, 0.48, 0.40, rim=STEEL_RIM, open_deg=100.0)
    _add_box_body(sheets, (0.0, 13.6), (1.16, 3.95), _draw_colour(rng), rng)
    for x in (5.4, 7.6):
        sheets.block((x, 1.0, 0.45), (x + 2.0, 1.24, 1.0), DARK, (Side.LEFT,), both=True)
    _add_tail(sheets, 0.0, 0.66, number)
    return make_body("truck", sheets.model())


def _draw_colour(rng: np.random.Generator) -> Colour:
    return _BODY_COLOURS[int(rng.integers(len(_BODY_COLOURS)))]


def _add_cab(rng: np.random.Generator, sheets: Sheets, cab: Cab, number: int) -> SheetFinish:
    """Add a cab with its fittings; return its paint."""
    coat = draw_car_paint(rng)
    add_cab_body(sheets, cab, coat, coat if rng.random() < 0.6 else BLACK)
    add_cab_fittings(sheets, cab, number)
    return coat


def _add_frame(sheets: Sheets, back: float, front: float) -> None:
    """Add girders, tanks and other dark parts under a body."""
    sheets.block((back, -0.55, 0.55), (front, 0.55, 1.06), DARK, (Side.LEFT, Side.FRONT, Side.BACK), both=True)


def _add_box_body(
    sheets: Sheets, ends: tuple[float, float], heights: tuple[float, float], colour: Colour, rng: np.random.Generator
) -> None:
    """Add a closed body with doors at the back; two of three get an image on both sides."""
    (back, front), (low, high) = ends, heights
    half = 1.275
    wall = SheetFinish(colour, Material.PAINT, Panel.ROW)
    flank = [(back, half, low), (front, half, low), (front, half, high), (back, half, high)]
    pitch = 1.13
    sheets.sheet(flank, Side.LEFT, wall, texture=lambda places: places[:, [0, 2]] / (pitch, 1.0), both=True)
    plain = SheetFinish(colour, Material.PAINT)
    doors = plain._replace(panel=Panel.WING)
    corners = np.array([(y, z) for y, z in ((half, low), (-half, low), (-half, high), (half, high))])
    sheets.sheet(np.c_[np.full(4, back), corners], Side.BACK, doors, texture=lambda places: places[:, 1:])
    sheets.sheet(np.c_[np.full(4, front), corners], Side.FRONT, plain)
    sheets.block((back, -half, low), (front, half, high), plain, (Side.TOP, Side.BOTTOM))
    sheets.block((back, half - 0.01, low - 0.10), (front, half - 0.01, low), DARK, (Side.LEFT,), both=True)
    if rng.random() < 0.65:
        tall = 0.78 * (high - low)
        middle, foot, wide = 0.5 * (back + front), low + 0.11 * (high - low), 2.0 * tall
        livery = SheetFinish((0.7, 0.7, 0.7), Material.IMAGE, image=int(rng.choice(LIVERIES)))
        place = np.array(
            [
                (middle - 0.5 * wide, half, foot), (middle + 0.5 * wide, half, foot),
                (middle + 0.5 * wide, half, foot + tall), (middle - 0.5 * wide, half, foot + tall),
            ]
        )  # fmt: skip
        sheets.sheet(place, Side.LEFT, livery, lift_m=0.004)
        sheets.sheet(place * (1.0, -1.0, 1.0), Side.RIGHT, livery, lift_m=0.004)


def _add_tail(sheets: Sheets, x: float, z: float, number: int) -> None:
    """Add underrun bar, tail lights and plate."""
    sheets.block((x + 0.02, -1.15, z - 0.08), (x + 0.14, 1.15, z + 0.06), DARK, (Side.BACK, Side.TOP))
    lamps = [(x + 0.016, y, h) for y, h in ((0.72, z - 0.04), (1.14, z - 0.04), (1.14, z + 0.12), (0.72, z + 0.12))]
    sheets.sheet(lamps, Side.BACK, TAIL_LIGHT, both=True)
    add_number_plate(sheets, (x + 0.012, 0.0, z), Side.BACK, number)
