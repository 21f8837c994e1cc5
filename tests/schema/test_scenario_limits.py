"""Every number of a scenario: its default, the values that are accepted, and the next ones that are refused."""

from __future__ import annotations

import math
import tomllib
from typing import Any

import pytest
from pydantic import ValidationError

from mirror.errors import SchemaError
from mirror.schema.scenario import Scenario, encode_scenario, parse_scenario

# Place, default (`-`: it is required, `none`: it may be left out), and interval.
NUMBERS = """
version                                                1      [1, inf)
seed                                                   0      [0, 9223372036854775807]
duration_s                                             10     (0, 3600]
rate_hz                                                10     (0, 1000]
ego.speed_mps                                          0      [0, 60]
ego.start lane along_m                                 0      [0, inf)
ego.start pose x_m                                     -      (-inf, inf)
ego.start pose y_m                                     -      (-inf, inf)
ego.start pose yaw_deg                                 -      (-inf, inf)
ego.start recorded after_s                             0      [0, inf)
agent idm desired_share                                1      (0, 2]
agent idm headway_s                                    1.5    (0, 10]
agent idm max_acceleration_mps2                        1.5    (0, 10]
agent idm comfortable_deceleration_mps2                2      (0, 10]
agent idm radius_m                                     120    (0, 1000]
agent idm ahead_m                                      none   (0, 1000]
agent idm speed_mps                                    none   [0, 60]
agent cut-in trigger.ttc_s                             -      (0, 60]
agent cut-in trigger.latest_s                          none   [0, inf)
agent cut-in ahead_m                                   25     [0, 500]
agent cut-in speed_mps                                 8      [0, 60]
agent cut-in offset_m                                  3.5    (0, 10]
agent cut-in change_s                                  3      (0, 20]
agent hard-brake ahead_m                               25     (0, 500]
agent hard-brake speed_mps                             10     [0, 60]
agent hard-brake deceleration_mps2                     6      (0, 12]
agent crossing-pedestrian ahead_m                      45     (0, 500]
agent crossing-pedestrian offset_m                     5      (0, 30]
agent crossing-pedestrian speed_mps                    1.5    (0, 6]
agent oncoming-overtake ahead_m                        120    (0, 1000]
agent oncoming-overtake speed_mps                      12     (0, 60]
agent oncoming-overtake offset_m                       3.5    (0, 10]
agent oncoming-overtake change_s                       2      (0, 20]
agent oncoming-overtake stay_s                         1      [0, 60]
agent pull-out ahead_m                                 50     (0, 500]
agent pull-out offset_m                                3      (0, 10]
agent pull-out acceleration_mps2                       1.5    (0, 10]
agent pull-out speed_mps                               6      (0, 60]
agent pull-out change_s                                2.5    (0, 20]
agent stopped-queue ttc_s                              6      (0, 60]
agent stopped-queue spacing_m                          2      (0, 50]
agent attack ahead_m                                   20     [0, 500]
agent attack offset_m                                  3.5    (0, 10]
agent attack speed_mps                                 8      [0, 60]
agent attack evaluations                               50     [1, 50]
agent attack horizon_s                                 4      (0, 20]
agent attack max_acceleration_mps2                     4      (0, 12]
agent attack max_lateral_acceleration_mps2             4      (0, 12]
agent count                                            1      [1, 200]
"""
WHOLE = ("version", "seed", "evaluations", "count")
TRIGGERED = ("cut-in", "hard-brake", "crossing-pedestrian", "oncoming-overtake", "pull-out", "attack")
ROWS = [line.rsplit(maxsplit=3) for line in NUMBERS.split("\n") if line]


def texts(place: str, value: str | None) -> str:
    """A scenario in which one number is stated, or left out."""
    *kinds, name = place.split()
    said = [] if value is None else [f"{name} = {value}"]
    if place == "agent count":
        return "\n".join(["name = 'a'", "[[agents]]", "id = 'b'", *said, "behaviour = { kind = 'idm' }"])
    if not kinds:
        # The longest scenario and the slowest steps are allowed together with steps that exist.
        steps = ["duration_s = 3600"] if name == "rate_hz" else ["rate_hz = 1000"] if name == "duration_s" else []
        return "\n".join(["name = 'a'", *(steps if said else ()), *said])
    if kinds[0] == "ego.start":
        needed = [f"{key} = 0" for key in ("x_m", "y_m", "yaw_deg") if kinds[1] == "pose" and (key != name or not said)]
        inner = ", ".join([f"kind = '{kinds[1]}'", *needed, *said])
        return f"name = 'a'\nego.start = {{ {inner} }}"
    kind = kinds[1]
    parts = [f"kind = '{kind}'", *said]
    if kind in TRIGGERED and name != "trigger.ttc_s":
        parts.append("trigger.ttc_s = 3")
    category = "category = 'pedestrian'" if kind == "crossing-pedestrian" else ""
    return "\n".join(["name = 'a'", "[[agents]]", "id = 'b'", category, f"behaviour = {{ {', '.join(parts)} }}"])


def read(place: str, value: str | None) -> Any:
    """The number of a scenario after it was read, written and read again."""
    scenario = parse_scenario(texts(place, value).encode(), "own.toml")
    scenario = parse_scenario(encode_scenario(scenario), "own.toml")
    *kinds, name = place.split()
    found: Any = scenario if not kinds else scenario.ego.start if kinds[0] == "ego.start" else scenario.agents[0]
    if len(kinds) == 2 and kinds[0] == "agent":
        found = found.behaviour
    for part in name.split("."):
        found = getattr(found, part)
    return found


@pytest.mark.parametrize(("place", "default", "low", "high"), ROWS, ids=[row[0] for row in ROWS])
def test_a_number_has_its_default_and_its_limits(place: str, default: str, low: str, high: str) -> None:
    if default != "-":
        assert read(place, None) == (None if default == "none" else float(default))
    whole = place.split()[-1] in WHOLE
    lowest, highest = float(low[1:-1]), float(high[:-1])
    step = 1 if whole else None
    inside, outside = [], []
    if math.isfinite(lowest):
        above = lowest + 1 if step else math.nextafter(lowest, math.inf)
        below = lowest - 1 if step else math.nextafter(lowest, -math.inf)
        inside += [lowest, above] if low[0] == "[" else [above]
        outside += [below] if low[0] == "[" else [lowest]
    if math.isfinite(highest):
        inside.append(highest)
        outside.append(highest + 1 if step else math.nextafter(highest, math.inf))
    else:
        inside.append(1e6)
    # Times too short for one step are refused for another reason, which has its own test.
    accepted = [value for value in inside if not (place in ("duration_s", "rate_hz") and value < 1e-9)]
    for value in accepted:
        text = str(int(value)) if whole else repr(value)
        if place == "seed" and value == highest:
            text = high[:-1]
        assert read(place, text) == (int(text) if whole else value)
    for value in outside:
        text = str(int(high[:-1]) + 1) if place == "seed" and value > 0 else str(int(value)) if whole else repr(value)
        with pytest.raises(SchemaError, match=place.split()[-1].split(".")[-1]):
            read(place, text)
    for text in ("inf", "-inf", "nan"):
        with pytest.raises(SchemaError):
            read(place, text)
        with pytest.raises(ValidationError):
            Scenario.model_validate(tomllib.loads(texts(place, text)))
