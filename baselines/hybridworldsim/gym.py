"""Registers the environments of Gymnasium: `gymnasium.make("hybridworldsim.gym:mirror/Street-v0")` imports this module.

Gymnasium has read no entry points since 1.0, so that a name has to tell which module registers it.
"""

from __future__ import annotations

from gymnasium.envs.registration import register

register("mirror/Street-v0", entry_point="hybridworldsim.simulator.environment.street_env:StreetEnv")
