"""A reader that ruins drives, and ends or holds up its process before a put, as files beside a recording say.

``--reader tests/ingest/hooks.py:HookedReader`` imports it in the processes that do the work. `RUIN` in a recording says
how its track ends: an error, a crash or never. Each line of `KILL` names a file that the drive gets: once, the process
is killed before it; of a bucket, each line of `KILL_AT_READING` names one, which is read for its put. `HOLD` names a
file before which one process waits until `GO` is there.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import Any

from mirror.recordings.protocol import Recording
from mirror.recordings.readers.folder import FolderReader

RUIN, KILL, HOLD, GO, ATTEMPTS = "hooks.ruin", "hooks.kill", "hooks.hold", "hooks.go", "hooks.attempts"
KILL_AT_READING = "hooks.kill_at_reading"

_opened: dict[str, Path] = {}
"""Folders of the recordings that this process opened, by drive id."""


def _before_put(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and arguments[1] == "r" and ".staging" in str(arguments[0]):
        _end_at_reading(PurePath(str(arguments[0])))
        return
    if event != "os.link":
        return
    path = PurePath(str(arguments[1]))
    if ".staging" in path.parts:
        return
    for drive_id, folder in _opened.items():
        if drive_id in path.parts or any(f".{drive_id}." in part for part in path.parts):
            _end_before(folder, path, KILL)
            _wait_before(folder, path)


def _end_at_reading(path: PurePath) -> None:
    for drive_id, folder in _opened.items():
        if drive_id in path.parts or any(f".{drive_id}." in part for part in path.parts):
            _end_before(folder, path, KILL_AT_READING)


def _end_before(folder: Path, path: PurePath, name: str) -> None:
    file = folder.with_name(f"{folder.name}.{name}")
    for number, pattern in enumerate(file.read_text().split() if file.exists() else []):
        if path.match(pattern):
            try:
                folder.with_name(f"{folder.name}.{number}.killed").touch(exist_ok=False)
            except FileExistsError:
                continue
            os.kill(os.getpid(), signal.SIGKILL)


def _wait_before(folder: Path, path: PurePath) -> None:
    file = folder.with_name(f"{folder.name}.{HOLD}")
    if file.exists() and path.match(file.read_text()):
        file.rename(folder.with_name(f"{folder.name}.held"))
        while not folder.with_name(f"{folder.name}.{GO}").exists():
            time.sleep(0.01)


sys.addaudithook(_before_put)


class HookedRecording:
    """A recording whose track may be ruined."""

    def __init__(self, recording: Recording, folder: Path) -> None:
        self._recording, self._folder = recording, folder

    def __getattr__(self, name: str) -> Any:
        return getattr(self._recording, name)

    def track(self) -> Any:
        file = self._folder.with_name(f"{self._folder.name}.{RUIN}")
        if file.exists():
            with self._folder.with_name(f"{self._folder.name}.{ATTEMPTS}").open("ab") as attempts:
                attempts.write(b"x")
            match file.read_text():
                case "ValueError":
                    raise ValueError("a track of nonsense")
                case "SIGSEGV":
                    os.kill(os.getpid(), signal.SIGSEGV)
                case "endless":
                    while True:
                        time.sleep(0.01)
        return self._recording.track()


class HookedReader:
    """The `folder` format with hooks."""

    name = "hooked"
    expects = FolderReader.expects

    def recognises(self, path: Path) -> bool:
        return FolderReader().recognises(path)

    def open(self, path: Path, options: Mapping[str, str]) -> HookedRecording:
        recording = FolderReader().open(path, options)
        _opened[recording.info.drive_id] = path
        return HookedRecording(recording, path)
