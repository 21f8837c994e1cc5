"""Reads rosbag2 databases (``.db3``, SQLite): the messages of ROS 2 recordings from before MCAP."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Final

from mirror.errors import RecordingError
from mirror.recordings.opening import read_file_start
from mirror.recordings.readers.message_logs.container import Message, MessagePlace, Topic
from mirror.recordings.readers.message_logs.ros_definitions import definition_of
from mirror.recordings.readers.message_logs.zstd import stored_file

_MAGIC: Final = b"SQLite format 3\0"


class Rosbag2File:
    """One rosbag2 database.

    Args:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    @property
    def path(self) -> Path:
        """The file."""
        return self._path

    def damage(self) -> Sequence[RecordingError]:
        """Return 0: a damaged database is refused as a whole."""
        return ()

    def topics(self) -> dict[str, Topic]:
        """Return all topics by name. Databases of older versions hold no message definitions: MIRROR's own are used.

        Raises:
            RecordingError: the file is not a rosbag2 database.
        """
        return {topic.name: topic for topic in self._topics().values()}

    def messages(self, names: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some topics in storage order.

        Raises:
            RecordingError: the database is damaged.
        """
        topics = {number: topic for number, topic in self._topics().items() if topic.name in names}
        chosen = ",".join(str(number) for number in topics)
        query = f"SELECT id, topic_id, timestamp, data FROM messages WHERE topic_id IN ({chosen}) ORDER BY id"
        with self._database() as database:
            for row, topic, log_time, data in database.execute(query):
                yield Message(topics[topic], log_time, bytes(data), MessagePlace(0, row, len(data)))

    def read(self, places: Sequence[MessagePlace]) -> Iterator[bytes]:
        """Yield the bytes of messages by their place.

        Raises:
            RecordingError: the database is damaged, or has changed.
        """
        with self._database() as database:
            for place in places:
                found = database.execute("SELECT data FROM messages WHERE id = ?", (place.offset,)).fetchone()
                if found is None:
                    raise RecordingError("lacks a message that it had before", file=self._path, remedy="read it again")
                yield bytes(found[0])

    def _topics(self) -> dict[int, Topic]:
        with self._database() as database:
            rows = database.execute("SELECT id, name, type, serialization_format FROM topics ORDER BY id").fetchall()
            tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            stored: dict[str, str] = {}
            if "message_definitions" in tables:
                query = (
                    "SELECT topic_type, encoded_message_definition FROM message_definitions WHERE encoding = 'ros2msg'"
                )
                stored = dict(database.execute(query).fetchall())
        topics = {}
        for number, name, kind, encoding in rows:
            definition = stored.get(kind) or definition_of(kind) or ""
            topics[number] = Topic(name, kind, encoding, definition.encode(), "ros2msg" if definition else "")
        return topics

    @contextmanager
    def _database(self) -> Iterator[sqlite3.Connection]:
        file = stored_file(self._path)
        if read_file_start(file, len(_MAGIC))[0] != _MAGIC:
            raise RecordingError(
                "is not an SQLite database", file=self._path, expected="a rosbag2 file", remedy="copy it again"
            )
        # Immutable: nothing is locked, and no journal file is made beside the recording.
        location = f"{file.resolve().as_uri()}?mode=ro&immutable=1"
        try:
            with closing(sqlite3.connect(location, uri=True)) as database:
                yield database
        except sqlite3.Error as error:
            raise RecordingError(
                f"cannot be read ({error})",
                file=self._path,
                expected="a complete rosbag2 database with the tables topics and messages",
                remedy="copy it again; if the recorder crashed: sqlite3 FILE .recover",
            ) from error
