"""The protocol of message logs: topics, messages in storage order, and single messages by their place."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from mirror.errors import RecordingError


@dataclass(frozen=True)
class Topic:
    """One topic of a log.

    Attributes:
        name: e.g. ``/camera/front/image/compressed``.
        type: name of the message type, e.g. ``sensor_msgs/msg/CompressedImage``.
        encoding: ``cdr``, ``protobuf`` or ``json``.
        definition: the message definition that the log holds, or empty.
        definition_encoding: ``ros2msg``, ``protobuf``, ``jsonschema``, or empty.
    """

    name: str
    type: str
    encoding: str
    definition: bytes = field(default=b"", repr=False)
    definition_encoding: str = ""


@dataclass(frozen=True)
class MessagePlace:
    """The place of a message: its block (a chunk or the file itself), and its byte range in the block."""

    block: int
    offset: int
    length: int


@dataclass(frozen=True)
class Message:
    """One message in its stored form.

    Attributes:
        topic: its topic.
        log_time_ns: when it was logged, on the log's clock.
        data: the encoded message.
        place: where it is stored.
    """

    topic: Topic
    log_time_ns: int
    data: bytes = field(repr=False)
    place: MessagePlace


class MessageLog(Protocol):
    """A file of messages, opened for each call and closed after it."""

    @property
    def path(self) -> Path:
        """The file."""
        ...

    def topics(self) -> dict[str, Topic]:
        """Return all topics by name."""
        ...

    def messages(self, names: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some topics in storage order; blocks without these topics are skipped if possible."""
        ...

    def read(self, places: Sequence[MessagePlace]) -> Iterator[bytes]:
        """Yield the bytes of single messages, for places in storage order; each block is read once."""
        ...

    def damage(self) -> Sequence[RecordingError]:
        """Return the damaged blocks that the last complete pass over `messages` left out."""
        ...
