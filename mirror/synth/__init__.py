"""A procedural street with exact ground truth: the data of the demo, of the tests and of accuracy benchmarks."""

from __future__ import annotations

from mirror.synth.errors import Errors
from mirror.synth.fleet import PRESETS
from mirror.synth.light.condition import Condition, Effects
from mirror.synth.maps import street_map
from mirror.synth.writing import SynthReport, write_recordings

__all__ = ["PRESETS", "Condition", "Effects", "Errors", "SynthReport", "street_map", "write_recordings"]
