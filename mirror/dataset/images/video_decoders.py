"""Images in videos: they are decoded by presentation time stamp, and decoders are kept open.

A video is decoded from the key frame before the requested frame. A request for a frame shortly after the last one goes
on from there. A decoder gives a frame only when it has the packets of some later frames, one of which may be the next
key frame. Where no request for the next frame is expected, the decoder therefore gets the end of the video instead.
"""

from __future__ import annotations

import sys
import threading
from collections import OrderedDict
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Literal

from mirror.arrays import UInt8
from mirror.dataset.store import Store
from mirror.errors import DatasetError
from mirror.installation import install_command
from mirror.recordings.video_file import from_key_frame
from mirror.recordings.video_frames import FrameConverter

if TYPE_CHECKING:
    import av

_OPEN_VIDEOS: Final = 16
_NEAR_FRAMES: Final = 8


class VideoDecoders:
    """Open video decoders of a dataset. Beyond a limit, the least recently used one is closed.

    Args:
        store: the dataset's files.
        limit: largest number of open videos.
    """

    def __init__(self, store: Store, limit: int = _OPEN_VIDEOS) -> None:
        self._store = store
        self._limit = limit
        self._open: OrderedDict[str, _Decoder] = OrderedDict()
        self._lock = threading.Lock()

    def decode(self, uri: str, pts: int) -> UInt8 | None:
        """Decode the frame with a time stamp to pixels (H, W, 3), RGB; None if it is missing or the video is broken.

        Raises:
            DatasetError: PyAV is not installed or has no decoder for the video, or the uri leads out of the dataset.
            OSError: the video cannot be opened.
        """
        with self._lock:
            if uri not in self._open:
                self._open[uri] = _Decoder(self._store, uri)
                if len(self._open) > self._limit:
                    _, oldest = self._open.popitem(last=False)
                    oldest.close()
            self._open.move_to_end(uri)
            decoder = self._open[uri]
        return decoder.decode(pts)


class _Decoder:
    """The frames of one video.

    A frame alone comes from a decoder that divides each frame among threads, as far as the frame has slices. Frames
    one after the other come from a second decoder that has several frames in work at once.
    """

    def __init__(self, store: Store, uri: str) -> None:
        self._alone = _Reader(store, uri, "SLICE")
        self._onward: _Reader | None = None
        self._open_onward = partial(_Reader, store, uri, "AUTO")
        self._converter = FrameConverter()
        self._last: int | None = None
        self._has_jumped = self._expects_next = False
        self._lock = threading.Lock()

    def close(self) -> None:
        with self._lock:
            for reader in (self._alone, self._onward):
                if reader is not None:
                    reader.close()

    def decode(self, pts: int) -> UInt8 | None:
        import av

        with self._lock:
            try:
                frame = self._find(pts)
            except av.FFmpegError:
                frame = None
            self._last = None if frame is None else pts
            return None if frame is None else self._converter.to_rgb(frame)

    def _find(self, pts: int) -> av.VideoFrame | None:
        is_near = self._alone.is_near(self._last, pts)
        if self._has_jumped:
            # What followed the last jump is expected after the next one.
            self._expects_next = is_near
        self._has_jumped = not is_near
        frame = None if is_near or self._expects_next else self._alone.read_alone(pts)
        if frame is None:
            self._onward = self._onward or self._open_onward()
            frame = self._onward.read_onward(pts)
        return frame


class _Reader:
    """A video, and a decoder that has its own kind of threads."""

    def __init__(self, store: Store, uri: str, thread_type: Literal["SLICE", "AUTO"]) -> None:
        try:
            import av
        except ImportError as error:
            raise DatasetError(
                "images in videos are read with PyAV, which is not installed",
                file=uri,
                remedy=install_command("video"),
            ) from error
        self._container: Any = store.open_uri(
            uri,
            lambda place: av.open(str(place)),
            lambda filesystem, path: av.open(filesystem.open(path, "rb")),
        )
        self._stream = self._container.streams.video[0]
        if self._stream.codec_context is None:
            self._container.close()
            raise DatasetError(
                "the installed PyAV has no decoder for the video's codec",
                file=uri,
                expected="a codec of PyAV",
                remedy="install a PyAV with this codec, or ingest the recording with --images jpeg where it is",
            )
        self._stream.thread_type = thread_type
        self._frames: Iterator[av.VideoFrame] = iter(())
        self._last: int | None = None
        self._target = 0

    def close(self) -> None:
        self._container.close()

    def read_alone(self, pts: int) -> av.VideoFrame | None:
        """Decode a frame and what it needs; None: the video has no such frame."""
        return self._read_up_to(pts, self._seek(pts, ends_at_target=True))

    def read_onward(self, pts: int) -> av.VideoFrame | None:
        """Decode on from the last frame, or from a key frame; None: the video has no such frame."""
        last, self._last = self._last, None
        frame = self._read_up_to(pts, self._frames) if self.is_near(last, pts) else None
        if frame is None:
            self._frames = self._seek(pts)
            frame = self._read_up_to(pts, self._frames)
        self._last = None if frame is None else pts
        return frame

    def is_near(self, last: int | None, pts: int) -> bool:
        """Return whether decoding on from the last frame costs no more than a seek to a key frame."""
        rate, unit = self._stream.average_rate, self._stream.time_base
        if last is None or not rate or not unit:
            return False
        return 0 < (pts - last) * unit * rate <= _NEAR_FRAMES

    def _seek(self, pts: int, *, ends_at_target: bool = False) -> Iterator[av.VideoFrame]:
        """Decode from a key frame on, without frames before the target that no other frame refers to."""
        context = self._stream.codec_context
        # HEVC has frames that count as such and that frames of a higher temporal layer refer to.
        skips = context.name == "h264"
        for _, packet in from_key_frame(self._container, self._stream, pts, self._packets):
            early = skips and packet.pts is not None and packet.pts < self._target
            context.skip_frame = "NONREF" if early else "DEFAULT"
            yield from context.decode(packet)
            if ends_at_target and packet.pts == self._target:
                yield from context.decode(None)
                return

    def _packets(self) -> Iterator[tuple[int, Any]]:
        for packet in self._container.demux(self._stream):
            yield -sys.maxsize if packet.pts is None else int(packet.pts), packet

    def _read_up_to(self, pts: int, frames: Iterator[av.VideoFrame]) -> av.VideoFrame | None:
        """Decode frames until the one with a time stamp; None: it does not come."""
        self._target = pts
        key_frames_beyond = 0
        for frame in frames:
            if frame.pts == pts:
                return frame
            # Broken muxers may not write frames in display order: search up to the second key frame.
            key_frames_beyond += bool(frame.key_frame and frame.pts is not None and frame.pts > pts)
            if key_frames_beyond == 2:
                return None
        return None
