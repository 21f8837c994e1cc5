"""Cars: hatchbacks, saloons, estates, sport utility vehicles, city cars, coupes, pickups and taxis."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from mirror.synth.model import Label, Material, ellipsoid
from mirror.synth.road_users.body import Body, make_body
from mirror.synth.road_users.coachwork.design import CoachworkDesign, build_vehicle, design_car
from mirror.synth.road_users.coachwork.fittings import draw_car_paint
from mirror.synth.road_users.coachwork.sheets import Panel, SheetFinish

_CLADDING: Final = SheetFinish((0.035, 0.035, 0.037), Material.PLAIN)
_TAXI_PAINTS: Final = ((0.62, 0.56, 0.40), (0.55, 0.33, 0.015), (0.015, 0.015, 0.017), (0.60, 0.60, 0.59))


def build_car(rng: np.random.Generator) -> Body:
    """Build a car of a random kind, by the shares of city traffic."""
    kinds = list(_SHARES)
    shares = np.array([_SHARES[kind] for kind in kinds])
    return kinds[int(rng.choice(len(kinds), p=shares / shares.sum()))](rng)


def build_hatchback(rng: np.random.Generator) -> Body:
    """Build a compact car with a steep back."""
    return _paint_car(rng, _design_hatchback(rng))


def build_saloon(rng: np.random.Generator) -> Body:
    """Build a saloon."""
    return _paint_car(rng, _design_saloon(rng))


def build_estate(rng: np.random.Generator) -> Body:
    """Build an estate: its roof extends to the rear end."""
    return _paint_car(rng, _design_estate(rng))


def build_suv(rng: np.random.Generator) -> Body:
    """Build a sport utility vehicle: high, with large wheels and dark sills."""
    return _paint_car(rng, _design_suv(rng))


def build_city_car(rng: np.random.Generator) -> Body:
    """Build a city car: very short, with two doors."""
    return _paint_car(rng, _design_city_car(rng))


def build_coupe(rng: np.random.Generator) -> Body:
    """Build a coupe: low, with a long bonnet and a sloping back."""
    return _paint_car(rng, _design_coupe(rng))


def build_pickup(rng: np.random.Generator) -> Body:
    """Build a pickup with a double cab and a covered bed."""
    return _paint_car(rng, _design_pickup(rng))


def build_taxi(rng: np.random.Generator) -> Body:
    """Build a taxi: a saloon or an estate with a sign on its roof."""
    design = _design_saloon(rng) if rng.random() < 0.5 else _design_estate(rng)
    colour = _TAXI_PAINTS[int(rng.integers(len(_TAXI_PAINTS)))]
    sheets = build_vehicle(rng, design, SheetFinish(colour, Material.PAINT), Label.CAR)
    roof = design.shape.roof
    place = 0.5 * (roof[1][0] + roof[-2][0]), 0.0, max(z for _, z in roof) + 0.06
    sheets.add(ellipsoid(place, (0.16, 0.48, 0.14), (0.75, 0.6, 0.12), Material.PLAIN, Label.CAR))
    return make_body("car", sheets.model())


_SHARES: Final[Mapping[Callable[[np.random.Generator], Body], float]] = {
    build_hatchback: 0.30,
    build_suv: 0.26,
    build_saloon: 0.14,
    build_estate: 0.12,
    build_city_car: 0.10,
    build_taxi: 0.04,
    build_coupe: 0.03,
    build_pickup: 0.01,
}


def _paint_car(rng: np.random.Generator, design: CoachworkDesign) -> Body:
    return make_body("car", build_vehicle(rng, design, draw_car_paint(rng), Label.CAR).model())


def _design_hatchback(rng: np.random.Generator) -> CoachworkDesign:
    length, height = rng.uniform(4.0, 4.4), rng.uniform(1.43, 1.50)
    return design_car(
        length,
        rng.uniform(1.75, 1.81),
        height,
        clearance=0.17,
        waist=0.658 * height,
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


def _design_saloon(rng: np.random.Generator) -> CoachworkDesign:
    length, height = rng.uniform(4.6, 4.95), rng.uniform(1.42, 1.48)
    return design_car(
        length,
        rng.uniform(1.80, 1.87),
        height,
        clearance=0.16,
        waist=0.672 * height,
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


def _design_estate(rng: np.random.Generator) -> CoachworkDesign:
    length, height = rng.uniform(4.55, 4.9), rng.uniform(1.45, 1.52)
    return design_car(
        length,
        rng.uniform(1.80, 1.86),
        height,
        clearance=0.16,
        waist=0.66 * height,
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


def _design_suv(rng: np.random.Generator) -> CoachworkDesign:
    length, height = rng.uniform(4.25, 4.75), rng.uniform(1.60, 1.72)
    design = design_car(
        length,
        rng.uniform(1.82, 1.92),
        height,
        clearance=0.21,
        waist=0.66 * height,
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


def _design_city_car(rng: np.random.Generator) -> CoachworkDesign:
    length, height = rng.uniform(3.5, 3.75), rng.uniform(1.46, 1.54)
    return design_car(
        length,
        rng.uniform(1.62, 1.68),
        height,
        clearance=0.165,
        waist=0.645 * height,
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


def _design_coupe(rng: np.random.Generator) -> CoachworkDesign:
    length, height = rng.uniform(4.3, 4.6), rng.uniform(1.28, 1.34)
    return design_car(
        length,
        rng.uniform(1.83, 1.90),
        height,
        clearance=0.13,
        waist=0.685 * height,
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


def _design_pickup(rng: np.random.Generator) -> CoachworkDesign:
    height = rng.uniform(1.78, 1.86)
    design = design_car(
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
    return replace(design, deck=SheetFinish((0.02, 0.02, 0.02), Material.CLOTH), sill=_CLADDING)
