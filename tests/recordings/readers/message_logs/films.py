"""Packets of compressed videos in messages of a log."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import av

from tests.recordings.readers.message_logs.drives import ONE
from tests.recordings.readers.message_logs.writer import Out
from tests.recordings.videos import write_video

VIDEO = """
[cameras.rear]
images = "/rear/video"
"""


def packets(folder: Path, codec: str) -> list[bytes]:
    """The packets of a raw video, one per frame."""
    name, encoder = ("v.h264", "libx264") if codec == "h264" else ("v.hevc", "libx265")
    file = write_video(folder / name, codec=encoder, b_frames=0)
    with av.open(str(file)) as container:
        return [bytes(packet) for packet in container.demux(video=0) if packet.size]


def video_messages(data: list[bytes], codec: str) -> list[Out]:
    """A packet at every pose."""
    out = []
    for stamp, packet in zip(ONE.stamps.tolist(), data):
        header = SimpleNamespace(stamp=SimpleNamespace(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="rear")
        value = SimpleNamespace(timestamp=header.stamp, header=header, frame_id="rear", data=packet, format=codec)
        out.append(Out("/rear/video", "foxglove_msgs/msg/CompressedVideo", stamp, value))
    return out
