"""Frames of videos equal those of decoding from the start, with fewer decoded frames."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.recordings.protocol import ImageStream
from mirror.recordings.remux import copy_frames
from mirror.recordings.video import VideoStream
from mirror.recordings.video_file import read_video_stamps, to_unix_stamps
from mirror.recordings.video_frames import JPEG_QUALITY
from tests.recordings.videos import FRAMES, GROUP, decode_all, write_video


def open_stream(file: Path, pts: Int64) -> VideoStream:
    return VideoStream("front", pts * 1_000, pts * 1_000, file, pts)


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_video(tmp_path_factory.mktemp("video") / "front.mp4")


@pytest.mark.parametrize("name", ["mp4", "mkv", "ts"])
@pytest.mark.parametrize("b_frames", [0, 3])
def test_each_frame_equals_sequential_decoding(tmp_path: Path, name: str, b_frames: int) -> None:
    file = write_video(tmp_path / f"front.{name}", b_frames=b_frames)
    reference = dict(decode_all(file))
    pts, _ = read_video_stamps(file)
    assert sorted(reference) == pts.tolist()
    stream = open_stream(file, pts)
    assert isinstance(stream, ImageStream)
    for index in range(0, FRAMES, 7):
        assert list(stream.read([index])) == [(index, reference[int(pts[index])])]
    wanted = [1, 2, 3, 29, 30, 31, 55]
    assert {index: reference[int(pts[index])] for index in wanted} == dict(stream.read(wanted))


def test_frames_of_open_gops_are_decoded_from_the_previous_key_frame(tmp_path: Path) -> None:
    file = write_video(tmp_path / "front.mp4", codec="libx265", b_frames=3)
    reference = dict(decode_all(file))
    pts, _ = read_video_stamps(file)
    stream = open_stream(file, pts)
    for index in range(FRAMES):
        assert list(stream.read([index])) == [(index, reference[int(pts[index])])]


def test_only_gops_of_requested_frames_are_decoded(video: Path) -> None:
    pts, _ = read_video_stamps(video)
    stream = open_stream(video, pts)
    assert stream.path(3) is None
    list(stream.read([]))
    assert stream.decoded == 0
    list(stream.read([41, 42, 43]))
    assert stream.decoded == 4
    list(stream.read([5, 55]))
    assert stream.decoded <= 4 + GROUP + GROUP


def test_a_raw_stream_counts_its_frames(tmp_path: Path) -> None:
    file = write_video(tmp_path / "video.h264", b_frames=0)
    reference = decode_all(file)
    assert {pts for pts, _ in reference} == {None}
    stream = open_stream(file, np.arange(FRAMES))
    assert dict(stream.read([12, 13, 47])) == {index: reference[index][1] for index in (12, 13, 47)}
    assert stream.decoded <= 2 * GROUP
    with pytest.raises(RecordingError, match="no time stamps"):
        read_video_stamps(file)
    with pytest.raises(RecordingError, match="no such frame"):
        list(open_stream(file, np.arange(FRAMES + 1)).read([FRAMES]))


def test_a_truncated_video_names_file_and_stamp(video: Path, tmp_path: Path) -> None:
    pts, _ = read_video_stamps(video)
    data = video.read_bytes()
    for share in (0, 20, data.index(b"mdat") + 100, data.index(b"moov") + 100):
        cut = tmp_path / f"cut{share}.mp4"
        cut.write_bytes(data[:share])
        with pytest.raises(RecordingError) as caught:
            list(open_stream(cut, pts).read([FRAMES - 1]))
        assert caught.value.file == str(cut)
        assert caught.value.remedy is not None


def test_truncated_video_with_a_leading_index_lacks_its_last_frames(tmp_path: Path) -> None:
    file = write_video(tmp_path / "front.mkv")
    pts, _ = read_video_stamps(file)
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    stream = open_stream(file, pts)
    assert len(list(stream.read([0, 1]))) == 2
    with pytest.raises(RecordingError, match="cannot be decoded") as caught:
        list(stream.read([FRAMES - 1]))
    assert caught.value.place == f"pts {pts[-1]}"


@pytest.mark.parametrize("pts", [-5, 1, 10**9])
def test_stamp_without_a_frame_is_named(video: Path, pts: int) -> None:
    with pytest.raises(RecordingError, match="no such frame") as caught:
        list(open_stream(video, np.array([pts])).read([0]))
    assert caught.value.place == f"pts {pts}"


def test_stamps_must_ascend_and_match() -> None:
    with pytest.raises(RecordingError, match="pts 3 follows 3"):
        open_stream(Path("front.mp4"), np.array([1, 3, 3]))
    with pytest.raises(RecordingError, match="2 frames but 1 exposure stamps"):
        VideoStream("front", np.array([1]), np.array([1]), Path("front.mp4"), np.array([1, 2]))


def test_a_codec_without_a_decoder_is_named(video: Path, tmp_path: Path) -> None:
    file = tmp_path / "unknown.mp4"
    file.write_bytes(video.read_bytes().replace(b"avc1", b"zzz1"))
    pts, _ = read_video_stamps(video)
    reads: list[Callable[[], object]] = [
        lambda: list(open_stream(file, pts).read([0])),
        lambda: read_video_stamps(file),
        lambda: copy_frames(file, pts[:5], tmp_path / "copy.mp4"),
    ]
    for read in reads:
        with pytest.raises(RecordingError, match=r"unknown\.mp4.*no decoder.*ffmpeg"):
            read()
    assert not (tmp_path / "copy.mp4").exists()


def test_file_without_video_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.mp4").write_text("no video")
    for file in (tmp_path / "text.mp4", tmp_path / "gone.mp4"):
        with pytest.raises(RecordingError, match="cannot be read"):
            read_video_stamps(file)


@given(st.integers(1, 1_000_000), st.integers(1, 1_001), st.integers(0, 10**6))
def test_stamps_are_exact_to_the_nanosecond(denominator: int, numerator: int, units: int) -> None:
    time_base = Fraction(numerator, denominator)
    found = to_unix_stamps(np.array([7, 7 + units]), time_base, 10**18)
    assert abs(int(found[1]) - 10**18 - units * time_base * 10**9) <= Fraction(1, 2)
    assert found[0] == 10**18


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("name", "wanted", "decoded"),
    [("highway_h264_960x540.mp4", [3, 100, 101, 218], 4 + 12 + 9), ("street_hevc_1376x1840.mp4", [3, 12, 13], 16)],
)
def test_real_videos(real_data: Path, name: str, wanted: list[int], decoded: int) -> None:
    file = real_data / "video" / name
    pts, _ = read_video_stamps(file)
    stream = open_stream(file, pts)
    found = dict(stream.read(wanted))
    assert stream.decoded <= decoded
    stamps = {int(pts[index]): index for index in wanted}
    with av.open(str(file)) as container:
        for frame in container.decode(video=0):
            if frame.pts in stamps:
                _, data = cv2.imencode(
                    ".jpg", frame.to_ndarray(format="bgr24"), (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY)
                )
                assert found[stamps.pop(frame.pts)] == data.tobytes()
            if not stamps:
                return
    raise AssertionError(f"frames {stamps} are not in the video")
