"""Files of videos: opening them, the time stamps of their frames, and reading from a key frame on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.installation import install_command
from mirror.recordings.time import SECOND_NS

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.stream import VideoStream as Stream

Item = TypeVar("Item")


def read_video_stamps(file: Path) -> tuple[Int64, Fraction]:
    """Read the presentation time stamps of all frames from the packets, without decoding.

    Args:
        file: a video in a container with time stamps.

    Returns:
        (N,) pts, ascending, and the length of their unit in seconds.

    Raises:
        RecordingError: the file is broken, or is a raw stream, which has no time stamps.
    """
    with open_video(file) as (container, stream):
        try:
            stamps = [packet.pts for packet in container.demux(stream) if packet.size]
        except av_error_type() as error:
            raise _broken_error(file, error) from error
        time_base = stream.time_base
    if not stamps or None in stamps or time_base is None:
        raise RecordingError(
            "the video has no time stamps",
            file=file,
            expected="a container with time stamps (mp4, mkv)",
            remedy=f"give the exposures: {file.stem}.csv beside the video, with pts,exposure_start_ns,exposure_end_ns",
        )
    return np.sort(np.array(stamps, np.int64)), Fraction(time_base)


def to_unix_stamps(pts: Int64, time_base: Fraction, start_ns: int) -> Int64:
    """Convert presentation time stamps to Unix nanoseconds, exact to the nanosecond.

    Args:
        pts: (N,) in units of ``time_base``.
        time_base: length of the unit in seconds.
        start_ns: Unix time of the first frame.
    """
    units = (pts - pts[0]) * time_base.numerator
    seconds, rest = np.divmod(units, time_base.denominator)
    # rest < denominator, which is at most 1e9 in existing formats: the product fits into int64.
    nanoseconds = (rest * SECOND_NS + time_base.denominator // 2) // time_base.denominator
    return start_ns + seconds * SECOND_NS + nanoseconds


@contextmanager
def open_video(file: Path) -> Iterator[tuple[InputContainer, Stream]]:
    """Open a video for demuxing and decoding.

    Raises:
        RecordingError: PyAV is not installed, or has no decoder for the video's codec, or the file is no video.
    """
    try:
        import av
    except ImportError as error:
        raise RecordingError(
            "videos need PyAV, which is not installed",
            file=file,
            remedy=install_command("video"),
        ) from error
    try:
        container = av.open(str(file))
    except (av.FFmpegError, OSError) as error:
        raise _broken_error(file, error) from error
    with container:
        if not container.streams.video:
            raise _broken_error(file, "it has no video stream")
        stream = container.streams.video[0]
        if stream.codec_context is None:
            raise RecordingError(
                "the installed PyAV has no decoder for its codec",
                file=file,
                expected="H.264, HEVC, AV1, VP9, MPEG-4 or another codec of PyAV",
                remedy="convert it where there is one: ffmpeg -i VIDEO -c:v libx264 -fps_mode passthrough OUT.mp4",
            )
        stream.thread_type = "AUTO"
        yield container, stream


def _broken_error(file: Path, reason: object) -> RecordingError:
    return RecordingError(
        f"cannot be read ({reason})",
        file=file,
        expected="a complete video",
        remedy="copy it again from the vehicle or archive: a truncated video has lost its index",
    )


def av_error_type() -> type[Exception]:
    """Return the type of PyAV's errors; PyAV is imported only when it is needed."""
    import av

    return av.FFmpegError


def has_time_stamps(stream: Stream) -> bool:
    """Return whether the packets of a video have time stamps; packets of a raw stream have none."""
    return len(stream.index_entries) > 0 or stream.start_time is not None


def from_key_frame(
    container: InputContainer, stream: Stream, pts: int, read: Callable[[], Iterator[tuple[int, Item]]]
) -> Iterator[tuple[int, Item]]:
    """Read packets or frames from a key frame that is displayed at or before a pts, to the end of the video.

    Containers are indexed in decoding order: the key frame found may be displayed after the requested frame, which then
    belongs to the previous GOP. A container without an index (MPEG-TS) is read from its current position.

    Args:
        container: the video.
        stream: its stream.
        pts: time stamp of the requested frame.
        read: begins to read at the container's position, and gives packets or frames with their time stamps.
    """
    target = pts
    first = stream.start_time or 0
    indexed = len(stream.index_entries) > 0
    while True:
        if indexed:
            container.seek(target, stream=stream, backward=True)
        items = read()
        head = next(items, None)
        if head is None:
            return
        if head[0] <= pts or target < first or not indexed:
            break
        target = min(target, head[0]) - max(1, head[0] - pts)
    yield head
    yield from items
