"""Images in videos: they are decoded by presentation time stamp, and decoders are kept open.

A video is decoded from the key frame before the requested frame. A request for a frame shortly after the last one goes
on from there.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mirror.arrays import UInt8
from mirror.dataset.store import Store
from mirror.errors import DatasetError
from mirror.installation import install_command

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
        """Decode the frame with a time stamp to pixels (H, W, 3), RGB; None: the video has no such frame, or is broken.

        Raises:
            DatasetError: PyAV is not installed, or the uri leads out of the dataset.
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
    def __init__(self, store: Store, uri: str) -> None:
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
        self._stream.thread_type = "AUTO"
        self._frames: Iterator[av.VideoFrame] = iter(())
        self._last: int | None = None
        self._target = 0
        self._lock = threading.Lock()

    def close(self) -> None:
        with self._lock:
            self._container.close()

    def decode(self, pts: int) -> UInt8 | None:
        import av

        with self._lock:
            try:
                frame = self._read_up_to(pts) if self._is_shortly_after_last(pts) else None
                if frame is None:
                    self._container.seek(pts, stream=self._stream, backward=True)
                    self._frames = self._decode()
                    frame = self._read_up_to(pts)
            except av.FFmpegError:
                frame = None
            self._last = None if frame is None else pts
            return None if frame is None else np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)

    def _is_shortly_after_last(self, pts: int) -> bool:
        """Whether decoding on from the last frame costs no more than a seek to a key frame."""
        rate, unit = self._stream.average_rate, self._stream.time_base
        if self._last is None or not rate or not unit:
            return False
        return 0 < (pts - self._last) * unit * rate <= _NEAR_FRAMES

    def _decode(self) -> Iterator[av.VideoFrame]:
        """Decode from the container's position on, without frames before the target that no other frame refers to."""
        context = self._stream.codec_context
        # HEVC has frames that count as such and that frames of a higher temporal layer refer to.
        skips = context.name == "h264"
        for packet in self._container.demux(self._stream):
            early = skips and packet.pts is not None and packet.pts < self._target
            context.skip_frame = "NONREF" if early else "DEFAULT"
            yield from context.decode(packet)

    def _read_up_to(self, pts: int) -> av.VideoFrame | None:
        """Decode frames until the one with a time stamp; None: it does not come."""
        self._target = pts
        key_frames_beyond = 0
        for frame in self._frames:
            if frame.pts == pts:
                return frame
            # Broken muxers may not write frames in display order: search up to the second key frame.
            key_frames_beyond += bool(frame.key_frame and frame.pts is not None and frame.pts > pts)
            if key_frames_beyond == 2:
                return None
        return None
