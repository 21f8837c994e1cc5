"""A procedural street, driven many times, with exact truth: the demo, the fixture of tests, the measure of errors."""

from __future__ import annotations

from mirror.synth.errors import Errors
from mirror.synth.fleet import PRESETS
from mirror.synth.light.condition import Condition, Effects
from mirror.synth.writing import SynthReport, write_recordings

__all__ = ["PRESETS", "Condition", "Effects", "Errors", "SynthReport", "write_recordings"]
