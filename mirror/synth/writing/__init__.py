"""Writes drives as recordings in the `folder` layout (docs/recordings.md), with the chosen errors and ground truth."""

from __future__ import annotations

from mirror.synth.writing.recordings import SynthReport, write_recordings

__all__ = ["SynthReport", "write_recordings"]
