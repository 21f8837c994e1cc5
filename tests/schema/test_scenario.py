"""Scenarios: the shipped ones, writing and reading, and what is refused."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.errors import SchemaError, UsageError
from mirror.schema.scenario import (
    Scenario,
    encode_scenario,
    parse_scenario,
    read_scenario,
    scenario_names,
    write_scenario,
)
from tests.draws import draws

BEHAVIOURS = {
    "replay",
    "idm",
    "cut-in",
    "hard-brake",
    "crossing-pedestrian",
    "oncoming-overtake",
    "pull-out",
    "stopped-queue",
    "attack",
}


def test_ten_scenarios_ship_with_every_behaviour() -> None:
    scenarios = [read_scenario(name) for name in scenario_names()]
    assert [scenario.name for scenario in scenarios] == scenario_names()
    assert len(scenarios) == 10
    assert {agent.behaviour.kind for scenario in scenarios for agent in scenario.agents} == BEHAVIOURS
    assert len({scenario.seed for scenario in scenarios}) == 10


@pytest.mark.parametrize("name", scenario_names())
def test_a_written_scenario_reads_back(name: str, tmp_path: Path) -> None:
    scenario = read_scenario(name)
    write_scenario(tmp_path / "own.toml", scenario)
    assert read_scenario(tmp_path / "own.toml") == scenario
    assert encode_scenario(scenario) == (tmp_path / "own.toml").read_bytes()


@settings(max_examples=draws(200), deadline=None)
@given(st.text(), st.integers(0, 2**63 - 1), st.floats(0.1, 3600), st.lists(st.sampled_from(["left", "right"])))
def test_any_text_and_number_survive(text: str, seed: int, duration: float, turns: list[str]) -> None:
    scenario = Scenario.model_validate(
        {
            "name": "own",
            "description": text,
            "seed": seed,
            "duration_s": duration,
            "ego": {
                "start": {"kind": "pose", "x_m": -duration, "y_m": 1e-9, "yaw_deg": 0.0},
                "route": {"turns": turns},
            },
        }
    )
    data = encode_scenario(scenario)
    assert tomllib.loads(data.decode())["description"] == text
    assert parse_scenario(data, "own.toml") == scenario


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("name = 'a'\nspeed = 3", "speed"),
        ("name = 'a b'", "name"),
        ("name = 'a'\nduration_s = nan", "duration_s"),
        ("name = 'a'\nduration_s = 0.01", "the whole scenario"),
        ("name = 'a'\nschema_version = '2.0'", "schema_version"),
        ("name = 'a'\n[[agents]]\nid = 'b'\nbehaviour = { kind = 'fly' }", "agents.0.behaviour"),
        ("name = 'a'\n[[agents]]\nid = 'b'\nbehaviour = { kind = 'cut-in' }", "agents.0.behaviour.cut-in.trigger"),
        ("name = 'a'\n[[agents]]\nid = 'b'\ncount = 3\nbehaviour = { kind = 'replay' }", "agents.0"),
        ("name = 'a'\n[[agents]]\nid = 'ego'\nbehaviour = { kind = 'idm' }", "the whole scenario"),
        ("name = 'a'\n[[agents]]\nid = 'b'\ncategory = 'pedestrian'\nbehaviour = { kind = 'idm' }", "agents.0"),
        ("name = 'a'\n[ego.route]\nturns = ['left']\nlanes = ['x']", "ego.route"),
        ("name = 'a'\n[ego.start]\nkind = 'pose'\nx_m = inf\ny_m = 0\nyaw_deg = 0", "ego.start.pose.x_m"),
    ],
)
def test_the_key_at_fault_is_named(text: str, place: str) -> None:
    with pytest.raises(SchemaError) as refused:
        parse_scenario(text.encode(), "own.toml")
    assert refused.value.place == place
    assert refused.value.file == "own.toml"


def test_unknown_names_and_broken_files(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="hard-brake"):
        read_scenario("no-such")
    with pytest.raises(UsageError, match="cannot be read"):
        read_scenario(tmp_path / "missing.toml")
    (tmp_path / "broken.toml").write_bytes(b"name = \xff")
    with pytest.raises(SchemaError, match="not TOML"):
        read_scenario(tmp_path / "broken.toml")
