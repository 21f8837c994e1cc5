"""Finds the recordings in a folder of recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mirror.errors import RecordingError
from mirror.recordings.boundary import reader_errors
from mirror.recordings.registry import list_drives, load_readers

_SYNTH: Final = "synth.json"
_BESIDE_SYNTHETIC: Final = (_SYNTH, "maps", "rois.geojson", "secret.json")


@dataclass(frozen=True)
class FoundRecordings:
    """The recordings at some paths.

    Attributes:
        recordings: one path per drive, in order.
        passed_over: paths beside recordings that no reader recognises.
    """

    recordings: tuple[Path, ...]
    passed_over: tuple[Path, ...]


def find_recordings(paths: Sequence[Path], reader: str | None = None) -> FoundRecordings:
    """Replace each folder by the recordings directly in it, or by the ones that its format keeps in it.

    A path that a reader recognises is a recording, whatever it contains. A path without a recording in it also counts
    as one: opening it then reports what is wrong with it. Names that begin with a dot are ignored, and in a folder of
    `mirror synth` what it writes beside the recordings.

    Args:
        paths: recordings, and folders of recordings.
        reader: name of the reader to use; None: all readers.
    """
    recordings: dict[Path, None] = {}
    passed_over: dict[Path, None] = {}
    for path in paths:
        children: list[Path] = []
        if path.is_dir() and not _is_recording(path, reader):
            children = sorted(child for child in path.iterdir() if not child.name.startswith("."))
        is_recording = {child: _is_recording(child, reader) for child in children}
        if not any(is_recording.values()):
            recordings.update(dict.fromkeys(_drives(path, reader)))
            continue
        for child, yes in is_recording.items():
            if yes:
                recordings.update(dict.fromkeys(_drives(child, reader)))
        names = {child.name for child in children}
        # A topics file describes the log beside it that has its name.
        described = {child.stem for child, yes in is_recording.items() if yes}
        for child, yes in is_recording.items():
            is_description = child.suffix == ".toml" and child.name.partition(".")[0] in described
            is_synthetic = child.name in _BESIDE_SYNTHETIC and _SYNTH in names
            if not (yes or is_description or is_synthetic):
                passed_over[child] = None
    return FoundRecordings(tuple(recordings), tuple(passed_over))


def _drives(path: Path, reader: str | None) -> list[Path]:
    """The drives of a folder that holds several; else the path itself."""
    try:
        with reader_errors(path):
            return list_drives(path, reader) or [path]
    except RecordingError:
        # Opening the folder reports the fault.
        return [path]


def _is_recording(path: Path, reader: str | None) -> bool:
    if not (path.is_file() or path.is_dir()):
        return False
    try:
        with reader_errors(path):
            return any(candidate.recognises(path) for candidate in load_readers(reader).values())
    except RecordingError:
        # Opening the recording reports the fault.
        return True
