"""Closed-loop simulation: a street that a policy drives in, with agents that react and cameras that are rendered."""

from __future__ import annotations

from mirror.command import Command
from mirror.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from hybridworldsim.simulator.ego.vehicle import Controls as Controls
    from hybridworldsim.simulator.policies.protocol import Observation as Observation
    from hybridworldsim.simulator.policies.protocol import ObservationSpec as ObservationSpec
    from hybridworldsim.simulator.policies.protocol import PlannedTrajectory as PlannedTrajectory
    from hybridworldsim.simulator.policies.protocol import Policy as Policy
    from hybridworldsim.simulator.policies.protocol import TensorPolicy as TensorPolicy

COMMAND = Command("reconstruction", "drive a scenario in closed loop with a policy", "hybridworldsim.simulator.command")

__all__ = [
    "Controls",
    "Observation",
    "ObservationSpec",
    "PlannedTrajectory",
    "Policy",
    "TensorPolicy",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Controls": "hybridworldsim.simulator.ego.vehicle",
        "Observation": "hybridworldsim.simulator.policies.protocol",
        "ObservationSpec": "hybridworldsim.simulator.policies.protocol",
        "PlannedTrajectory": "hybridworldsim.simulator.policies.protocol",
        "Policy": "hybridworldsim.simulator.policies.protocol",
        "TensorPolicy": "hybridworldsim.simulator.policies.protocol",
    },
)
