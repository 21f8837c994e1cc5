"""Images of a camera that recorded a video; only the GOPs (key frame to key frame) of requested frames are decoded.

A frame is identified by its presentation time stamp (pts), never by ``round(t * fps)``. Decoding starts at the key
frame before each run of requested frames. OpenCV is not used for seeking: on H.264 and HEVC it returns a neighbour of
the frame.
"""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.recordings.remux import copy_frames
from mirror.recordings.video_file import av_error_type, from_key_frame, has_time_stamps, open_video
from mirror.recordings.video_frames import FrameConverter

if TYPE_CHECKING:
    import av
    from av.container import InputContainer
    from av.video.stream import VideoStream as Stream


@runtime_checkable
class CompressedStream(Protocol):
    """An image stream that can hand over its compressed video, so that no frame is decoded."""

    def copy_video(self, indices: Int64, folder: Path, name: str) -> list[CopiedVideo]:
        """Write the compressed frames into mp4 files.

        Args:
            indices: (N,) ascending indices into the stream.
            folder: where the files are written; it exists.
            name: stem of the first file's name; further files get a number.

        Returns:
            The files. Together they hold the N frames in their order.

        Raises:
            RecordingError: the video is broken, or cannot be copied.
        """
        ...


@dataclass(frozen=True)
class CopiedVideo:
    """A file with compressed frames: ``pts`` (N,) are the time stamps of the requested frames, in their order."""

    file: Path
    pts: Int64


@dataclass
class VideoStream:
    """The frames of one video, which are encoded as JPEG (quality 95, 4:2:0).

    Attributes:
        camera: the camera's name.
        codec: always ``video``.
        exposure_start_ns: (N,) Unix time.
        exposure_end_ns: (N,) Unix time.
        file: the video.
        pts: (N,) ascending, in the video's time base. A raw stream (``.hevc``, ``.h264``) has no time stamps: there it
            is the number of the frame.
        decoded: number of frames decoded so far, including those before a requested frame.
    """

    camera: str
    exposure_start_ns: Int64
    exposure_end_ns: Int64
    file: Path = field(repr=False)
    pts: Int64 = field(repr=False)
    codec: str = "video"
    decoded: int = 0

    def __post_init__(self) -> None:
        if not len(self.pts) == len(self.exposure_start_ns) == len(self.exposure_end_ns):
            raise RecordingError(
                f"{len(self.pts)} frames but {len(self.exposure_start_ns)} exposure stamps",
                file=self.file,
                place=f"camera {self.camera}",
            )
        if (np.diff(self.pts) <= 0).any():
            row = int(np.argmax(np.diff(self.pts) <= 0)) + 1
            raise RecordingError(
                f"pts {self.pts[row]} follows {self.pts[row - 1]}",
                file=self.file,
                place=f"camera {self.camera}, frame {row}",
                expected="ascending presentation time stamps",
                remedy="sort the table of the video's frames by pts",
            )

    def path(self, index: int) -> None:
        """Return None: no file holds a single frame."""
        return

    def copy_video(self, indices: Int64, folder: Path, name: str) -> list[CopiedVideo]:
        """Write the compressed frames into one mp4 file; see `CompressedStream`."""
        target = folder / f"{name}.mp4"
        return [CopiedVideo(target, copy_frames(self.file, self.pts[indices], target))]

    def read(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes]]:
        """Yield ``(index, JPEG bytes)`` for ascending indices.

        Raises:
            RecordingError: the video is broken or ends too early, or has no frame with a pts; file and pts are named.
        """
        requested = {int(self.pts[index]): index for index in indices}
        if not requested:
            return
        with open_video(self.file) as (container, stream):
            converter = FrameConverter()
            frames = (
                _decode_by_time(container, stream, requested)
                if has_time_stamps(stream)
                else _decode_by_number(container, stream, requested)
            )
            try:
                for pts, frame in frames:
                    self.decoded += 1
                    if pts not in requested:
                        continue
                    data = converter.to_jpeg(frame)
                    if data is None:
                        raise RecordingError(
                            "the frame cannot be encoded",
                            file=self.file,
                            place=f"pts {pts}",
                            remedy="convert the video again, such as to H.264 of 8 bits",
                        )
                    yield requested.pop(pts), data
                    if not requested:
                        return
            except av_error_type() as error:
                raise self._missing_error(min(requested), str(error)) from error
        if requested:
            raise self._missing_error(min(requested), "the video has no such frame, or ends before it")

    def _missing_error(self, pts: int, reason: str) -> RecordingError:
        return RecordingError(
            f"frame cannot be decoded ({reason})",
            file=self.file,
            place=f"pts {pts}",
            expected="a complete video with the time stamps of its table",
            remedy="copy the video again; if it is complete, remove the missing frames from its table",
        )


def _decode_by_time(
    container: InputContainer, stream: Stream, requested: Collection[int]
) -> Iterator[tuple[int, av.VideoFrame]]:
    """Decode from the key frame before each run of requested frames, and yield every decoded frame.

    In real files the time stamps of frames do not always ascend in the order of display, so a frame counts as missing
    only at the end of the video.
    """

    def decode() -> Iterator[tuple[int, av.VideoFrame]]:
        return ((int(frame.pts), frame) for frame in container.decode(stream) if frame.pts is not None)

    pending = dict.fromkeys(sorted(requested))
    while pending:
        target, reached = next(iter(pending)), -sys.maxsize
        for pts, frame in from_key_frame(container, stream, target, decode):
            yield pts, frame
            pending.pop(pts, None)
            reached = max(reached, pts)
            # A container may start earlier than its index states: decode until the target is reached.
            if not pending or (target not in pending and _has_key_frame_between(stream, reached, next(iter(pending)))):
                break
        else:
            return


def _has_key_frame_between(stream: Stream, reached: int, requested: int) -> bool:
    index = stream.index_entries.search_timestamp(requested, backward=True, any_frame=False)
    return bool(index >= 0 and stream.index_entries[index].timestamp > reached)


def _decode_by_number(
    container: InputContainer, stream: Stream, requested: Collection[int]
) -> Iterator[tuple[int, av.VideoFrame]]:
    """Decode the GOPs of a raw stream that hold requested frames; the number of a frame takes the place of its pts."""
    last = max(requested)
    group: list[av.Packet[Stream]] = []
    start = 0
    for packet in container.demux(stream):
        if packet.size and not (packet.is_keyframe and group):
            group.append(packet)
            continue
        yield from _decode_group(stream, group, start, requested)
        start += len(group)
        group = [packet]
        if start > last or not packet.size:
            return


def _decode_group(
    stream: Stream, group: list[av.Packet[Stream]], start: int, requested: Collection[int]
) -> Iterator[tuple[int, av.VideoFrame]]:
    if not any(start <= number < start + len(group) for number in requested):
        return
    number = start
    for packet in [*group, None]:
        for frame in stream.codec_context.decode(packet):
            yield number, frame
            number += 1
    stream.codec_context.flush_buffers()
