"""Videos in which every frame says which it is."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

from mirror.recordings.video_frames import JPEG_QUALITY

GROUP, FRAMES = 10, 60


def write_video(file: Path, *, codec: str = "libx264", gop: int = GROUP, b_frames: int = 2, rate: int = 30) -> Path:
    """A moving gradient; presentation times jitter, as hardware stamps do."""
    with av.open(str(file), "w") as container:
        stream = container.add_stream(codec, rate=rate)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.gop_size, stream.max_b_frames = gop, b_frames
        stream.options = {"x265-params": "log-level=none"} if codec == "libx265" else {"sc_threshold": "0"}
        stream.codec_context.time_base = Fraction(1, 1000)
        columns, rows = np.meshgrid(np.arange(64), np.arange(48))
        for index in range(FRAMES):
            image = np.stack([columns * 4, rows * 5, (columns + index * 4) % 256], axis=-1).astype(np.uint8)
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = index * 33 + index % 3, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return file


def decode_all(file: Path) -> list[tuple[int | None, bytes]]:
    """The reference: decode every frame from the first, and encode it in the same way."""
    found = []
    with av.open(str(file)) as container:
        for frame in container.decode(video=0):
            image = frame.to_ndarray(format="bgr24")
            _, data = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))
            found.append((frame.pts, data.tobytes()))
    return found
