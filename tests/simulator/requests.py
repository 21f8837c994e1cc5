"""Requests of rollouts on a straight street."""

from __future__ import annotations

from dataclasses import replace

from hybridworldsim.simulator.renderers.protocol import rig_cameras
from hybridworldsim.simulator.renderers.registry import RendererFactory
from hybridworldsim.simulator.rollout.run import RolloutRequest
from tests.simulator.streets import scenario, straight_street

STREET = straight_street()


BRAKE = scenario(
    {"id": "lead", "behaviour": {"kind": "hard-brake", "ahead_m": 25.0, "trigger": {"ttc_s": 2.0, "latest_s": 1.0}}},
    duration_s=3.0,
)


def request(policy, **more) -> RolloutRequest:
    chosen = RolloutRequest(
        STREET, BRAKE, policy, "test", rig_cameras(STREET, tuple(STREET.rig), 48), RendererFactory("boxes")
    )
    return replace(chosen, **more)
