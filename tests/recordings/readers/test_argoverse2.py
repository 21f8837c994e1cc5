"""Argoverse 2: logs written from a synthetic street are read back to their exact poses, cameras, boxes and stamps."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.feather as feather
import pyproj
import pytest

from mirror.errors import RecordingError
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import quaternion_from_matrix, quaternion_multiply
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.recordings.discovery import find_recordings
from mirror.recordings.registry import open_recording
from mirror.schema.documents import Roi
from mirror.schema.files import read_table
from mirror.schema.tables import PASSES
from tests.recordings.formats.argoverse2 import write_argoverse2
from tests.recordings.formats.compare import Tolerances, compare_boxes, compare_cameras, compare_poses
from tests.recordings.formats.street import StreetDrive, straight_drive, synth_drives

OFFSET_M = (5122.0, 2432.0, 66.0)
PITTSBURGH = (-80.01294377242584, 40.44177902989321)
NAMES = {
    "front_wide": "front_wide",
    "front_left": "front_left",
    "front_right": "front_right",
    "rear_left": "rear_left",
    "rear_right": "rear_right",
    "ring_side_left": "front_narrow",
    "ring_side_right": "rear",
}


@pytest.fixture(scope="module")
def drives() -> tuple[StreetDrive, ...]:
    return tuple(drive.placed(OFFSET_M) for drive in synth_drives())


@pytest.fixture(scope="module")
def pristine(drives: tuple[StreetDrive, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("argoverse2") / "val"
    for drive in drives:
        write_argoverse2(root, drive)
    return root


@pytest.fixture
def log(pristine: Path, drives: tuple[StreetDrive, ...], tmp_path: Path) -> Path:
    """A copy of a log that a test may change: new files replace the links."""
    return Path(shutil.copytree(pristine / drives[0].name, tmp_path / drives[0].name, copy_function=os.link))


def city_poses(path: Path) -> tuple[np.ndarray, Poses]:
    """Poses in the city's frame, from degrees, with PROJ's UTM and its meridian convergence as the reference."""
    track = open_recording(path).track()
    assert track.longitude_deg is not None and track.rotation is not None
    utm = pyproj.Proj(proj="utm", zone=17, ellps="WGS84")
    origin = utm(*PITTSBURGH)
    x, y = utm(track.longitude_deg, track.latitude_deg)
    convergence = np.radians(utm.get_factors(track.longitude_deg, track.latitude_deg).meridian_convergence)
    turn = np.zeros((len(track), 3, 3))
    turn[:, 2, 2] = 1.0
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(convergence)
    turn[:, 1, 0], turn[:, 0, 1] = np.sin(convergence), -np.sin(convergence)
    position = np.stack([x - origin[0], y - origin[1], track.height_m], axis=1)
    return track.timestamp_ns, Poses(quaternion_multiply(quaternion_from_matrix(turn), track.rotation), position)


def test_logs_are_read_back_exactly(pristine: Path, drives: tuple[StreetDrive, ...]) -> None:
    found = find_recordings([pristine])
    assert [path.name for path in found.recordings] == [drive.name for drive in drives]
    for path, drive in zip(found.recordings, drives):
        recording = open_recording(path)
        assert (recording.info.drive_id, recording.info.city, recording.info.frame) == (drive.name, "Pittsburgh", None)
        assert recording.info.is_clip and not recording.info.has_date
        stamps, poses = city_poses(path)
        compare_poses(stamps, poses, drive, Tolerances(position_m=1e-5, angle_rad=1e-8))
        compare_cameras(recording, drive, NAMES, Tolerances())
        assert recording.rig is not None and recording.rig.rig_id == "argoverse2_ring"
        assert recording.rig.reference_camera == "front_wide"
        velocities = compare_boxes(recording, drive, str, Tolerances())
        assert all(np.isnan(values).all() for values in velocities.values())
        assert sum(name.endswith(".jpg") for name, _ in recording.files()) == 7 * len(drive.image_ns["rear"])


def test_ingest_finds_the_traversals_of_both_logs(pristine: Path, tmp_path: Path) -> None:
    utm = pyproj.Proj(proj="utm", zone=17, ellps="WGS84")
    east, north = utm(*PITTSBURGH)
    lon, lat = utm(east + OFFSET_M[0], north + OFFSET_M[1], inverse=True)
    scene = Roi(scene_id="place", longitude_deg=lon, latitude_deg=lat, radius_m=100.0)
    paths = find_recordings([pristine]).recordings
    report = ingest_recordings(paths, [scene], tmp_path / "d", IngestOptions(workers=1))
    assert not report.failures
    assert [one.images for one in report.traversals] == [7 * 52, 7 * 52]
    # The logs have no date: the sun says nothing about their light.
    for name in report.drives:
        passes = read_table(tmp_path / "d" / "drives" / name / "passes.parquet", PASSES)
        assert passes.column("light").to_pylist() == ["unknown"]


def test_a_log_without_a_city_keeps_its_metric_frame(tmp_path: Path) -> None:
    drive = straight_drive()
    path = write_argoverse2(tmp_path, drive, city=None)
    recording = open_recording(path)
    assert recording.info.frame == "argoverse2_straight"
    track = recording.track()
    assert (
        track.x_m is not None and np.abs(track.x_m - drive.poses_at(track.timestamp_ns).translation[:, 0]).max() < 1e-8
    )
    assert open_recording(path, options={"city": "MIA"}).info.city == "Miami"
    with pytest.raises(RecordingError, match="unknown city 'XYZ'"):
        open_recording(path, options={"city": "XYZ"})


def test_a_log_of_the_test_split_has_no_boxes(log: Path) -> None:
    (log / "annotations.feather").unlink()
    recording = open_recording(log)
    assert recording.boxes() is None
    assert "annotations.feather" not in dict(recording.files())


def test_a_camera_without_calibration_stays_uncalibrated(log: Path) -> None:
    _replace(log / "calibration" / "intrinsics.feather", lambda table: table.slice(1))
    recording = open_recording(log)
    assert "front_wide" not in recording.calibrations().column("camera").to_pylist()
    assert "front_wide" in recording.images()


def _replace(file: Path, change: Callable[[pa.Table], pa.Table]) -> None:
    table = feather.read_table(file, memory_map=False)
    file.unlink()
    feather.write_feather(change(table), file)


def _set(table: pa.Table, name: str, row: int, value: object) -> pa.Table:
    column = table.column(name)
    values = column.to_pylist()
    values[row] = value
    return table.set_column(table.column_names.index(name), name, pa.array(values, column.type))


@pytest.mark.parametrize(
    ("name", "change", "problem", "place"),
    [
        ("city_SE3_egovehicle", lambda t: t.drop_columns(["qx"]), "no column 'qx'", "column qx"),
        ("city_SE3_egovehicle", lambda t: _set(t, "timestamp_ns", 3, None), "a null", "row 3"),
        (
            "city_SE3_egovehicle",
            lambda t: t.rename_columns(["tx_m" if n == "ty_m" else n for n in t.column_names]),
            "twice",
            "tx_m",
        ),
        ("calibration/intrinsics", lambda t: _set(t, "fx_px", 0, 0.0), "fx, fy > 0", "camera front_wide"),
        ("calibration/egovehicle_SE3_sensor", lambda t: _set(t, "qw", 0, 9.0), "is no rotation", "row 0"),
        ("annotations", lambda t: _set(t, "qw", 2, 9.0), "is no rotation", "row 2"),
        ("annotations", lambda t: _set(t, "tx_m", 2, float("nan")), "is not finite", "row 2"),
        (
            "annotations",
            lambda t: t.set_column(0, "timestamp_ns", pa.array(["x"] * t.num_rows)),
            "cannot be used",
            "timestamp_ns",
        ),
    ],
)
def test_faults_are_named(
    log: Path, name: str, change: Callable[[pa.Table], pa.Table], problem: str, place: str
) -> None:
    file = log / f"{name}.feather"
    _replace(file, change)
    with pytest.raises(RecordingError) as caught:
        recording = open_recording(log)
        recording.track()
        recording.calibrations()
        recording.boxes()
    assert problem in caught.value.problem and caught.value.file == str(file)
    assert caught.value.place is not None and place in caught.value.place


def test_a_bad_quaternion_costs_its_row(log: Path) -> None:
    _replace(log / "city_SE3_egovehicle.feather", lambda table: _set(table, "qw", 5, 3.0))
    track = open_recording(log).track()
    assert track.bad is not None and track.bad.counts() == {"rotation": 1} and track.bad.first.place == "row 5"


def test_truncated_files_links_and_pipes_are_refused(log: Path, tmp_path: Path) -> None:
    poses = log / "city_SE3_egovehicle.feather"
    data = poses.read_bytes()
    poses.unlink()
    poses.write_bytes(data[: len(data) // 2])
    with pytest.raises(RecordingError, match="cannot be read") as caught:
        open_recording(log).track()
    assert caught.value.file == str(poses)
    image = next((log / "sensors" / "cameras" / "ring_front_left").iterdir())
    image.unlink()
    os.mkfifo(image)
    with pytest.raises(RecordingError, match="no plain file"):
        open_recording(log).images()
    image.unlink()
    image.symlink_to(tmp_path.parent)
    with pytest.raises(RecordingError, match="leads out"):
        open_recording(log).files()
    image.unlink()
    (image.parent / "frame_1.jpg").write_bytes(b"")
    with pytest.raises(RecordingError, match="no image of the camera"):
        _ = open_recording(log).rig
    poses.unlink()
    with pytest.raises(RecordingError, match="no reader recognises"):
        open_recording(log)
