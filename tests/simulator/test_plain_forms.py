"""Agents look ahead as plain Python where the machine code is not cached, with the same bits."""

from __future__ import annotations

import pytest

from hybridworldsim.simulator.agents import on_ways
from hybridworldsim.simulator.policies.references import LaneKeeping
from hybridworldsim.simulator.simulation import start_simulation
from tests.plain_forms import compare_forms
from tests.simulator.streets import scenario, straight_street


def test_both_forms_of_the_corridor_give_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = compare_forms(monkeypatch, on_ways)
    traffic = {"id": "traffic", "count": 12, "behaviour": {"kind": "idm", "radius_m": 150.0}}
    simulation = start_simulation(straight_street(), scenario(traffic, along_m=200.0, duration_s=4.0))
    policy = LaneKeeping()
    policy.reset(simulation.observation_spec({}))
    while simulation.advance(policy.act(simulation.observe({}, privileged=True))) is None:
        pass
    # Those of `corridor` that it imports call the others.
    assert calls["follow"] > 5
    assert calls["poses_on_ways"] > 5
