"""Closed-loop simulation: a street that a policy drives in, with agents that react and cameras that are rendered."""

from __future__ import annotations

from mirror.command import Command

COMMAND = Command("reconstruction", "drive a scenario in closed loop with a policy", "hybridworldsim.simulator.command")
