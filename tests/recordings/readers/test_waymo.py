"""Waymo v2: segments written from a synthetic street are read back to their exact poses, cameras, boxes and stamps."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mirror.errors import RecordingError
from mirror.geometry.poses import Poses
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.recordings.discovery import find_recordings
from mirror.recordings.registry import open_recording
from mirror.schema.documents import Roi
from tests.recordings.formats.compare import Tolerances, compare_boxes, compare_cameras, compare_poses
from tests.recordings.formats.street import StreetDrive, synth_drives
from tests.recordings.formats.waymo import READOUT_S, SHUTTER_S, transforms, write_waymo
from tests.recordings.formats.waymo_drive import OFFSET_M, prepared

NAMES = {
    "front_wide": "front_wide",
    "front_left": "front_left",
    "front_right": "front_right",
    "SIDE_LEFT": "rear_left",
    "SIDE_RIGHT": "rear_right",
}
# Seconds since 1970 in float64 resolve 240 ns, in which a vehicle moves by 4 micrometres.
TOLERANCES = Tolerances(position_m=1e-5, angle_rad=1e-6, stamp_ns=500)


@pytest.fixture(scope="module")
def drives() -> tuple[StreetDrive, ...]:
    return tuple(prepared(drive) for drive in synth_drives())


@pytest.fixture(scope="module")
def pristine(drives: tuple[StreetDrive, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_waymo(tmp_path_factory.mktemp("waymo") / "training", drives)


@pytest.fixture
def folder(pristine: Path, tmp_path: Path) -> Path:
    """A copy that a test may change: new files replace the links."""
    return Path(shutil.copytree(pristine, tmp_path / "training", copy_function=os.link))


SEGMENT = "guangzhou-urban-01_000_020"


def test_segments_are_read_back_exactly(pristine: Path, drives: tuple[StreetDrive, ...]) -> None:
    found = find_recordings([pristine])
    assert [path.name for path in found.recordings] == [f"{drive.name}_000_020" for drive in drives]
    for path, drive in zip(found.recordings, drives):
        recording = open_recording(path)
        info = recording.info
        assert info.frame == info.drive_id == f"waymo_{path.name}" and info.is_clip
        assert (info.city, info.light, info.weather) == ("San Francisco", drive.light, "clear")
        track = recording.track()
        assert track.x_m is not None and track.rotation is not None
        poses = Poses(track.rotation, np.stack([track.x_m, track.y_m, track.height_m], axis=1))
        compare_poses(track.timestamp_ns, poses, drive, TOLERANCES)
        compare_cameras(recording, drive, NAMES, TOLERANCES)
        compare_boxes(recording, drive, str, TOLERANCES)
        rows = recording.calibrations().to_pylist()
        assert {row["shutter_direction"] for row in rows} == {"left_to_right"}
        assert max(abs(row["readout_ns"] - READOUT_S * 1e9) for row in rows) < 1_000
        stream = recording.images()["SIDE_LEFT"]
        exposure = stream.exposure_end_ns - stream.exposure_start_ns
        assert np.abs(exposure - (SHUTTER_S + READOUT_S) * 1e9).max() < 1_000
        # Any ascending choice, over several row groups.
        for index, data in stream.read([1, 17, 50, 51]):
            assert data == drive.image("rear_left", index)
        assert [name.partition("/")[0] for name, _ in recording.files()] == [
            "camera_calibration",
            "camera_image",
            "lidar_box",
            "stats",
            "vehicle_pose",
        ]


def test_ingest_finds_the_traversals_of_segments_that_share_a_frame(pristine: Path, tmp_path: Path) -> None:
    scene = Roi(scene_id="place", frame="sf", x_m=OFFSET_M[0], y_m=OFFSET_M[1], radius_m=100.0)
    options = IngestOptions(workers=1, reader_options={"frame": "sf"})
    report = ingest_recordings(find_recordings([pristine]).recordings, [scene], tmp_path / "d", options)
    assert not report.failures
    assert [one.images for one in report.traversals] == [5 * 52, 5 * 52]


def test_components_that_were_not_downloaded(folder: Path) -> None:
    for component in ("lidar_box", "stats", "camera_image"):
        (folder / component / f"{SEGMENT}.parquet").unlink()
    recording = open_recording(folder / SEGMENT)
    assert recording.boxes() is None and recording.rig is None and not recording.images()
    assert recording.info.light is None and recording.calibrations().num_rows == 0
    assert len(recording.track()) == 281


def _replace(file: Path, change: Callable[[pa.Table], pa.Table]) -> None:
    table = pq.read_table(file)
    file.unlink()
    pq.write_table(change(table), file)


def _set(table: pa.Table, name: str, row: int, value: object) -> pa.Table:
    column = table.column(name)
    values = column.to_pylist()
    values[row] = value
    return table.set_column(table.column_names.index(name), name, pa.array(values, column.type))


IMAGE, LENS, BOX = "[CameraImageComponent].", "[CameraCalibrationComponent].", "[LiDARBoxComponent]."


@pytest.mark.parametrize(
    ("component", "change", "problem", "place"),
    [
        ("vehicle_pose", lambda t: t.drop_columns(["key.frame_timestamp_micros"]), "no column", "key.frame"),
        ("camera_image", lambda t: _set(t, "key.camera_name", 4, 9), "camera 9 is exposed", "row 4"),
        ("camera_image", lambda t: _set(t, f"{IMAGE}image", 0, None), "no image", "row 0"),
        (
            "camera_image",
            lambda t: _set(t, f"{IMAGE}rolling_shutter_params.camera_trigger_time", 4, 8e9),
            "is exposed from",
            "row 4",
        ),
        ("camera_calibration", lambda t: _set(t, f"{LENS}width", 0, 0), "greater than 0", "front_wide"),
        (
            "camera_calibration",
            lambda t: t.set_column(
                t.column_names.index(f"{LENS}extrinsic.transform"),
                f"{LENS}extrinsic.transform",
                transforms(np.ones((5, 4, 4))),
            ),
            "no rigid",
            "row 0",
        ),
        ("lidar_box", lambda t: _set(t, f"{BOX}type", 3, 77), "type 77", "row 3"),
        ("lidar_box", lambda t: _set(t, f"{BOX}box.center.x", 3, float("inf")), "is not finite", "row 3"),
    ],
)
def test_faults_are_named(
    folder: Path, component: str, change: Callable[[pa.Table], pa.Table], problem: str, place: str
) -> None:
    file = folder / component / f"{SEGMENT}.parquet"
    _replace(file, change)
    with pytest.raises(RecordingError) as caught:
        recording = open_recording(folder / SEGMENT)
        recording.track()
        recording.calibrations()
        recording.boxes()
        list(recording.images()["front_wide"].read([0, 1]))
    assert problem in caught.value.problem and caught.value.file == str(file)
    assert caught.value.place is not None and place in caught.value.place


def test_a_matrix_that_is_no_pose_costs_its_row(folder: Path) -> None:
    name = "[VehiclePoseComponent].world_from_vehicle.transform"
    _replace(folder / "vehicle_pose" / f"{SEGMENT}.parquet", lambda table: _set(table, name, 5, [0.0] * 16))
    track = open_recording(folder / SEGMENT).track()
    assert track.bad is not None and track.bad.counts() == {"rotation": 1} and track.bad.first.place == "row 5"


def test_truncated_files_links_and_pipes_are_refused(folder: Path, tmp_path: Path) -> None:
    file = folder / "vehicle_pose" / f"{SEGMENT}.parquet"
    data = file.read_bytes()
    file.unlink()
    file.write_bytes(data[: len(data) // 2])
    with pytest.raises(RecordingError, match="cannot be read") as caught:
        open_recording(folder / SEGMENT).track()
    assert caught.value.file == str(file)
    file.unlink()
    (tmp_path / "outside").write_bytes(data)
    file.symlink_to(tmp_path / "outside")
    with pytest.raises(RecordingError, match="leads out"):
        open_recording(folder / SEGMENT)
    file.unlink()
    file.write_bytes(data)
    images = folder / "camera_image" / f"{SEGMENT}.parquet"
    images.unlink()
    os.mkfifo(images)
    with pytest.raises(RecordingError, match="no plain file"):
        _ = open_recording(folder / SEGMENT).rig
