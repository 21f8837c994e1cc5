"""Copies a stretch of a compressed video into an mp4 file without decoding it.

A copy begins at the key frame from which the first requested frame decodes, and ends with the last packet that a
requested frame needs. The packets keep their bytes: a frame of the copy has the pixels of the frame of the source.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from mirror.arrays import Bool, Int64
from mirror.errors import RecordingError
from mirror.recordings.video_file import av_error_type, from_key_frame, has_time_stamps, open_video, read_video_stamps

if TYPE_CHECKING:
    import av
    from av.container import InputContainer
    from av.video.stream import VideoStream as Stream

# Raw streams have no time stamps. In a copy, their frames follow each other at a fixed distance.
_RAW_UNIT: Final = Fraction(1, 90_000)
_RAW_STEP: Final = 3_000
_DECODE_INSTEAD: Final = "ingest the frames as images instead: --images jpeg"


def copy_frames(file: Path, pts: Int64, target: Path) -> Int64:
    """Copy the compressed frames with some time stamps, and the frames that they need, into a new mp4 file.

    Args:
        file: a video; of a raw stream (``.hevc``, ``.h264``), the number of a frame takes the place of its time stamp.
        pts: (N,) ascending time stamps of the requested frames, in the video's time base.
        target: the file to write, which ends with ``.mp4``; it must not exist.

    Returns:
        (N,) ascending time stamps of the requested frames in the copy, in the copy's time base.

    Raises:
        RecordingError: the video is broken, lacks a frame, has no key frame before the first requested frame, or has a
            codec that mp4 files do not hold; file and time stamp are named.
    """
    if target.exists():
        raise RecordingError("the copy of a video exists already", file=target, expected="a new file")
    try:
        with _packets(file, pts) as (stream, packets):
            read = [(_identity(packet), packet.is_keyframe) for packet in packets]
            raw = not has_time_stamps(stream)
        shown = np.array([identity for identity, _ in read], np.int64)
        needed = _needed(shown, np.array([is_key for _, is_key in read], np.bool_), pts, file)
        with _packets(file, pts) as (stream, packets):
            copied = (packet for packet, wanted in zip(packets, needed.tolist()) if wanted)
            _mux(copied, stream, target, shown[needed] * (_RAW_STEP if raw else 1))
    except av_error_type() as error:
        raise RecordingError(
            f"the frames cannot be copied ({error})",
            file=file,
            expected="a complete video with a codec that mp4 files hold, such as H.264 or HEVC",
            remedy=_DECODE_INSTEAD,
        ) from error
    written, _ = read_video_stamps(target)
    order = np.sort(shown[needed])
    if len(written) != len(order) or (np.diff(written) <= 0).any():
        raise RecordingError(
            f"the copy has {len(np.unique(written))} distinct time stamps for {len(order)} frames",
            file=file,
            expected="one time stamp for each frame",
            remedy=_DECODE_INSTEAD,
        )
    # The writer may shift and scale the time stamps; it keeps their order.
    return written[np.searchsorted(order, pts)]


def _needed(shown: Int64, is_key: Bool, pts: Int64, file: Path) -> Bool:
    """(P,) which of P packets, in decoding order, the frames with the time stamps ``pts`` (N,) need.

    Raises:
        RecordingError: a frame has no packet, or no key frame stands before it.
    """
    absent = pts[~np.isin(pts, shown)]
    if len(absent):
        raise RecordingError(
            "the video has no such frame, or ends before it",
            file=file,
            place=f"pts {absent[0]}",
            expected="a complete video with the time stamps of its table",
            remedy="copy the video again; if it is complete, remove the missing frames from its table",
        )
    first = int(np.argmax(np.isin(shown, pts)))
    keys = np.flatnonzero(is_key[: first + 1] & (shown[: first + 1] <= pts[0]))
    if not len(keys):
        raise RecordingError(
            "the video has no key frame at or before this frame",
            file=file,
            place=f"pts {pts[0]}",
            expected="a video that begins with a key frame",
            remedy="record with regular key frames, or leave the frames before the first key frame out",
        )
    needed = np.zeros(len(shown), np.bool_)
    needed[keys[-1] :] = True
    # Frames that are shown before their key frame need the group of frames before it, which is not copied.
    return needed & (shown >= shown[keys[-1]])


def _mux(packets: Iterator[av.Packet[Stream]], stream: Stream, target: Path, shown: Int64) -> None:
    """Write P packets, whose frames are shown at the time stamps ``shown`` (P,), in decoding order."""
    import av

    # Not every container states decoding times. These ascend, and none is later than the time of display.
    decoded = np.sort(shown)
    decoded -= max(0, int((decoded - shown).max()))
    start = int(shown.min())
    head = next(packets)
    # `bitexact` leaves the version of the writer out, so that equal input gives equal bytes.
    options = {"movflags": "+faststart", "fflags": "+bitexact"}
    if head.time_base:
        options["video_track_timescale"] = str(max(1, round(1 / head.time_base)))
    with av.open(str(target), "w", format="mp4", options=options) as container:
        written = container.add_stream_from_template(stream)
        packet = head
        for shown_at, decoded_at in zip((shown - start).tolist(), (decoded - start).tolist()):
            packet.pts, packet.dts, packet.stream = shown_at, decoded_at, written
            container.mux_one(packet)
            packet = next(packets, packet)


@contextmanager
def _packets(file: Path, pts: Int64) -> Iterator[tuple[Stream, Iterator[av.Packet[Stream]]]]:
    """Open a video, and demux packets that hold the frames ``pts`` (N,) and the key frame before them."""
    with open_video(file) as (container, stream):
        if has_time_stamps(stream):
            yield stream, _timed_packets(container, stream, pts)
        else:
            yield stream, _raw_packets(container, stream, pts, file)


def _identity(packet: av.Packet[Stream]) -> int:
    """Return the name of a packet's frame in the source: its time stamp, or its number in a raw stream."""
    number = packet.pts if packet.opaque is None else packet.opaque
    if not isinstance(number, int):
        raise TypeError(f"a packet is named by {number!r}, which is no number")
    return number


def _timed_packets(container: InputContainer, stream: Stream, pts: Int64) -> Iterator[av.Packet[Stream]]:
    first, pending = int(pts[0]), set(pts.tolist())

    def demux() -> Iterator[tuple[int, av.Packet[Stream]]]:
        return ((packet.pts, packet) for packet in container.demux(stream) if packet.size and packet.pts is not None)

    for shown, packet in from_key_frame(container, stream, first, demux):
        pending.discard(shown)
        yield packet
        if not pending:
            return


def _raw_packets(container: InputContainer, stream: Stream, pts: Int64, file: Path) -> Iterator[av.Packet[Stream]]:
    """Number the packets of a raw stream, and yield them up to the last requested frame."""
    if stream.codec_context.has_b_frames:
        raise RecordingError(
            "a raw video whose frames are not stored in the order of display cannot be copied",
            file=file,
            expected="a container with time stamps (mp4, mkv), or a raw stream without B-frames",
            remedy=_DECODE_INSTEAD,
        )
    packets = (packet for packet in container.demux(stream) if packet.size)
    for number, packet in enumerate(packets):
        packet.opaque, packet.time_base = number, _RAW_UNIT
        yield packet
        if number == pts[-1]:
            return
