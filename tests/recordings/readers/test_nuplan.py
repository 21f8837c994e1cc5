"""nuPlan: databases written from a synthetic street are read back to their exact poses, cameras, boxes and stamps."""

from __future__ import annotations

import os
import pickle
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyproj
import pytest

from mirror.errors import RecordingError
from mirror.geometry.cameras.camera import Camera
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import quaternion_exp, quaternion_multiply
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.recordings.discovery import find_recordings
from mirror.recordings.readers.nuplan_database import load_numbers
from mirror.recordings.registry import open_recording
from mirror.schema.documents import Roi
from tests.recordings.formats.compare import Tolerances, compare_boxes, compare_cameras, compare_poses
from tests.recordings.formats.nuplan import DISTORTION, token, write_nuplan
from tests.recordings.formats.street import StreetDrive, straight_drive, synth_drives

OFFSET_M = (664_400.0, 3_998_300.0, 605.0)
NAMES = {"front_wide": "front_wide", "rear_left": "rear_left", "CAM_L1": "front_narrow"}


@pytest.fixture(scope="module")
def drives() -> tuple[StreetDrive, ...]:
    placed = [drive.placed(OFFSET_M).upright().with_cameras(tuple(NAMES.values())) for drive in synth_drives()]
    return tuple(
        replace(
            drive,
            cameras={
                name: Camera("brown_conrady", c.width_px, c.height_px, c.fx_px, c.fy_px, c.cx_px, c.cy_px, DISTORTION)
                for name, c in drive.cameras.items()
            },
        )
        for drive in placed
    )


@pytest.fixture(scope="module")
def pristine(drives: tuple[StreetDrive, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("nuplan")
    for drive in drives:
        write_nuplan(root, drive)
    return root


@pytest.fixture
def log(pristine: Path, drives: tuple[StreetDrive, ...], tmp_path: Path) -> Path:
    """A copy of a database that a test may change, with the images of both."""
    root = Path(shutil.copytree(pristine, tmp_path / "nuplan", copy_function=shutil.copyfile))
    return root / "splits" / "mini" / f"{drives[0].name}.db"


def utm_poses(path: Path) -> tuple[np.ndarray, Poses]:
    """Poses in the UTM zone, from degrees, with PROJ's UTM and its meridian convergence as the reference."""
    track = open_recording(path).track()
    assert track.longitude_deg is not None and track.rotation is not None
    utm = pyproj.Proj(proj="utm", zone=11, ellps="WGS84")
    x, y = utm(track.longitude_deg, track.latitude_deg)
    convergence = np.radians(utm.get_factors(track.longitude_deg, track.latitude_deg).meridian_convergence)
    turn = quaternion_exp(np.outer(convergence, (0.0, 0.0, 1.0)))
    return track.timestamp_ns, Poses(
        quaternion_multiply(turn, track.rotation), np.stack([x, y, track.height_m], axis=1)
    )


def test_logs_are_read_back_exactly(pristine: Path, drives: tuple[StreetDrive, ...]) -> None:
    found = find_recordings([pristine / "splits" / "mini"])
    assert [path.stem for path in found.recordings] == [drive.name for drive in drives]
    for path, drive in zip(found.recordings, drives):
        recording = open_recording(path)
        info = recording.info
        assert (info.drive_id, info.vehicle_id, info.city) == (drive.name, drive.vehicle, "Las Vegas")
        assert not info.is_clip and info.frame is None
        stamps, poses = utm_poses(path)
        compare_poses(stamps, poses, drive, Tolerances(position_m=1e-5))
        compare_cameras(recording, drive, NAMES, Tolerances())
        velocities = compare_boxes(recording, drive, lambda name: token("track", name).hex(), Tolerances())
        for values in velocities.values():
            assert np.abs(values - (3.0, -1.0, 0.25)).max() < 1e-9
        boxes = recording.boxes()
        assert boxes is not None and set(boxes.column("score").to_pylist()) == {0.75}
        assert {name.rpartition(".")[2] for name, _ in recording.files()} == {"db", "jpg"}


def test_ingest_finds_the_traversals_of_both_logs(pristine: Path, tmp_path: Path) -> None:
    lon, lat = pyproj.Proj(proj="utm", zone=11, ellps="WGS84")(*OFFSET_M[:2], inverse=True)
    scene = Roi(scene_id="place", longitude_deg=lon, latitude_deg=lat, radius_m=100.0)
    paths = find_recordings([pristine / "splits" / "mini"]).recordings
    report = ingest_recordings(paths, [scene], tmp_path / "d", IngestOptions(workers=1))
    assert not report.failures
    assert [one.images for one in report.traversals] == [3 * 52, 3 * 52]


def test_a_log_without_blobs_has_poses_and_boxes(tmp_path: Path) -> None:
    path = write_nuplan(tmp_path, replace(straight_drive().placed(OFFSET_M)), blobs=False)
    recording = open_recording(path)
    assert recording.rig is None and not recording.images() and recording.calibrations().num_rows == 0
    assert recording.boxes() is not None and [name for name, _ in recording.files()] == ["straight.db"]
    with pytest.raises(RecordingError, match="no folder"):
        open_recording(path, options={"blobs": str(tmp_path / "nothing")})


def test_a_missing_image_is_named(log: Path) -> None:
    image = next((log.parents[2] / "sensor_blobs" / log.stem / "CAM_F0").iterdir())
    image.unlink()
    with pytest.raises(RecordingError, match="missing") as caught:
        open_recording(log).files()
    assert caught.value.file == str(image) and "camera archives" in str(caught.value.remedy)


def test_pickles_are_not_executed(tmp_path: Path) -> None:
    class Attack:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return os.system, (f"touch {tmp_path / 'executed'}",)

    for blob in (pickle.dumps(Attack()), pickle.dumps(print), b"\x80\x04.", b"", b"\x80\x04K\x01", 7, None):
        with pytest.raises(RecordingError, match="no pickled numbers"):
            load_numbers(blob, (3,), file=Path("x.db"), place="table camera")
    assert not (tmp_path / "executed").exists()
    for value in ([1.0, 2.0, 3.0], (1, 2, 3), np.array([1.0, 2.0, 3.0])):
        assert load_numbers(pickle.dumps(value), (3,), file=Path("x.db"), place="").tolist() == [1.0, 2.0, 3.0]
    with pytest.raises(RecordingError, match=r"numbers of shape \(2,\)"):
        load_numbers(pickle.dumps([1.0, 2.0]), (3,), file=Path("x.db"), place="")


@pytest.mark.parametrize(
    ("statement", "problem", "place"),
    [
        ("DROP TABLE image", "no table image", "table image"),
        ("ALTER TABLE ego_pose RENAME TO e; CREATE VIEW ego_pose AS SELECT * FROM e", "no table ego_pose", "ego_pose"),
        ("UPDATE ego_pose SET epsg = 4326", "epsg", "ego_pose"),
        ("UPDATE ego_pose SET epsg = 32617 WHERE rowid = 3", "epsg", "ego_pose"),
        ("DELETE FROM ego_pose", "no pose", "ego_pose"),
        ("UPDATE ego_pose SET x = 'abc' WHERE rowid = 3", "no number", "ego_pose"),
        ("DELETE FROM log", "0 rows", "table log"),
        ("UPDATE camera SET intrinsic = x'00' WHERE channel = 'CAM_F0'", "no pickled numbers", "CAM_F0"),
        ("UPDATE camera SET width = -4 WHERE channel = 'CAM_F0'", "greater than 0", "front_wide"),
        ("UPDATE image SET filename_jpg = '../x.jpg'", "leads out", "x.jpg"),
        ("UPDATE image SET timestamp = 'noon' WHERE rowid = 1", "'noon'", "table image"),
        ("DELETE FROM track", "boxes name a lidar_pc, pose, track or category", "lidar_box"),
        ("UPDATE lidar_box SET x = NULL WHERE rowid = 2", "is not finite", "lidar_box"),
    ],
)
def test_faults_are_named(log: Path, statement: str, problem: str, place: str) -> None:
    with closing(sqlite3.connect(log)) as database:
        database.executescript(statement)
    with pytest.raises(RecordingError) as caught:
        recording = open_recording(log, reader="nuplan")
        _ = recording.info
        recording.files()
        recording.track()
        recording.calibrations()
        recording.boxes()
    assert problem in caught.value.problem
    assert caught.value.file == str(log) and place in str(caught.value.place)


def test_damaged_databases_are_named(log: Path, tmp_path: Path) -> None:
    data = log.read_bytes()
    log.write_bytes(data[: len(data) // 2])
    with pytest.raises(RecordingError, match="cannot be read") as caught:
        open_recording(log, reader="nuplan").track()
    assert caught.value.file == str(log)
    assert not list(log.parent.glob("*-wal")) and not list(log.parent.glob("*-journal"))
    log.unlink()
    os.mkfifo(log)
    with pytest.raises(RecordingError, match="no plain file"):
        open_recording(log)
    with pytest.raises(RecordingError, match="no plain file"):
        open_recording(tmp_path, reader="nuplan").track()


def test_bad_rows_are_dropped(log: Path) -> None:
    with closing(sqlite3.connect(log)) as database:
        database.execute("UPDATE ego_pose SET qw = 5 WHERE rowid = 4")
        database.execute("UPDATE ego_pose SET timestamp = 'x' WHERE rowid = 9")
        database.commit()
    track = open_recording(log).track()
    assert track.bad is not None and track.bad.counts() == {"time": 1, "rotation": 1}
