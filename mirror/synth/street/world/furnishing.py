"""Places lamps, lights, signs and small furniture at a plan's spots."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.portable import arrays, scalars
from mirror.synth.model import Model
from mirror.synth.seeds import random_stream
from mirror.synth.street import furniture
from mirror.synth.street.furniture import LampKind, LampPost, SignalHead
from mirror.synth.street.furniture.small import Maker
from mirror.synth.street.lots import Spot
from mirror.synth.street.plan import StreetPlan
from mirror.synth.textures.catalogue import Sign

_SIGNS: Final[dict[str, tuple[tuple[Sign, ...], ...]]] = {
    "urban": (
        (Sign.SPEED_30,), (Sign.SPEED_50,), (Sign.NO_PARKING,), (Sign.PARKING,), (Sign.PRIORITY,), (Sign.CHILDREN,),
        (Sign.PRIORITY, Sign.NO_PARKING), (Sign.CROSSING_AHEAD, Sign.SPEED_30), (Sign.CYCLE_PATH,), (Sign.ONE_WAY,),
    ),
    "campus": ((Sign.SPEED_30,), (Sign.PARKING,), (Sign.NO_PARKING,), (Sign.CYCLE_PATH,), (Sign.CHILDREN,)),
    "rural": ((Sign.SPEED_80,), (Sign.BEND,), (Sign.BEND, Sign.SPEED_50), (Sign.PRIORITY,)),
    "highway": ((Sign.SPEED_120,), (Sign.SPEED_80,)),
}  # fmt: skip
"""Combinations of signs on a pole; one is chosen for each sign spot."""

_THINGS: Final[dict[str, tuple[Maker, ...]]] = {
    "urban": (
        *furniture.PAVEMENT, furniture.bench, furniture.bin_, furniture.bollards, furniture.planter,
        furniture.bicycle_stands, furniture.cafe_table, furniture.cafe_table, furniture.city_light,
        furniture.city_light, furniture.advertising_column,
    ),
    "campus": (*furniture.PARK, furniture.bench, furniture.bicycle_stands, furniture.city_light),
    "rural": (*furniture.ROADSIDE, furniture.billboard),
    "highway": (furniture.electrical_box, furniture.high_billboard),
}  # fmt: skip
"""Builders of small furniture; one is chosen for each spot. Common ones are listed twice."""

_TO_TRAFFIC: Final = frozenset((furniture.billboard, furniture.high_billboard, furniture.city_light))
"""Objects that face oncoming traffic instead of the road."""
_AWAY_M: Final[dict[Maker, float]] = {
    furniture.billboard: 2.6,
    furniture.high_billboard: 7.5,
    furniture.cafe_table: 0.75,
    furniture.advertising_column: 0.4,
}
"""Additional distance of wide objects from the road, metres."""
_MAIN_REACH_M: Final = 3.0
"""Spots with a larger reach than this belong to main streets."""
_SHELTERS: Final = 3


@dataclass(frozen=True)
class Furniture:
    """Furniture at the spots of a plan.

    Attributes:
        lamps: street lamps, in the world frame.
        signals: signal groups and their traffic lights, in the world frame.
        others: all other models.
    """

    lamps: tuple[LampPost, ...]
    signals: tuple[tuple[int, SignalHead], ...]
    others: tuple[Model, ...]


def furnish(plan: StreetPlan, seed: int) -> Furniture:
    """Build furniture for a plan's spots and rails.

    Args:
        plan: plan of the scene.
        seed: seed of all random choices.
    """
    lamps: list[LampPost] = []
    signals: list[tuple[int, SignalHead]] = []
    others: list[Model] = [_build_rail(plan, number, seed) for number in range(len(plan.rails))]
    shelters = 0
    for number, spot in enumerate(plan.spots):
        rng = random_stream("spots", seed, 22, number)
        if spot.kind == "lamp":
            lamps.append(_build_lamp(plan, spot))
        elif spot.kind == "signal":
            head = furniture.traffic_light(_road_side(spot) * spot.reach_m)
            placed = SignalHead(_place_at(spot, head.model, spot.facing_rad), head.red, head.amber, head.green)
            signals.append((0 if spot.group is None else spot.group, placed))
        elif spot.kind == "bus_stop" or (
            spot.kind == "furniture" and plan.kind == "urban" and shelters < _SHELTERS and _is_main(spot)
            and rng.random() < 0.12
        ):  # fmt: skip
            shelters += 1
            others.append(_place_at(spot, furniture.bus_shelter(rng), spot.yaw_rad, away_m=0.45))
        elif spot.kind not in ("tree", "pole"):
            others.append(_build_thing(plan, spot, rng))
    poles = [spot.place for spot in plan.spots if spot.kind == "pole"]
    if poles:
        others.append(furniture.power_line(np.array(poles)))
    return Furniture(tuple(lamps), tuple(signals), tuple(others))


def _build_thing(plan: StreetPlan, spot: Spot, rng: np.random.Generator) -> Model:
    """A sign or small object at a spot."""
    if spot.kind == "furniture":
        makers = _THINGS[plan.kind]
        maker = makers[int(rng.integers(len(makers)))]
        yaw = spot.facing_rad if maker in _TO_TRAFFIC else spot.yaw_rad
        return _place_at(spot, maker(rng), yaw, away_m=_AWAY_M.get(maker, 0.0))
    if spot.kind == "gantry":
        return _place_at(spot, furniture.gantry(rng, _road_side(spot) * spot.reach_m), spot.facing_rad)
    if spot.kind == "exit":
        return _place_at(spot, furniture.direction_sign(rng), spot.facing_rad)
    if spot.kind == "sign":
        if rng.random() < 0.12:
            return _place_at(spot, furniture.direction_sign(rng, width_m=1.6, low_m=2.2), spot.facing_rad)
        kinds = _SIGNS[plan.kind]
        return _place_at(spot, _cached_signs(kinds[int(rng.integers(len(kinds)))]), spot.facing_rad)
    sign = {"yield": Sign.YIELD, "stop": Sign.STOP, "crosswalk": Sign.CROSSWALK}[spot.kind]
    return _place_at(spot, _cached_signs((sign,)), spot.facing_rad)


def _build_rail(plan: StreetPlan, number: int, seed: int) -> Model:
    rail, rng = plan.rails[number], random_stream("rails", seed, 23, number)
    if rail.kind == "guard":
        return furniture.guard_rail(rail.line)
    if rail.kind == "fence":
        return furniture.fence(rng, rail.line)
    return furniture.garden_wall(rng, rail.line)


def _build_lamp(plan: StreetPlan, spot: Spot) -> LampPost:
    if plan.kind == "campus":
        post = _cached_lamp_post("column", 4.6, 0.0)
    elif _is_main(spot):
        post = _cached_lamp_post("arm", 8.0, round(min(0.7 * spot.reach_m, 2.4), 1))
    else:
        post = _cached_lamp_post("lantern", 4.4, 0.0)
    cos, sin = scalars.cos(spot.yaw_rad), scalars.sin(spot.yaw_rad)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return LampPost(_place_at(spot, post.model, spot.yaw_rad), arrays.matmul(post.lights, turn.T) + spot.place)


@cache
def _cached_lamp_post(kind: LampKind, height_m: float, reach_m: float) -> LampPost:
    return furniture.lamp_post(kind, height_m=height_m, reach_m=reach_m)


@cache
def _cached_signs(signs: tuple[Sign, ...]) -> Model:
    return furniture.traffic_sign(signs)


def _is_main(spot: Spot) -> bool:
    return spot.reach_m > _MAIN_REACH_M


def _road_side(spot: Spot) -> float:
    """The side, 1 or -1 along y, on which an object that faces the traffic has the road."""
    return math.copysign(1.0, scalars.sin(spot.yaw_rad - spot.facing_rad))


def _place_at(spot: Spot, model: Model, yaw_rad: float, *, away_m: float = 0.0) -> Model:
    """A model moved to a spot, or ``away_m`` farther from the road."""
    place: Float64 = spot.place - away_m * np.array([scalars.cos(spot.yaw_rad), scalars.sin(spot.yaw_rad), 0.0])
    return model.place(float(place[0]), float(place[1]), float(place[2]), yaw_rad)
