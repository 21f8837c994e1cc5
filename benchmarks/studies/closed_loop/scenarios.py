"""The scenarios of the study: those that ship, at the speeds of its streets, varied by seed, with tuned triggers."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.studies.closed_loop.streets import LIGHTS, Light, Place, time_inside_s
from hybridworldsim.simulator.street.route import plan_route
from hybridworldsim.simulator.street.street import Street
from mirror.schema.scenario import EgoPlan, LaneStart, PoseStart, RecordedStart, Route, Scenario, read_scenario


@dataclass(frozen=True)
class Case:
    """A scenario with a seed, in one of the streets and lights.

    Attributes:
        scenario: name of the scenario.
        seed: the seed.
        street: index of the street.
        light: day or night.
    """

    scenario: str
    seed: int
    street: int
    light: Light


def list_cases(names: Sequence[str], seeds: Sequence[int], streets: int) -> list[Case]:
    """Return all cases, by seed: lights alternate by seed, streets by every second seed and by scenario."""
    return [
        Case(name, seed, (number + seed // 2) % streets, LIGHTS[seed % 2])
        for seed in seeds
        for number, name in enumerate(names)
    ]


def make_scenario(
    case: Case, place: Place, declared: Mapping[str, Any], speed_mps: float, rate_hz: float, scale: float
) -> Scenario:
    """Return the scenario of a case.

    Args:
        case: the case.
        place: its street.
        declared: what the declaration says of scenarios.
        speed_mps: speed of the ego at the start.
        rate_hz: steps in a second.
        scale: the tuned factor of the triggers' times to collision.
    """
    shipped = read_scenario(case.scenario)
    digest = hashlib.sha256(f"{case.scenario}/{case.seed}".encode()).digest()
    rng = np.random.default_rng(int.from_bytes(digest[:8], "little"))
    spread, speed = float(declared["spread"]), float(declared["speed_share"])
    start_m = 5.0 + float(rng.uniform(0.0, declared["start_m"]))
    document = shipped.model_dump(mode="json", exclude_none=True)
    for agent in document["agents"]:
        agent["behaviour"] |= declared["changes"].get(case.scenario, {})
        _change(agent["behaviour"], rng, spread, speed, scale)
    document |= {
        "seed": case.seed,
        "duration_s": declared["duration_s"],
        "rate_hz": rate_hz,
        "light": place.drive.condition.light,
        "weather": place.drive.condition.weather,
    }
    aside, turned = rng.uniform(-1.0, 1.0, 2).tolist()
    if isinstance(shipped.ego.start, RecordedStart):
        ego = EgoPlan(start=RecordedStart(kind="recorded", after_s=time_inside_s(place.street, start_m)))
    else:
        ego = _start_beside(
            place.street, start_m, aside * declared["start_offset_m"], turned * math.radians(declared["start_yaw_deg"])
        )
    document["ego"] = ego.model_copy(update={"speed_mps": speed_mps}).model_dump(mode="json", exclude_none=True)
    return Scenario.model_validate(document)


def _start_beside(street: Street, along_m: float, offset_m: float, turn_rad: float) -> EgoPlan:
    """The start on the longest lane straight on that was driven, moved to the left and turned to the left."""
    # As a recorded street it offers only lanes that were driven along: cameras saw nothing of the others.
    recorded = replace(street, drive=None)
    middle, route, _, _ = plan_route(recorded, EgoPlan(start=LaneStart(kind="lane", along_m=along_m)))
    x = middle.x_m - math.sin(middle.yaw_rad) * offset_m
    y = middle.y_m + math.cos(middle.yaw_rad) * offset_m
    yaw_deg = math.degrees(middle.yaw_rad + turn_rad)
    return EgoPlan(start=PoseStart(kind="pose", x_m=x, y_m=y, yaw_deg=yaw_deg), route=Route(lanes=route.lanes))


def _change(behaviour: dict[str, Any], rng: np.random.Generator, spread: float, speed: float, scale: float) -> None:
    near, late = (1.0 + spread * rng.uniform(-1.0, 1.0, 2)).tolist()
    # At a lower speed the same time to collision is a smaller distance.
    if "ahead_m" in behaviour:
        behaviour["ahead_m"] = round(behaviour["ahead_m"] * speed * near, 3)
    if "speed_mps" in behaviour and behaviour["kind"] != "crossing-pedestrian":
        behaviour["speed_mps"] = round(behaviour["speed_mps"] * speed, 3)
    for table in (behaviour, behaviour.get("trigger", {})):
        if "ttc_s" in table:
            table["ttc_s"] = round(table["ttc_s"] * scale * late, 3)
