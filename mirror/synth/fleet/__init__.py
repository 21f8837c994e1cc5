"""The recordings to be made: presets of scenes, and the true drives through them."""

from __future__ import annotations

from mirror.synth.fleet.presets import PRESETS, Preset

__all__ = ["PRESETS", "Preset"]
