"""Writes drives as recordings in the `folder` layout, with the chosen errors and ground truth.

docs/recordings/folder.md specifies the layout.
"""

from __future__ import annotations

from mirror.synth.writing.recordings import SynthReport, write_recordings

__all__ = ["SynthReport", "write_recordings"]
