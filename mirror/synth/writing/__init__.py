"""Drives as recordings in the `folder` layout (docs/recordings.md), with chosen errors, and the truth beside them."""

from __future__ import annotations

from mirror.synth.writing.recordings import SynthReport, write_recordings

__all__ = ["SynthReport", "write_recordings"]
