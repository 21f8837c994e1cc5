"""Compressed video in messages: frames equal those of decoding from the start; copies of stretches."""

from __future__ import annotations

from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from mirror.errors import RecordingError
from mirror.recordings.readers.message_logs.images import MessageVideo
from mirror.recordings.video_frames import JPEG_QUALITY
from tests.recordings.readers.message_logs.drives import ONE, opened
from tests.recordings.readers.message_logs.films import VIDEO, packets, video_messages
from tests.recordings.readers.message_logs.writer import TOPICS, messages, write_mcap
from tests.recordings.videos import GROUP


def frames_of(data: list[bytes], codec: str, folder: Path) -> list[bytes]:
    """The reference: decode all packets as one file, and encode each frame."""
    file = folder / f"all.{'h264' if codec == 'h264' else 'hevc'}"
    file.write_bytes(b"".join(data))
    out = []
    with av.open(str(file)) as container:
        for frame in container.decode(video=0):
            image = frame.to_ndarray(format="bgr24")
            out.append(cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))[1].tobytes())
    return out


@pytest.mark.parametrize("codec", ["h264", "h265"])
@pytest.mark.parametrize("encoding", ["ros2", "protobuf"])
def test_frames_equal_those_of_decoding_from_the_start(tmp_path: Path, codec: str, encoding: str) -> None:
    data = packets(tmp_path, codec)
    reference = frames_of(data, codec, tmp_path)
    every = messages(ONE) + video_messages(data, codec)
    write_mcap(tmp_path / "log.mcap", every, encoding=encoding)  # type: ignore[arg-type]
    stream = opened(tmp_path, TOPICS + VIDEO).images()["rear"]
    assert isinstance(stream, MessageVideo) and len(stream.exposure_start_ns) == len(data)
    for wanted in ([0], [GROUP + 3, GROUP + 5], [1, 29, 30, 55]):
        assert dict(stream.read(wanted)) == {index: reference[index] for index in wanted}
    (copied,) = stream.copy_video(np.array([13, 14, 41]), tmp_path, "copy")
    with av.open(str(copied.file)) as container:
        shown = {frame.pts: frame.to_ndarray(format="bgr24") for frame in container.decode(video=0)}
    for index, pts in zip((13, 14, 41), copied.pts.tolist()):
        done = cv2.imencode(".jpg", shown[pts], (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))[1].tobytes()
        assert done == reference[index]


def test_a_log_that_begins_within_a_group_starts_at_its_first_key_frame(tmp_path: Path) -> None:
    data = packets(tmp_path, "h264")
    write_mcap(tmp_path / "log.mcap", messages(ONE) + video_messages(data, "h264")[4:])
    stream = opened(tmp_path, TOPICS + VIDEO).images()["rear"]
    assert stream.exposure_start_ns[0] == ONE.stamps[GROUP]
    reference = frames_of(data, "h264", tmp_path)
    assert dict(stream.read([0, 7])) == {0: reference[GROUP], 7: reference[GROUP + 7]}


def test_a_video_without_key_frames_is_refused(tmp_path: Path) -> None:
    data = packets(tmp_path, "h264")
    write_mcap(tmp_path / "log.mcap", messages(ONE) + video_messages(data, "h264")[1:GROUP])
    with pytest.raises(RecordingError, match="no key frame"):
        opened(tmp_path, TOPICS + VIDEO).images()


def test_an_unknown_format_is_refused_by_name(tmp_path: Path) -> None:
    write_mcap(tmp_path / "log.mcap", messages(ONE) + video_messages([b"\1\2\3"] * 5, "vp9"))
    with pytest.raises(RecordingError, match="format 'vp9'"):
        opened(tmp_path, TOPICS + VIDEO).images()
