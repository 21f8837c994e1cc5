"""Pixels of decoded video frames.

The tables of a colour conversion take longer to build (4 ms at 1080p) than one frame to convert (0.7 ms): a converter
keeps them from frame to frame, which ``VideoFrame.to_ndarray`` does not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from mirror.arrays import UInt8

if TYPE_CHECKING:
    import av

JPEG_QUALITY: Final = 95


class FrameConverter:
    """A converter of the frames of one video, one after the other; PyAV must be installed."""

    def __init__(self) -> None:
        from av.video.reformatter import VideoReformatter

        self._reformatter: Any = VideoReformatter()

    def to_rgb(self, frame: av.VideoFrame) -> UInt8:
        """Return the pixels (H, W, 3), RGB, of a frame."""
        return self._convert(frame, "rgb24")

    def to_jpeg(self, frame: av.VideoFrame) -> bytes | None:
        """Encode a frame as JPEG (quality 95, 4:2:0); None if it cannot be encoded."""
        import cv2

        done, data = cv2.imencode(".jpg", self._convert(frame, "bgr24"), (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))
        return data.tobytes() if done else None

    def _convert(self, frame: av.VideoFrame, layout: Literal["rgb24", "bgr24"]) -> UInt8:
        return np.asarray(self._reformatter.reformat(frame, format=layout).to_ndarray(), np.uint8)
