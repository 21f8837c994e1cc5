"""Policies and renderers behind gRPC: wire-compatible with AlpaSim's driver and sensor simulation services."""

from __future__ import annotations

from mirror.command import Command

COMMAND = Command(
    "reconstruction", "serve images of a street to another simulator", "hybridworldsim.simulator.remote.command"
)
