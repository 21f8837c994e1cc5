"""Copies of stretches of videos: the same pixels as in the source, from as few packets as possible."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import av
import numpy as np
import pytest

from mirror.errors import RecordingError
from mirror.recordings.remux import copy_frames
from mirror.recordings.video_file import read_video_stamps
from tests.recordings.videos import FRAMES, GROUP, decode_all, write_video

# Several containers and codecs; x264 and x265 with B-frames write frames in another order than that of display.
SOURCES = [
    ("a.mp4", "libx264", 2),
    ("a.mkv", "libx264", 3),
    ("a.ts", "libx264", 0),
    ("b.mp4", "libx265", 3),
    ("c.h264", "libx264", 0),
    ("d.hevc", "libx265", 0),
    ("e.avi", "mpeg4", 0),
]


@pytest.mark.parametrize(("name", "codec", "b_frames"), SOURCES)
def test_copied_frames_have_the_pixels_of_the_source(tmp_path: Path, name: str, codec: str, b_frames: int) -> None:
    file = write_video(tmp_path / name, codec=codec, b_frames=b_frames)
    decoded = decode_all(file)
    raw = file.suffix in (".h264", ".hevc")
    pts = np.arange(len(decoded)) if raw else read_video_stamps(file)[0]
    reference = dict(zip(pts.tolist(), (data for _, data in decoded))) if raw else dict(decoded)
    for number, chosen in enumerate((slice(0, 5), slice(17, 44, 3), slice(33, 34), slice(58, 60))):
        target = tmp_path / f"copy{number}.mp4"
        copied = copy_frames(file, pts[chosen], target)
        frames = dict(decode_all(target))
        assert [frames[stamp] for stamp in copied.tolist()] == [reference[stamp] for stamp in pts[chosen].tolist()]
        assert (np.diff(copied) > 0).all()


def test_only_the_groups_of_requested_frames_are_copied(tmp_path: Path) -> None:
    file = write_video(tmp_path / "a.ts", b_frames=0)
    pts, _ = read_video_stamps(file)
    copy_frames(file, pts[33:36], tmp_path / "copy.mp4")
    assert len(decode_all(tmp_path / "copy.mp4")) == 36 - 33 // GROUP * GROUP


def test_distances_between_frames_survive(tmp_path: Path) -> None:
    file = write_video(tmp_path / "a.mp4")
    pts, unit = read_video_stamps(file)
    copied = copy_frames(file, pts[11:50], tmp_path / "copy.mp4")
    _, copied_unit = read_video_stamps(tmp_path / "copy.mp4")
    assert copied_unit == unit
    np.testing.assert_array_equal(np.diff(copied), np.diff(pts[11:50]))


def test_equal_input_gives_equal_bytes(tmp_path: Path) -> None:
    file = write_video(tmp_path / "a.mp4")
    pts, _ = read_video_stamps(file)
    for name in ("one.mp4", "two.mp4"):
        copy_frames(file, pts[5:40], tmp_path / name)
    assert (tmp_path / "one.mp4").read_bytes() == (tmp_path / "two.mp4").read_bytes()
    with pytest.raises(RecordingError, match="exists already"):
        copy_frames(file, pts[5:40], tmp_path / "one.mp4")


def test_real_clips(real_data: Path, tmp_path: Path) -> None:
    for name in ("highway_h264_960x540.mp4", "street_hevc_1376x1840.mp4"):
        file = real_data / "video" / name
        pts, _ = read_video_stamps(file)
        copied = copy_frames(file, pts[40:44], tmp_path / name)
        with av.open(str(file)) as container, av.open(str(tmp_path / name)) as copy:
            source = _pixels(_until(container, int(pts[43])), pts[40:44])
            frames = _pixels(copy.decode(video=0), copied)
        for stamp, original in zip(copied.tolist(), pts[40:44].tolist()):
            np.testing.assert_array_equal(frames[stamp], source[original])


def _pixels(frames: Iterable[av.VideoFrame], pts: np.ndarray) -> dict[int, np.ndarray]:
    wanted = set(pts.tolist())
    return {frame.pts: frame.to_ndarray(format="rgb24") for frame in frames if frame.pts in wanted}


def _until(container: av.container.InputContainer, last: int) -> list[av.VideoFrame]:
    frames = []
    for frame in container.decode(video=0):
        frames.append(frame)
        if frame.pts is not None and frame.pts > last + 100_000:
            break
    return frames


def test_refusals_name_the_frame_and_leave_no_file(tmp_path: Path) -> None:
    file = write_video(tmp_path / "a.mp4")
    pts, _ = read_video_stamps(file)
    with pytest.raises(RecordingError, match="no such frame") as caught:
        copy_frames(file, np.array([pts[0], pts[0] + 1]), tmp_path / "copy.mp4")
    assert caught.value.place == f"pts {pts[0] + 1}"
    raw = write_video(tmp_path / "b.h264", b_frames=3)
    with pytest.raises(RecordingError, match="not stored in the order of display"):
        copy_frames(raw, np.arange(3), tmp_path / "copy.mp4")
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RecordingError):
        copy_frames(file, pts[FRAMES - 3 :], tmp_path / "copy.mp4")
    assert not (tmp_path / "copy.mp4").exists()


def test_a_video_without_a_key_frame_is_refused(tmp_path: Path) -> None:
    whole = write_video(tmp_path / "a.h264", b_frames=0, gop=FRAMES)
    data = whole.read_bytes()
    units = [index for index in range(len(data)) if data[index : index + 4] == b"\x00\x00\x00\x01"]
    units += [index for index in range(len(data)) if data[index : index + 3] == b"\x00\x00\x01"]
    # Type 5 is a slice of a key frame.
    starts = sorted({index + data[index:].index(b"\x01") + 1 for index in units})
    key = next(start for start in starts if data[start] & 31 == 5)
    following = starts[starts.index(key) + 1]
    cut = tmp_path / "cut.h264"
    cut.write_bytes(data[: key - 4] + data[following - 4 :])
    with pytest.raises(RecordingError, match=r"key frame|cannot be"):
        copy_frames(cut, np.arange(2), tmp_path / "copy.mp4")
