"""Readers of message logs: ``mcap`` for MCAP files, ``rosbag2`` for SQLite databases of ROS 2."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, Final

from mirror.errors import RecordingError
from mirror.recordings.opening import find_file
from mirror.recordings.paths import list_folder, natural_key
from mirror.recordings.readers.message_logs.container import MessageLog, Topic
from mirror.recordings.readers.message_logs.mcap_file import McapFile
from mirror.recordings.readers.message_logs.recording import LogRecording
from mirror.recordings.readers.message_logs.rosbag2_file import Rosbag2File
from mirror.recordings.readers.message_logs.topics_file import propose_topics, read_topics_file, require_topics
from mirror.recordings.readers.message_logs.zstd import without_suffix
from mirror.recordings.registry import refuse_options

_OPTIONS: Final = ("topics",)
_FOLDER_TOPICS: Final = "topics.toml"
# A folder with one of these is one drive in several files, not a folder of drives.
_FOLDER_MARKS: Final = ("metadata.yaml", _FOLDER_TOPICS)


class _LogReader(ABC):
    """Reads logs with one file suffix, also as a recorder compressed them: ``.db3.zstd``."""

    name: ClassVar[str]
    expects: ClassVar[str]
    suffix: ClassVar[str]

    @abstractmethod
    def open_log(self, file: Path) -> MessageLog:
        """Open one file."""

    def recognises(self, path: Path) -> bool:
        """Return whether the path is a log, or a folder of logs with ``metadata.yaml`` or ``topics.toml``."""
        if path.is_file():
            return self._is_log(path)
        if not path.is_dir() or not any((path / mark).is_file() for mark in _FOLDER_MARKS):
            return False
        return any(self._is_log(child) for child in path.iterdir())

    def _is_log(self, path: Path) -> bool:
        return without_suffix(path).suffix.lower() == self.suffix

    def open(self, path: Path, options: Mapping[str, str]) -> LogRecording:
        """Open a drive; the option ``topics`` names its topics file.

        Raises:
            RecordingError: there is no topics file, or it does not fit the log.
        """
        refuse_options(options, _OPTIONS, path, self.name)
        logs = self._logs(path)
        file = self._topics_file(path, options)
        if file is None:
            raise RecordingError(
                "no topics file says which topics are the drive",
                file=path,
                expected=str(_beside(path)),
                remedy=f"save the proposal of `mirror info {path}` there and complete it; or give --option topics=FILE",
            )
        document = read_topics_file(file)
        require_topics(document, _all_topics(logs), file)
        return LogRecording(path, logs, document, file)

    def propose_configuration(self, path: Path, options: Mapping[str, str]) -> str | None:
        """The proposal of a topics file, as text; None: there is one."""
        if self._topics_file(path, options) is not None:
            return None
        return f"# Save as {_beside(path)}\n" + propose_topics(_all_topics(self._logs(path)), without_suffix(path).stem)

    def _logs(self, path: Path) -> tuple[MessageLog, ...]:
        if path.is_dir():
            listed = list_folder(path, path)
            names = sorted((name for name in listed if self._is_log(Path(name))), key=natural_key)
            files = [listed[name] for name in names]
        else:
            files = [path]
        if not files:
            raise RecordingError("no log", file=path, expected=self.expects)
        return tuple(self.open_log(file) for file in files)

    def _topics_file(self, path: Path, options: Mapping[str, str]) -> Path | None:
        if "topics" in options:
            return Path(options["topics"])
        beside = _beside(path)
        file = find_file(beside.parent, beside.name)
        # `mirror info LOG > LOG.toml`: the shell makes the file before the proposal is written.
        return None if file is None or not file.stat().st_size else file


def _beside(path: Path) -> Path:
    return path / _FOLDER_TOPICS if path.is_dir() else without_suffix(path).with_suffix(".toml")


def _all_topics(logs: tuple[MessageLog, ...]) -> dict[str, Topic]:
    topics: dict[str, Topic] = {}
    for log in logs:
        topics.update(log.topics())
    return topics


class McapReader(_LogReader):
    """A reader of MCAP files with ROS 2 (CDR), Protobuf or JSON messages."""

    name = "mcap"
    expects = "a file *.mcap with a topics file *.toml beside it, or a folder of them with topics.toml"
    suffix = ".mcap"

    def open_log(self, file: Path) -> MessageLog:
        """Open one file."""
        return McapFile(file)


class Rosbag2Reader(_LogReader):
    """A reader of rosbag2 databases."""

    name = "rosbag2"
    expects = "a file *.db3 with a topics file *.toml beside it, or a rosbag2 folder with topics.toml"
    suffix = ".db3"

    def open_log(self, file: Path) -> MessageLog:
        """Open one file."""
        return Rosbag2File(file)
