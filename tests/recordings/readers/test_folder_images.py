"""Images and videos of the `folder` layout."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from mirror.errors import RecordingError
from mirror.recordings.protocol import ImageStream, ReferencedStream
from mirror.recordings.registry import open_recording
from tests.builders.small_folder import START_NS, write_image, write_recording
from tests.recordings.videos import FRAMES, decode_all, write_video


def stream_of(path: Path) -> ImageStream:
    return open_recording(path).images()["front_wide"]


def refusal(path: Path) -> RecordingError:
    with pytest.raises(RecordingError) as caught:
        stream_of(path)
    return caught.value


def test_names_are_mid_exposures_in_time_order(tmp_path: Path) -> None:
    path = write_recording(tmp_path, images=["1000.png", "999.png", "20.png"])
    stream = stream_of(path)
    assert stream.codec == "png"
    assert stream.exposure_start_ns.tolist() == stream.exposure_end_ns.tolist() == [20, 999, 1000]
    assert Path(stream.path(1)) == path / "images" / "front_wide" / "999.png"
    assert dict(stream.read([0, 2]))[2] == (path / "images" / "front_wide" / "1000.png").read_bytes()


def test_a_table_gives_the_exposures(tmp_path: Path) -> None:
    path = write_recording(tmp_path, images=["b.jpg", "a.jpg"])
    table = path / "images" / "front_wide.csv"
    table.write_text(f"file,exposure_start_ns,exposure_end_ns\nb.jpg,{START_NS},{START_NS + 9}\na.jpg,5,7\n")
    stream = stream_of(path)
    assert stream.exposure_start_ns.tolist() == [5, START_NS]
    assert stream.exposure_end_ns.tolist() == [7, START_NS + 9]
    assert Path(stream.path(0)) == path / "images" / "front_wide" / "a.jpg"


@pytest.mark.parametrize(
    ("rows", "place", "problem"),
    [
        ("a.jpg,1,2\ngone.jpg,3,4\n", "line 3, column file", "'gone.jpg' is no image of images/front_wide"),
        ("a.jpg,1,2\n../front_wide/b.jpg,3,4\n", "line 3, column file", "is no image"),
        ("a.jpg,1,2\n/etc/hostname,3,4\n", "line 3, column file", "is no image"),
        ("a.jpg,1,2\n,3,4\n", "line 3, column file", "is no image"),
        ("a.jpg,1,2\n", None, "1 images of images/front_wide are not listed, such as b.jpg"),
        ("a.jpg,1,2\nb.jpg,4,3\n", "line 3, column exposure_end_ns", "ends before it starts"),
        ("a.jpg,1,2\nb.jpg,x,3\n", "line 3, column exposure_start_ns", "not a number"),
    ],
)
def test_wrong_tables_are_named(tmp_path: Path, rows: str, place: str | None, problem: str) -> None:
    path = write_recording(tmp_path, images=["a.jpg", "b.jpg"])
    (path / "images" / "front_wide.csv").write_text(f"file,exposure_start_ns,exposure_end_ns\n{rows}")
    error = refusal(path)
    assert error.file == str(path / "images" / "front_wide.csv")
    assert error.place == place
    assert problem in error.problem


@pytest.mark.parametrize(
    ("images", "problem"),
    [
        ([], "has no images"),
        (["1.jpg", "2.png"], "images of kinds .jpg, .png"),
        (["1.bmp"], "images of kinds .bmp"),
        (["1.jpg", "front.jpg"], "the name is not a time"),
        (["1.jpg", f"{10**20}.jpg"], "the name is not a time"),
        (["7.jpg", "07.jpg"], "have the same time"),
    ],
)
def test_wrong_folders_are_named(tmp_path: Path, images: list[str], problem: str) -> None:
    error = refusal(write_recording(tmp_path, images=images))
    assert problem in error.problem
    assert error.file is not None and "front_wide" in error.file


def test_a_missing_camera_is_named(tmp_path: Path) -> None:
    path = write_recording(tmp_path)
    shutil.rmtree(path / "images")
    error = refusal(path)
    assert error.problem == "camera front_wide is missing"
    assert error.remedy is not None


def test_links_out_of_the_recording_are_refused(tmp_path: Path) -> None:
    write_image(tmp_path / "elsewhere" / "1.jpg")
    path = write_recording(tmp_path / "drive", images=["2.jpg"])
    (path / "images" / "front_wide" / "1.jpg").symlink_to(tmp_path / "elsewhere" / "1.jpg")
    assert "leads out" in refusal(path).problem
    shutil.rmtree(path / "images" / "front_wide")
    (path / "images" / "front_wide").symlink_to(tmp_path / "elsewhere")
    assert "leads out" in refusal(path).problem


def test_table_of_a_video_gives_its_frames(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "drive")
    shutil.rmtree(path / "images")
    (path / "videos").mkdir()
    video = write_video(path / "videos" / "front_wide.mp4")
    reference = decode_all(video)
    assert "the times of its frames are not given" in refusal(path).problem
    rows = "".join(f"{pts},{1000 + index},{2000 + index}\n" for index, (pts, _) in enumerate(reference))
    (path / "videos" / "front_wide.csv").write_text("pts,exposure_start_ns,exposure_end_ns\n" + rows)
    stream = stream_of(path)
    assert stream.codec == "video"
    assert stream.path(0) is None
    assert stream.exposure_start_ns.tolist() == list(range(1000, 1000 + FRAMES))
    assert dict(stream.read([17, 40])) == {index: reference[index][1] for index in (17, 40)}
    shutil.copy(video, path / "videos" / "front_wide.mkv")
    assert "front_wide.mkv and in videos/front_wide.mp4" in refusal(path).problem


def test_video_with_a_stated_start_needs_no_table(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "drive", cameras={"front_wide": {"video_start_ns": START_NS}})
    shutil.rmtree(path / "images")
    (path / "videos").mkdir()
    write_video(path / "videos" / "front_wide.mkv")
    stream = stream_of(path)
    milliseconds = [index * 33 + index % 3 for index in range(FRAMES)]
    assert ((stream.exposure_start_ns - START_NS) // 10**6).tolist() == milliseconds
    (path / "videos" / "front_wide.mkv").rename(path / "videos" / "front_wide.h264")
    write_video(path / "videos" / "front_wide.h264", b_frames=0)
    assert "no time stamps" in refusal(path).problem


def test_listing_many_images_opens_none(tmp_path: Path) -> None:
    """The files are empty: opening one would fail."""
    path = write_recording(tmp_path, images=[])
    for index in range(1_000):
        (path / "images" / "front_wide" / f"{START_NS + index * 33_333_333}.jpg").touch()
    stream = stream_of(path)
    assert len(stream.exposure_start_ns) == 1_000
    assert (np.diff(stream.exposure_start_ns) == 33_333_333).all()


ELSEWHERE = "uri,exposure_start_ns,exposure_end_ns,byte_length,width_px,height_px\n"


def referring(root: Path, rows: str) -> Path:
    path = write_recording(root)
    shutil.rmtree(path / "images")
    (path / "images").mkdir()
    (path / "images" / "front_wide.csv").write_text(ELSEWHERE + rows)
    return path


def test_images_at_uris_are_fetched_on_demand(tmp_path: Path) -> None:
    import fsspec

    fsspec.filesystem("memory").pipe("/fleet/a.jpg", b"first and more")
    rows = "s3://fleet/b.JPEG?version=3,7,9,30,8,6\nmemory://fleet/a.jpg,5,7,5,8,6\n"
    stream = stream_of(referring(tmp_path, rows))
    assert isinstance(stream, ReferencedStream)
    assert stream.codec == "jpeg"
    assert stream.uris == ("memory://fleet/a.jpg", "s3://fleet/b.JPEG?version=3")
    assert stream.exposure_start_ns.tolist() == [5, 7]
    assert (stream.byte_length.tolist(), stream.width_px.tolist(), stream.height_px.tolist()) == (
        [5, 30],
        [8, 8],
        [6, 6],
    )
    assert stream.path(0) is None
    assert dict(stream.read([0])) == {0: b"first"}
    fsspec.filesystem("memory").rm("/fleet/a.jpg")
    with pytest.raises(RecordingError, match="cannot be fetched") as caught:
        dict(stream.read([0]))
    assert caught.value.file == "memory://fleet/a.jpg"


@pytest.mark.parametrize(
    "uri",
    [
        "file:///etc/hostname.png",
        "FILE:///etc/hostname.png",
        "local:///etc/hostname.png",
        "git://../elsewhere.png",
        "generic:///etc/hostname.png",
        "simplecache::file:///etc/hostname.png",
        "zip://a.png::file:///etc/a.zip",
        "s3://fleet/../other/a.png",
        "images/a.png",
        "/etc/hostname.png",
        "",
    ],
)
def test_uris_that_lead_out_are_refused(tmp_path: Path, uri: str) -> None:
    error = refusal(referring(tmp_path, f"s3://fleet/a.png,1,2,30,8,6\n{uri},3,4,30,8,6\n"))
    assert error.place == "line 3, column uri"
    assert "this machine's files" in error.problem


@pytest.mark.parametrize(
    ("rows", "place", "problem"),
    [
        ("s3://f/a.png,1,2,0,8,6\n", "line 2, column byte_length", "no size"),
        ("s3://f/a.png,1,2,,8,6\n", "line 2, column byte_length", "no size"),
        ("s3://f/a.png,1,2,9,8,99999999999\n", "line 2, column height_px", "no size"),
        ("s3://f/a.png,1,2,9,8,6\ns3://f/b.jpg,3,4,9,8,6\n", None, "images of kinds .jpg, .png"),
        ("s3://f/a.png,1,2,9,8,6\ns3://f/b.png,1,2,9,8,6\n", None, "have the same time"),
        ("s3://f/a.png,2,1,9,8,6\n", "line 2, column exposure_end_ns", "ends before it starts"),
    ],
)
def test_wrong_tables_of_uris_are_named(tmp_path: Path, rows: str, place: str | None, problem: str) -> None:
    error = refusal(referring(tmp_path, rows))
    assert error.place == place
    assert problem in error.problem


def test_camera_with_a_folder_and_uris_is_refused(tmp_path: Path) -> None:
    path = referring(tmp_path, "s3://f/a.png,1,2,9,8,6\n")
    folder = path / "images" / "front_wide"
    write_image(folder / "1.jpg")
    assert refusal(path).place == "column file"
    shutil.rmtree(folder)
    (path / "videos").mkdir()
    write_video(path / "videos" / "front_wide.mp4")
    assert "and in images/front_wide.csv" in refusal(path).problem
