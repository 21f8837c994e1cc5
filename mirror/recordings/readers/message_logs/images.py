"""Image streams of message logs: encoded images, and packets of a compressed video without B-frames."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from mirror.arrays import Bool, Int64
from mirror.errors import RecordingError
from mirror.installation import install_command
from mirror.recordings.readers.message_logs.container import Message, MessageLog, MessagePlace, Topic
from mirror.recordings.readers.message_logs.decoding import ImageMessage, MessageDecoder
from mirror.recordings.video import CopiedVideo
from mirror.recordings.video_file import av_error_type
from mirror.recordings.video_frames import FrameConverter

_MAGIC: Final = {b"\xff\xd8\xff": "jpeg", b"\x89PNG\r\n\x1a\n": "png"}
VIDEO_SUFFIXES: Final = {"h264": "h264", "h265": "hevc", "hevc": "hevc"}
"""File suffixes of raw videos by the format that the messages state."""


def image_codec(data: bytes) -> str | None:
    """Return ``jpeg`` or ``png`` by the first bytes of an encoded image; None for another format."""
    return next((codec for magic, codec in _MAGIC.items() if data.startswith(magic)), None)


def is_key_packet(data: bytes, suffix: str) -> bool:
    """Return whether a packet in Annex B format begins a group of frames that decode without earlier ones."""
    start = data.find(b"\0\0\1")
    while 0 <= start < len(data) - 3:
        kind = data[start + 3]
        # H.264: a slice of an IDR frame. HEVC: a slice of an intra random access point.
        if (kind & 31 == 5) if suffix == "h264" else (16 <= (kind >> 1) & 63 <= 21):
            return True
        start = data.find(b"\0\0\1", start + 3)
    return False


@dataclass(frozen=True)
class StoredMessages:
    """The places where the N messages of a camera are stored.

    Attributes:
        logs: the files of the drive.
        topic: the camera's topic of images.
        log: (N,) index of each message's file.
        places: N places.
    """

    logs: tuple[MessageLog, ...]
    topic: Topic
    log: Int64
    places: tuple[MessagePlace, ...] = field(repr=False)

    def read(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes]]:
        """Yield ``(index, image or packet)`` in storage order, so that each block is read once."""
        for number, log in enumerate(self.logs):
            here = [index for index in indices if self.log[index] == number]
            here.sort(key=lambda index: (self.places[index].block, self.places[index].offset))
            decoder = MessageDecoder(log.path)
            for index, data in zip(here, log.read([self.places[index] for index in here])):
                decoded = decoder.decode(Message(self.topic, 0, data, self.places[index]))
                if not isinstance(decoded, ImageMessage):
                    raise RecordingError(
                        f"topic {self.topic.name} holds no images",
                        file=log.path,
                        remedy="name another topic for this camera in the topics file",
                    )
                yield index, decoded.data


@dataclass(frozen=True)
class MessageImages:
    """Encoded images in messages; the stamp of a message is taken as the middle of the exposure.

    Attributes:
        camera: the camera's name.
        codec: ``jpeg`` or ``png``.
        exposure_start_ns: (N,) the messages' stamps.
        stored: where the images are.
        repeated_ns: (R,) ascending stamps of the images that were left out: another one has the same stamp.
    """

    camera: str
    codec: str
    exposure_start_ns: Int64
    stored: StoredMessages = field(repr=False)
    repeated_ns: Int64 = field(default_factory=lambda: np.empty(0, np.int64), repr=False)

    @property
    def exposure_end_ns(self) -> Int64:
        """(N,) equal to the start, as the messages state only one stamp."""
        return self.exposure_start_ns

    def path(self, index: int) -> None:
        """Return None: no file holds a single image."""

    def read(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes]]:
        """Yield ``(index, encoded bytes)`` in storage order."""
        yield from self.stored.read(indices)


@dataclass(frozen=True)
class MessageVideo:
    """Packets of a compressed video, one per frame; `read` decodes them and encodes JPEG.

    Attributes:
        camera: the camera's name.
        exposure_start_ns: (N,) the messages' stamps.
        stored: where the packets are.
        is_key: (N,) True where a packet begins a group; the first does.
        suffix: ``h264`` or ``hevc``.
        codec: always ``video``.
    """

    camera: str
    exposure_start_ns: Int64
    stored: StoredMessages = field(repr=False)
    is_key: Bool = field(repr=False)
    suffix: str
    codec: str = "video"

    @property
    def exposure_end_ns(self) -> Int64:
        """(N,) equal to the start, as the messages state only one stamp."""
        return self.exposure_start_ns

    def path(self, index: int) -> None:
        """Return None: no file holds a single frame."""

    def read(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes]]:
        """Yield ``(index, JPEG bytes)``; only groups with requested frames are decoded, up to the last such frame.

        Raises:
            RecordingError: PyAV is not installed, or a frame cannot be decoded; its stamp is named.
        """
        converter: FrameConverter | None = None
        for group in self._groups(indices):
            requested = {index for index in indices if group.start <= index < group.stop}
            for index, frame in self._decode(group):
                if index not in requested:
                    continue
                converter = converter or FrameConverter()
                data = converter.to_jpeg(frame)
                if data is None:
                    raise self._error(index, "it cannot be encoded")
                requested.discard(index)
                yield index, data
            if requested:
                raise self._error(min(requested), "the decoder gives no frame for its packet")

    def copy_video(self, indices: Int64, folder: Path, name: str) -> list[CopiedVideo]:
        """Write the compressed frames into one mp4 file; see `mirror.recordings.video.CompressedStream`."""
        from mirror.recordings.remux import copy_frames

        first = int(np.flatnonzero(self.is_key[: int(indices[0]) + 1])[-1])
        target = folder / f"{name}.mp4"
        with tempfile.TemporaryDirectory() as scratch:
            raw = Path(scratch) / f"{self.camera}.{self.suffix}"
            with raw.open("wb") as file:
                for data in self._packets(range(first, int(indices[-1]) + 1)):
                    file.write(data)
            return [CopiedVideo(target, copy_frames(raw, indices - first, target))]

    def _groups(self, indices: Sequence[int]) -> Iterator[range]:
        """The groups with requested frames, each from its key frame to its last requested frame."""
        starts = np.flatnonzero(self.is_key)
        groups = np.searchsorted(starts, np.asarray(indices), side="right") - 1
        for group in np.unique(groups):
            last = max(index for index, own in zip(indices, groups) if own == group)
            yield range(int(starts[group]), last + 1)

    def _packets(self, group: range) -> Iterator[bytes]:
        """The packets of consecutive frames in their order, whatever the order of storage."""
        waiting: dict[int, bytes] = {}
        following = group.start
        for index, data in self.stored.read(group):
            waiting[index] = data
            while following in waiting:
                yield waiting.pop(following)
                following += 1

    def _decode(self, group: range) -> Iterator[tuple[int, Any]]:
        try:
            import av
        except ImportError as error:
            raise RecordingError(
                "videos need PyAV, which is not installed",
                file=self.stored.logs[0].path,
                remedy=install_command("video"),
            ) from error
        context: Any = av.CodecContext.create(self.suffix, "r")
        index = group.start
        try:
            for index, data in zip(group, self._packets(group)):
                packet = av.Packet(data)
                packet.pts = index
                for frame in context.decode(packet):
                    yield int(frame.pts), frame
            for frame in context.decode(None):
                yield int(frame.pts), frame
        except av_error_type() as error:
            raise self._error(index, str(error)) from error

    def _error(self, index: int, reason: str) -> RecordingError:
        return RecordingError(
            f"a frame cannot be decoded ({reason})",
            file=self.stored.logs[int(self.stored.log[index])].path,
            place=f"topic {self.stored.topic.name}, stamp {self.exposure_start_ns[index]}",
            expected="one frame per packet, in the order of display",
            remedy="copy the log again; if it is complete, leave the camera out of the topics file",
        )


def stored_messages(
    logs: tuple[MessageLog, ...], topic: Topic, log: Int64, places: Sequence[MessagePlace], order: Int64
) -> StoredMessages:
    """Return the places of a camera's messages, in the order of their stamps.

    Args:
        logs: the files of the drive.
        topic: the camera's topic.
        log: (N,) index of each message's file.
        places: N places.
        order: (M,) the messages to keep, in order.
    """
    return StoredMessages(logs, topic, log[order], tuple(places[index] for index in order.tolist()))
