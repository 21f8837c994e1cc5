"""The recordings in a folder of recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mirror.errors import RecordingError
from mirror.recordings.boundary import reader_errors
from mirror.recordings.registry import load_readers


@dataclass(frozen=True)
class FoundRecordings:
    """What was found at some paths.

    Attributes:
        recordings: one path a drive, in order.
        passed_over: what lies beside recordings in a folder of them, and is none.
    """

    recordings: tuple[Path, ...]
    passed_over: tuple[Path, ...]


def find_recordings(paths: Sequence[Path], reader: str | None = None) -> FoundRecordings:
    """Replace every folder of recordings by the recordings that lie directly in it.

    A path that a reader recognises is a recording, whatever lies in it; so is one in which there is no recording, for
    opening it says what is wrong with it. Names that begin with a dot are not considered.

    Args:
        paths: recordings, and folders of recordings.
        reader: name of the only reader that is asked; None: all are.
    """
    recordings: dict[Path, None] = {}
    passed_over: dict[Path, None] = {}
    for path in paths:
        inside: list[Path] = []
        if path.is_dir() and not _is_recording(path, reader):
            inside = sorted(one for one in path.iterdir() if not one.name.startswith("."))
        own = {one: _is_recording(one, reader) for one in inside}
        if not any(own.values()):
            recordings[path] = None
            continue
        recordings.update(dict.fromkeys(one for one, yes in own.items() if yes))
        passed_over.update(dict.fromkeys(one for one, yes in own.items() if not yes))
    return FoundRecordings(tuple(recordings), tuple(passed_over))


def _is_recording(path: Path, reader: str | None) -> bool:
    if not (path.is_file() or path.is_dir()):
        return False
    try:
        with reader_errors(path):
            return any(candidate.recognises(path) for candidate in load_readers(reader).values())
    except RecordingError:
        # Opening it names the fault.
        return True
