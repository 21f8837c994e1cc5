"""KITTI odometry: sequences written from a synthetic street are read back to their exact poses, cameras and times."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from mirror.errors import RecordingError
from mirror.geometry.poses import Poses
from mirror.recordings.discovery import find_recordings
from mirror.recordings.protocol import Track
from mirror.recordings.registry import open_recording
from tests.recordings.formats.compare import Tolerances, compare_cameras, compare_poses
from tests.recordings.formats.kitti import from_first_camera, write_kitti_odometry
from tests.recordings.formats.street import StreetDrive, synth_drives


@pytest.fixture(scope="module")
def drives() -> dict[str, StreetDrive]:
    one, other = synth_drives()
    return {"00": from_first_camera(one), "07": from_first_camera(other, cameras=2)}


@pytest.fixture(scope="module")
def pristine(drives: dict[str, StreetDrive], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_kitti_odometry(tmp_path_factory.mktemp("kitti") / "dataset", drives)


@pytest.fixture
def folder(pristine: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(pristine, tmp_path / "dataset"))


def poses_of(track: Track) -> Poses:
    assert track.rotation is not None
    return Poses(track.rotation, np.column_stack([track.x_m, track.y_m, track.height_m]))


def test_sequences_are_read_back_exactly(pristine: Path, drives: dict[str, StreetDrive]) -> None:
    found = find_recordings([pristine]).recordings
    assert [path.name for path in found] == ["00", "07"]
    for path, drive in zip(found, drives.values()):
        recording = open_recording(path)
        info, track = recording.info, recording.track()
        assert info.drive_id == info.frame == f"kitti_odometry_{path.name}"
        assert info.body_frame == "camera" and not info.has_date
        assert track.timestamp_ns.tolist() == drive.pose_ns.tolist()
        compare_poses(track.timestamp_ns, poses_of(track), drive, Tolerances())
        # The camera looks ahead and the road is level: z is up, and x the direction of travel at the first frame.
        moved = poses_of(track).translation
        assert np.abs(moved[:, 2]).max() < 0.1 * np.linalg.norm(moved[-1]) and moved[5, 0] > 5.0 * abs(moved[5, 1])
        compare_cameras(recording, drive, {name: name for name in drive.cameras}, Tolerances())
        assert recording.boxes() is None
    assert {file for file, _ in recording.files()} >= {"poses/07.txt", "sequences/07/calib.txt"}


def test_a_sequence_is_named_by_its_folder_too(pristine: Path, tmp_path: Path) -> None:
    inside = open_recording(pristine / "sequences" / "07")
    assert inside.info == open_recording(pristine / "07").info
    assert find_recordings([pristine / "sequences" / "07"]).recordings == (pristine / "sequences" / "07",)
    with pytest.raises(RecordingError, match="holds 2 drives"):
        open_recording(pristine)
    with pytest.raises(RecordingError, match="no drive '08'"):
        open_recording(pristine / "08")
    with pytest.raises(RecordingError, match="no KITTI odometry folder"):
        open_recording(tmp_path, "kitti_odometry")


def test_images_may_be_jpegs(drives: dict[str, StreetDrive], tmp_path: Path) -> None:
    drive = drives["07"]
    recording = open_recording(write_kitti_odometry(tmp_path / "dataset", {"07": drive}, ".jpg"))
    compare_cameras(recording, drive, {name: name for name in drive.cameras}, Tolerances())
    image = next((tmp_path / "dataset" / "sequences" / "07" / "image_1").iterdir())
    image.rename(image.with_suffix(".png"))
    with pytest.raises(RecordingError, match="no image of the camera"):
        open_recording(tmp_path / "dataset").images()


def test_a_camera_may_have_a_single_image(folder: Path) -> None:
    for image in sorted((folder / "sequences" / "07" / "image_1").iterdir())[1:]:
        image.unlink()
    streams = open_recording(folder / "07").images()
    assert sorted(len(stream.exposure_start_ns) for stream in streams.values())[0] == 1


def test_sequences_without_poses_are_no_drives(folder: Path) -> None:
    (folder / "poses" / "00.txt").unlink()
    assert find_recordings([folder]).recordings == (folder,)
    assert open_recording(folder).info.drive_id == "kitti_odometry_07"
    named = open_recording(folder / "00")
    assert named.rig is not None and len(named.images()) == 4
    with pytest.raises(RecordingError, match="has no poses") as caught:
        named.track()
    assert caught.value.file == str(folder / "poses" / "00.txt") and "00 to 10" in str(caught.value.remedy)


def test_bad_rows_are_marked_and_keep_their_frame(folder: Path, drives: dict[str, StreetDrive]) -> None:
    poses = folder / "poses" / "00.txt"
    lines = poses.read_text().splitlines()
    lines[3] = " ".join(lines[3].split()[:7])
    lines[5] = lines[5].replace(lines[5].split()[0], "nan", 1)
    poses.write_text("\n".join(lines))
    times = folder / "sequences" / "00" / "times.txt"
    seconds = times.read_text().splitlines()
    seconds[7] = "soon"
    seconds[9] = "1e30"
    times.write_text("\n".join(seconds))
    recording = open_recording(folder / "00")
    track = recording.track()
    assert track.bad is not None and track.bad.counts() == {"cells": 1, "rotation": 1, "time": 2}
    assert track.bad.first.place == "line 4" and track.bad.first.file == str(poses)
    kept = [n for n in range(len(lines)) if n not in (3, 5, 7, 9)]
    drive = drives["00"]
    assert track.timestamp_ns.tolist() == drive.pose_ns[kept].tolist()
    assert np.abs(poses_of(track).translation - drive.poses.translation[kept]).max() < 2e-6
    with pytest.raises(RecordingError, match="the frame has no stamp") as caught:
        recording.images()
    assert str(caught.value.file).endswith("image_0/000007.png")


def test_a_lost_line_is_refused_because_it_moves_the_others(folder: Path) -> None:
    poses = folder / "poses" / "00.txt"
    lines = poses.read_text().splitlines()
    poses.write_text("\n".join(lines[:10] + lines[11:]))
    with pytest.raises(RecordingError, match=f"{len(lines) - 1} poses for {len(lines)} frames") as caught:
        open_recording(folder / "00").track()
    assert caught.value.file == str(poses) and "sequences/00/times.txt" in str(caught.value.expected)


def test_broken_calibrations_are_named(folder: Path) -> None:
    file = folder / "sequences" / "00" / "calib.txt"
    text = file.read_text()
    first_of_second = text.splitlines()[1].split()[1]
    for old, new, problem in (
        ("P1:", "P9:", "the line is missing"),
        ("P1: ", "P1: 1 ", "cannot be used"),
        (f"P1: {first_of_second}", "P1: nan", "not finite"),
    ):
        file.write_text(text.replace(old, new))
        with pytest.raises(RecordingError, match=problem) as caught:
            open_recording(folder / "00").calibrations()
        assert caught.value.place == "P1" and caught.value.file == str(file)
    first = text.split()[1]
    file.write_text(text.replace(first, "0.0", 1))
    with pytest.raises(RecordingError, match="focal lengths") as caught:
        open_recording(folder / "00").calibrations()
    assert caught.value.place == "P0" and caught.value.file == str(file)
    file.write_text(text)
    image = folder / "sequences" / "00" / "image_0" / "000000.png"
    image.write_bytes(b"")
    with pytest.raises(RecordingError, match="neither a JPEG nor a PNG") as caught:
        open_recording(folder / "00").calibrations()
    assert caught.value.file == str(image)
