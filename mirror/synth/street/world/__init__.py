"""A scene's static world: its plan with houses, furniture, plants, parked cars and what stands far off."""

from __future__ import annotations

from mirror.synth.street.world.world import World, build_world

__all__ = ["World", "build_world"]
