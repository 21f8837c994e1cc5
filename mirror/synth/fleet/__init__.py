"""What is recorded: presets of scenes and of drives through them, and the drives as they truly were."""

from __future__ import annotations

from mirror.synth.fleet.presets import PRESETS, Preset

__all__ = ["PRESETS", "Preset"]
