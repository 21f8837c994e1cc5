"""KITTI raw: drives written from a synthetic street are read back to their exact poses, cameras, stamps and boxes."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from mirror.errors import RecordingError
from mirror.geometry.poses import COLUMNS, Poses
from mirror.geometry.quaternions import matrix_from_quaternion, quaternion_from_matrix
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.recordings.discovery import find_recordings
from mirror.recordings.protocol import Recording
from mirror.recordings.registry import open_recording
from mirror.schema.documents import Roi
from mirror.schema.files import conform
from mirror.schema.tables import BOXES
from tests.recordings.formats.compare import Tolerances, angle_between, compare_cameras, compare_poses
from tests.recordings.formats.kitti import (
    DISTORTION,
    PLACE,
    SIGMA_M,
    as_raw,
    east_north_up,
    topocentric,
    write_kitti_raw,
)
from tests.recordings.formats.street import StreetDrive, synth_drives

DAY = "2011_09_26"
SYNC, EXTRACT = f"{DAY}_drive_0009_sync", f"{DAY}_drive_0011_extract"
# Of the rounding of degrees with 16 digits.
TOLERANCES = Tolerances(position_m=1e-5, angle_rad=1e-7)


@pytest.fixture(scope="module")
def drives() -> dict[str, StreetDrive]:
    one, other = synth_drives()
    return {SYNC: as_raw(one), EXTRACT: as_raw(other, rectified_images=False)}


@pytest.fixture(scope="module")
def pristine(drives: dict[str, StreetDrive], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("kitti")
    return {name: write_kitti_raw(root / name[-7:], drive, name) for name, drive in drives.items()}


@pytest.fixture
def drive_folder(pristine: dict[str, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(pristine[SYNC].parent, tmp_path / DAY)) / SYNC


def world_poses(recording: Recording) -> Poses:
    """The track in the tangent frame of the fixtures' place, by PROJ."""
    track = recording.track()
    assert track.rotation is not None and track.longitude_deg is not None and track.latitude_deg is not None
    position = np.stack(topocentric().transform(track.longitude_deg, track.latitude_deg, track.height_m), axis=1)
    turn = east_north_up(*np.array(PLACE[:2])[:, None]).swapaxes(1, 2)
    local = east_north_up(track.longitude_deg, track.latitude_deg) @ matrix_from_quaternion(track.rotation)
    return Poses(quaternion_from_matrix(turn @ local), position)


@pytest.mark.parametrize("name", [SYNC, EXTRACT])
def test_drives_are_read_back_exactly(name: str, pristine: dict[str, Path], drives: dict[str, StreetDrive]) -> None:
    recording, drive = open_recording(pristine[name]), drives[name]
    info, track = recording.info, recording.track()
    assert info.drive_id == f"kitti_{name}" and info.body_frame == "imu" and "48 m" in info.notes[0]
    assert track.timestamp_ns.tolist() == drive.pose_ns.tolist()
    assert track.sigma_m is not None and set(track.sigma_m.tolist()) == {SIGMA_M}
    compare_poses(track.timestamp_ns, world_poses(recording), drive, TOLERANCES)
    compare_cameras(recording, drive, {camera: camera for camera in drive.cameras}, Tolerances())
    rows = recording.calibrations().to_pylist()
    assert {tuple(row["distortion"]) for row in rows} == ({()} if name == SYNC else {DISTORTION})
    files = dict(recording.files())
    assert f"{name}/oxts/timestamps.txt" in files and "calib_velo_to_cam.txt" in files
    assert (f"{name}/tracklet_labels.xml" in files) == (name == SYNC)


def test_boxes_stand_where_the_road_users_are(pristine: dict[str, Path], drives: dict[str, StreetDrive]) -> None:
    recording, drive = open_recording(pristine[SYNC]), drives[SYNC]
    boxes = recording.boxes()
    assert boxes is not None
    rows = conform(boxes, BOXES, file="boxes").to_pylist()
    stamps, poses = drive.image_ns["image_00"], drive.poses_at(drive.image_ns["image_00"])
    for number, one in enumerate(drive.objects):
        mine = [row for row in rows if row["track_id"] == str(number)]
        assert [row["timestamp_ns"] for row in mine] == stamps[number:].tolist()
        box = Poses.from_columns({column: [row[column] for row in mine] for column in COLUMNS})
        world, truth = poses[np.arange(number, len(stamps))] @ box, one.world_SE3_box[np.arange(number, len(stamps))]
        assert np.abs(world.translation - truth.translation).max() < 1e-9
        assert angle_between(world.rotation, truth.rotation).max() < 1e-8
        sizes = {(row["length_m"], row["width_m"], row["height_m"]) for row in mine}
        assert sizes == {one.size_m} and {row["category"] for row in mine} == {one.category}
        assert {row["vx_mps"] for row in mine} == {None}
    assert len(rows) == sum(len(stamps) - number for number in range(len(drive.objects)))
    assert open_recording(pristine[SYNC], options={"boxes": "no"}).boxes() is None


def test_boxes_without_images_have_the_stamps_of_the_lidar(drive_folder: Path, drives: dict[str, StreetDrive]) -> None:
    lidar = drive_folder / "velodyne_points"
    lidar.mkdir()
    shutil.copyfile(drive_folder / "image_02" / "timestamps.txt", lidar / "timestamps.txt")
    for camera in range(4):
        shutil.rmtree(drive_folder / f"image_{camera:02d}")
    recording = open_recording(drive_folder)
    boxes = recording.boxes()
    assert recording.rig is None and boxes is not None
    assert set(boxes.column("timestamp_ns").to_pylist()) == set(drives[SYNC].image_ns["image_02"].tolist())


def test_a_day_holds_its_drives(pristine: dict[str, Path], drive_folder: Path, tmp_path: Path) -> None:
    other = Path(shutil.copytree(pristine[EXTRACT], drive_folder.parent / EXTRACT))
    assert find_recordings([tmp_path]).recordings == (drive_folder, other)
    with pytest.raises(RecordingError, match="a day with 2 drives") as caught:
        open_recording(drive_folder.parent)
    assert str(drive_folder) in str(caught.value.remedy)
    shutil.rmtree(other)
    assert open_recording(drive_folder.parent).info == open_recording(drive_folder).info
    with pytest.raises(RecordingError, match="no drive of KITTI raw"):
        open_recording(tmp_path, "kitti_raw")


def test_ingest_finds_the_traversal(pristine: dict[str, Path], tmp_path: Path) -> None:
    scene = Roi(scene_id="place", longitude_deg=PLACE[0], latitude_deg=PLACE[1], radius_m=100.0)
    report = ingest_recordings([pristine[SYNC]], [scene], tmp_path / "d", IngestOptions(workers=1))
    assert not report.failures
    # The last images of three cameras are a microsecond or more after the last pose.
    assert [one.images for one in report.traversals] == [4 * 29 - 3]


def test_a_zone_moves_all_stamps(pristine: dict[str, Path], drives: dict[str, StreetDrive]) -> None:
    recording = open_recording(pristine[SYNC], options={"tz": "Etc/GMT-2"})
    hours = (drives[SYNC].pose_ns - recording.track().timestamp_ns) / 3.6e12
    assert set(hours.tolist()) == {2.0}
    with pytest.raises(RecordingError, match="unknown time zone"):
        open_recording(pristine[SYNC], options={"tz": "Mars"}).track()


def test_bad_fixes_are_marked_and_named(drive_folder: Path, drives: dict[str, StreetDrive]) -> None:
    data = drive_folder / "oxts" / "data"
    fix = (data / "0000000003.txt").read_text().split()

    def write(frame: int, words: list[str]) -> None:
        (data / f"{frame:010d}.txt").write_text(" ".join(words))

    write(3, fix[:20])
    write(5, [*fix[:10], "nan", *fix[11:]])
    write(6, ["91", *fix[1:]])
    write(7, [*fix[:5], "400", *fix[6:]])
    write(8, [*fix[:23], "-1", *fix[24:]])
    stamps = drive_folder / "oxts" / "timestamps.txt"
    lines = stamps.read_text().splitlines()
    lines[9] = "noon"
    stamps.write_text("\n".join(lines[:-1]))
    track = open_recording(drive_folder).track()
    assert track.bad is not None
    assert track.bad.counts() == {"cells": 2, "position": 1, "rotation": 1, "sigma": 1, "time": 2}
    assert track.bad.first.file == str(data / "0000000003.txt") and track.bad.first.remedy
    kept = [n for n in range(len(lines) - 1) if n not in (3, 5, 6, 7, 8, 9)]
    assert track.timestamp_ns.tolist() == drives[SYNC].pose_ns[kept].tolist()


@pytest.mark.parametrize(
    ("name", "old", "new", "place", "problem"),
    [
        ("calib_cam_to_cam.txt", "P_rect_01", "P_rect_09", "P_rect_01", "the line is missing"),
        ("calib_cam_to_cam.txt", "R_rect_00: ", "R_rect_00: 7", "R_rect_00", "no rigid motion"),
        ("calib_cam_to_cam.txt", "S_rect_02: 6.4", "S_rect_02: 0.0", "camera image_02.width_px", "greater than 0"),
        ("calib_imu_to_velo.txt", "T: ", "T: inf ", "T", "cannot be used"),
        ("calib_velo_to_cam.txt", "R: ", "Q: ", "R", "the line is missing"),
        ("calib_velo_to_cam.txt", "", None, None, "missing"),
    ],
)
def test_broken_calibrations_are_named(
    name: str, old: str, new: str | None, place: str | None, problem: str, drive_folder: Path
) -> None:
    file = drive_folder.parent / name
    text = file.read_text()
    assert old in text
    if new is None:
        file.unlink()
    else:
        file.write_text(text.replace(old, new))
    with pytest.raises(RecordingError, match=problem) as caught:
        open_recording(drive_folder).calibrations()
    assert caught.value.file == str(file) and caught.value.place == place and caught.value.remedy


def test_broken_tracklets_are_named(drive_folder: Path) -> None:
    file = drive_folder / "tracklet_labels.xml"
    text = file.read_text()
    for old, new, place, problem in (
        ("<h>", "<h>x", "tracklet 0", "h is 'x"),
        ("<objectType>", "<objectType><b/>", "tracklet 0", "no objectType"),
        ("<first_frame>1<", "<first_frame>2<", "tracklet 1, pose 27", "frame 29 has no stamp"),
        ("<rx>0<", "<rx>0.1<", "tracklet 0, pose 0", "tilted"),
        ("<tz>", "<tz>1e400", "tracklet 0, pose 0", "tz is"),
    ):
        changed = text.replace(old, new, 1)
        assert changed != text
        file.write_text(changed)
        with pytest.raises(RecordingError, match=problem) as caught:
            open_recording(drive_folder).boxes()
        assert caught.value.file == str(file) and caught.value.place == place
        assert "--option boxes=no" in str(caught.value.remedy)
    entity = text.replace("<!DOCTYPE boost_serialization>", '<!DOCTYPE a [<!ENTITY b "c">]>')
    for broken, problem in ((text[: len(text) // 2], "cannot be"), ("<a/>", "no tracklets"), (entity, "entities")):
        file.write_text(broken)
        with pytest.raises(RecordingError, match=problem) as caught:
            open_recording(drive_folder).boxes()
        assert caught.value.file == str(file)


def test_what_is_missing_is_named(drive_folder: Path) -> None:
    image = drive_folder / "image_02" / "data" / "0000000004.png"
    image.rename(image.with_name("4.png"))
    with pytest.raises(RecordingError, match="no image of the camera") as caught:
        open_recording(drive_folder).images()
    assert caught.value.file == str(image.with_name("4.png"))
    image.with_name("4.png").unlink()
    assert len(open_recording(drive_folder).images()["image_02"].exposure_start_ns) == 28
    (drive_folder / "image_01" / "timestamps.txt").unlink()
    with pytest.raises(RecordingError, match="missing") as caught:
        open_recording(drive_folder).images()
    assert str(caught.value.file).endswith("image_01/timestamps.txt") and SYNC in str(caught.value.remedy)
    shutil.rmtree(drive_folder / "oxts")
    with pytest.raises(RecordingError, match="missing") as caught:
        open_recording(drive_folder).track()
    assert str(caught.value.file).endswith("oxts/data")
