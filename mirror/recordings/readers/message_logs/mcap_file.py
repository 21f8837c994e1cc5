"""Reads MCAP files: chunked or not, with or without an index, in any order, truncated or damaged.

The framing of records (opcode, length, content) is read here, so that a single message can be read again by its place,
memory is bounded by one chunk, and a damaged chunk costs only its own messages. The `mcap` package parses the contents.
The format: https://mcap.dev/spec.
"""

from __future__ import annotations

import os
import stat
import struct
import zlib
from collections.abc import Callable, Collection, Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import IO, Any, Final, TypeVar

from mirror.errors import RecordingError
from mirror.installation import install_command
from mirror.recordings.opening import unreadable_error
from mirror.recordings.paths import not_a_file_error
from mirror.recordings.readers.message_logs.container import Message, MessagePlace, Topic
from mirror.recordings.readers.message_logs.zstd import stored_file

_MAGIC: Final = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _CHUNK_INDEX, _DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x08, 0x0F
_FRAME: Final = struct.Struct("<BQ")
_HEAD: Final = struct.Struct("<HIQQ")
_FOOTER_BYTES: Final = 8 + 8 + 4
# A chunk is held in memory as a whole. Writers use 1 to 16 MiB.
_LARGEST_CHUNK: Final = 2**30
_FILE_BLOCK: Final = -1

Record = TypeVar("Record")


class McapFile:
    """One MCAP file.

    Args:
        path: the file.

    Attributes:
        chunks_read: number of chunks that were read and decompressed so far.

    Raises:
        RecordingError: the `mcap` package is not installed.
    """

    def __init__(self, path: Path) -> None:
        try:
            import mcap.records
        except ImportError as error:
            raise RecordingError(
                "MCAP files need the mcap package, which is not installed", file=path, remedy=install_command("mcap")
            ) from error
        self._records = mcap.records
        self._path = path
        self._damage: list[RecordingError] = []
        self._topics: dict[int, Topic] | None = None
        self.chunks_read = 0

    @property
    def path(self) -> Path:
        """The file."""
        return self._path

    def damage(self) -> Sequence[RecordingError]:
        """Return the damaged records that the last pass over `messages` left out."""
        return tuple(self._damage)

    def topics(self) -> dict[str, Topic]:
        """Return all topics by name, from the file's summary or, without one, from a pass over the file.

        Raises:
            RecordingError: the file is not MCAP, or one topic has channels of several types.
        """
        if self._topics is None:
            with self._open() as file:
                summary = self._summary(file)
            if summary is not None and summary.topics:
                self._topics = summary.topics
            else:
                found: dict[int, Topic] = {}
                for _ in self._pass(frozenset(), found):
                    pass
                if not found and self._damage:
                    raise self._damage[0]
                self._topics = found
        named: dict[str, Topic] = {}
        for topic in self._topics.values():
            other = named.setdefault(topic.name, topic)
            if (other.type, other.encoding) != (topic.type, topic.encoding):
                raise RecordingError(
                    f"topic {topic.name} has the types {other.type} ({other.encoding}) and"
                    f" {topic.type} ({topic.encoding})",
                    file=self._path,
                    expected="one message type for each topic",
                    remedy="split the log by topic",
                )
        return named

    def messages(self, names: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some topics in storage order.

        Chunks that by the file's index hold no such message are not read. A damaged chunk, and what a truncated file
        lacks, is left out and listed by `damage`.

        Raises:
            RecordingError: the file is missing or not MCAP.
        """
        yield from self._pass(frozenset(names), {})

    def read(self, places: Sequence[MessagePlace]) -> Iterator[bytes]:
        """Yield the bytes of messages by place; a chunk is read once for consecutive places in it.

        Raises:
            RecordingError: the file has changed since the places were found.
        """
        block, data = _FILE_BLOCK, b""
        with self._open() as file:
            for place in places:
                if place.block == _FILE_BLOCK:
                    file.seek(place.offset)
                    message = file.read(place.length)
                else:
                    if place.block != block:
                        file.seek(place.block)
                        frame = file.read(_FRAME.size)
                        length = _FRAME.unpack(frame)[1] if len(frame) == _FRAME.size else 0
                        data, block = self._decompress(self._chunk(file.read(length))), place.block
                    message = data[place.offset : place.offset + place.length]
                if len(message) != place.length:
                    raise RecordingError(
                        "ends before a message that it had before", file=self._path, remedy="read it again"
                    )
                yield bytes(message)

    def _open(self) -> IO[bytes]:
        try:
            descriptor = os.open(stored_file(self._path), os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise unreadable_error(self._path, error) from error
        file = os.fdopen(descriptor, "rb")
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            file.close()
            raise not_a_file_error(self._path)
        begin = file.read(len(_MAGIC))
        if begin != _MAGIC:
            file.close()
            is_cut = len(begin) < len(_MAGIC) and _MAGIC.startswith(begin)
            raise RecordingError(
                f"truncated at byte {len(begin)}" if is_cut else "is not an MCAP file",
                file=self._path,
                place="byte 0",
                expected="the MCAP magic bytes",
                remedy="copy it again",
            )
        return file

    def _pass(self, names: frozenset[str], channels: dict[int, Topic]) -> Iterator[Message]:
        """Read all records; yield the messages of the named topics, and collect the channels."""
        self._damage = []
        schemas: dict[int, Any] = {}
        with self._open() as file:
            summary = self._summary(file)
            # Without names, the pass looks for channels: no chunk may be skipped.
            wanted = summary.chunks_with(names) if summary is not None and names else None
            if summary is not None:
                channels.update(summary.topics)
            size = os.fstat(file.fileno()).st_size
            offset = len(_MAGIC)
            while True:
                file.seek(offset)
                frame = file.read(_FRAME.size)
                if len(frame) < _FRAME.size:
                    self._note(f"truncated at byte {size}: it ends without a footer", f"byte {size}")
                    return
                opcode, length = _FRAME.unpack(frame)
                start, offset = offset, offset + _FRAME.size + length
                if offset > size:
                    self._note(f"truncated at byte {size}: it ends within a record of {length} bytes", f"byte {start}")
                    return
                if opcode in (_FOOTER, _DATA_END):
                    return
                if opcode == _CHUNK:
                    if wanted is None or start in wanted:
                        yield from self._chunk_messages(file.read(length), start, names, channels, schemas)
                elif opcode == _MESSAGE:
                    head = file.read(_HEAD.size)
                    if length < _HEAD.size:
                        self._note("has a message without a header", f"byte {start}")
                        continue
                    channel, _, log_time, _ = _HEAD.unpack(head)
                    topic = channels.get(channel)
                    if topic is not None and topic.name in names:
                        place = MessagePlace(_FILE_BLOCK, start + _FRAME.size + _HEAD.size, length - _HEAD.size)
                        yield Message(topic, log_time, file.read(place.length), place)
                elif opcode in (_SCHEMA, _CHANNEL):
                    self._declare(opcode, file.read(length), channels, schemas, f"byte {start}")

    def _chunk_messages(
        self, content: bytes, start: int, names: frozenset[str], channels: dict[int, Topic], schemas: dict[int, Any]
    ) -> Iterator[Message]:
        try:
            data = memoryview(self._decompress(self._chunk(content)))
        except RecordingError as error:
            self._damage.append(
                RecordingError(error.problem, file=self._path, place=f"chunk at byte {start}", remedy=error.remedy)
            )
            return
        offset = 0
        while offset + _FRAME.size <= len(data):
            opcode, length = _FRAME.unpack_from(data, offset)
            offset += _FRAME.size
            if offset + length > len(data):
                self._note("has a record that ends behind its chunk", f"chunk at byte {start}")
                return
            if opcode == _MESSAGE and length >= _HEAD.size:
                channel, _, log_time, _ = _HEAD.unpack_from(data, offset)
                topic = channels.get(channel)
                if topic is not None and topic.name in names:
                    place = MessagePlace(start, offset + _HEAD.size, length - _HEAD.size)
                    yield Message(topic, log_time, bytes(data[place.offset : offset + length]), place)
            elif opcode in (_SCHEMA, _CHANNEL):
                self._declare(
                    opcode, bytes(data[offset : offset + length]), channels, schemas, f"chunk at byte {start}"
                )
            offset += length

    def _declare(
        self, opcode: int, content: bytes, channels: dict[int, Topic], schemas: dict[int, Any], place: str
    ) -> None:
        """Take over a schema or a channel."""
        try:
            if opcode == _SCHEMA:
                schema = self._parse(self._records.Schema.read, content)
                schemas[schema.id] = schema
            else:
                channel = self._parse(self._records.Channel.read, content)
                channels.setdefault(channel.id, _to_topic(channel, schemas))
        except RecordingError as error:
            self._note(error.problem, place)

    def _parse(self, read: Callable[[Any], Record], content: bytes) -> Record:
        from mcap.data_stream import ReadDataStream
        from mcap.exceptions import McapError

        try:
            return read(ReadDataStream(BytesIO(content)))
        except (McapError, struct.error, UnicodeDecodeError, ValueError) as error:
            raise RecordingError(f"has a broken record ({error})", file=self._path, remedy="copy it again") from error

    def _chunk(self, content: bytes) -> Any:
        return self._parse(self._records.Chunk.read, content)

    def _decompress(self, chunk: Any) -> bytes:
        """The records of a chunk; its stated size bounds the memory that decompression may take."""
        self.chunks_read += 1
        size = int(chunk.uncompressed_size)
        if size > _LARGEST_CHUNK:
            raise RecordingError(
                f"has a chunk of {size} bytes",
                file=self._path,
                expected=f"chunks of at most {_LARGEST_CHUNK} bytes",
                remedy="write the log with smaller chunks (1 to 16 MiB)",
            )
        try:
            data = _DECOMPRESS[chunk.compression](chunk.data, size)
        except KeyError as error:
            raise RecordingError(
                f"has a chunk with the compression {chunk.compression!r}",
                file=self._path,
                expected=f"one of {', '.join(repr(name) for name in _DECOMPRESS)}",
                remedy="write the log with another compression",
            ) from error
        except Exception as error:
            # Each decompressor has error types of its own.
            raise RecordingError(
                f"has a chunk that cannot be decompressed ({error})", file=self._path, remedy="copy it again"
            ) from error
        if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
            raise RecordingError("has a chunk with a wrong size or checksum", file=self._path, remedy="copy it again")
        return data

    def _note(self, problem: str, place: str) -> None:
        self._damage.append(
            RecordingError(
                problem, file=self._path, place=place, remedy="copy it again, or repair it: mcap recover FILE"
            )
        )

    def _summary(self, file: IO[bytes]) -> _Summary | None:
        """The index at the end of the file; None: there is none, or it is damaged. The file is left at its start."""
        size = os.fstat(file.fileno()).st_size
        end = size - len(_MAGIC) - _FOOTER_BYTES
        found: _Summary | None = None
        file.seek(max(0, end - _FRAME.size))
        tail = file.read()
        if end > _FRAME.size and tail.endswith(_MAGIC) and _FRAME.unpack_from(tail) == (_FOOTER, _FOOTER_BYTES):
            start = struct.unpack_from("<Q", tail, _FRAME.size)[0]
            if 0 < start < end - _FRAME.size:
                file.seek(start)
                found = self._parse_summary(file.read(end - _FRAME.size - start))
        file.seek(len(_MAGIC))
        return found

    def _parse_summary(self, data: bytes) -> _Summary | None:
        schemas: dict[int, Any] = {}
        topics: dict[int, Topic] = {}
        chunks: dict[int, frozenset[int]] | None = {}
        offset = 0
        try:
            while offset + _FRAME.size <= len(data):
                opcode, length = _FRAME.unpack_from(data, offset)
                content = data[offset + _FRAME.size : offset + _FRAME.size + length]
                offset += _FRAME.size + length
                if opcode == _SCHEMA:
                    schema = self._parse(self._records.Schema.read, content)
                    schemas[schema.id] = schema
                elif opcode == _CHANNEL:
                    channel = self._parse(self._records.Channel.read, content)
                    topics[channel.id] = _to_topic(channel, schemas)
                elif opcode == _CHUNK_INDEX and chunks is not None:
                    index = self._parse(self._records.ChunkIndex.read, content)
                    chunks[index.chunk_start_offset] = frozenset(index.message_index_offsets)
                    # A writer may leave the index of messages out.
                    chunks = chunks if index.message_index_offsets else None
        except RecordingError:
            return None
        return _Summary(topics, chunks)


class _Summary:
    """The channels of a file, and which of them each chunk holds (None: not stated)."""

    def __init__(self, topics: dict[int, Topic], chunks: dict[int, frozenset[int]] | None) -> None:
        self.topics = topics
        self._chunks = chunks

    def chunks_with(self, names: frozenset[str]) -> frozenset[int] | None:
        """Offsets of the chunks that hold messages of some topics; None: every chunk may."""
        if not self._chunks:
            return None
        wanted = {number for number, topic in self.topics.items() if topic.name in names}
        return frozenset(start for start, channels in self._chunks.items() if channels & wanted)


def _to_topic(channel: Any, schemas: dict[int, Any]) -> Topic:
    schema = schemas.get(channel.schema_id)
    if schema is None:
        return Topic(channel.topic, "", channel.message_encoding)
    return Topic(channel.topic, schema.name, channel.message_encoding, schema.data, schema.encoding)


def _decompress_zstd(data: bytes, size: int) -> bytes:
    import zstandard

    return zstandard.ZstdDecompressor().decompress(data, max_output_size=max(size, 1))


def _decompress_lz4(data: bytes, size: int) -> bytes:
    import lz4.frame

    decompressor = lz4.frame.LZ4FrameDecompressor()
    return bytes(decompressor.decompress(data, max_length=size + 1)) if data else b""


_DECOMPRESS: Final[dict[str, Callable[[bytes, int], bytes]]] = {
    "": lambda data, size: data,
    "zstd": _decompress_zstd,
    "lz4": _decompress_lz4,
}
