"""The static world of a scene: its plan with houses, furniture, plants, parked cars and the skyline."""

from __future__ import annotations

from mirror.synth.street.world.world import World, build_world

__all__ = ["World", "build_world"]
