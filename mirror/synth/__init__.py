"""A procedural street, driven many times, with exact truth: the demo, the fixture of tests, the measure of errors."""

from __future__ import annotations

from mirror.synth.presets import PRESETS
from mirror.synth.recordings import write_recordings

__all__ = ["PRESETS", "write_recordings"]
