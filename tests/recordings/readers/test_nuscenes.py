"""nuScenes: a folder written from a synthetic street is read back to its exact poses, cameras, boxes and stamps."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest

from mirror.cli.main import main
from mirror.errors import RecordingError
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import matrix_from_quaternion
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.recordings.discovery import find_recordings
from mirror.recordings.protocol import Recording
from mirror.recordings.readers.nuscenes import NuscenesReader, parse_description
from mirror.recordings.registry import open_recording
from mirror.schema.documents import Roi
from tests.recordings.formats.compare import Tolerances, compare_boxes, compare_cameras, compare_poses
from tests.recordings.formats.nuscenes import CHANNELS, token, write_nuscenes
from tests.recordings.formats.street import StreetDrive, straight_drive, synth_drives

NAMES = {name: name for name in CHANNELS}
# A place on the map of Boston; the reader's own table of origins is the devkit's.
OFFSET_M = (1620.0, 1180.0, 0.0)
BOSTON = (-71.05785369873047, 42.336849169438615)


@pytest.fixture(scope="module")
def drives() -> tuple[StreetDrive, ...]:
    return tuple(drive.placed(OFFSET_M).with_cameras(tuple(CHANNELS)) for drive in synth_drives())


@pytest.fixture(scope="module")
def pristine(drives: tuple[StreetDrive, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_nuscenes(tmp_path_factory.mktemp("nuscenes"), drives)


@pytest.fixture
def folder(pristine: Path, tmp_path: Path) -> Path:
    """A copy that a test may change."""
    copied = tmp_path / "nuscenes"
    shutil.copytree(pristine, copied, copy_function=os.link)
    for file in (copied / "v1.0-mini").iterdir():
        data = file.read_bytes()
        file.unlink()
        file.write_bytes(data)
    return copied


def change(folder: Path, table: str, edit: Callable[[list[dict[str, Any]]], Any]) -> None:
    file = folder / "v1.0-mini" / f"{table}.json"
    rows = json.loads(file.read_text())
    edit(rows)
    file.write_text(json.dumps(rows))


def local_poses(recording: Recording) -> tuple[np.ndarray, Poses]:
    """Poses in the map's frame, from degrees, with PROJ's topocentric conversion as the reference."""
    track = recording.track()
    assert track.longitude_deg is not None and track.rotation is not None and track.height_m is not None
    pipeline = (
        "+proj=pipeline +step +proj=cart +ellps=WGS84"
        f" +step +proj=topocentric +ellps=WGS84 +lon_0={BOSTON[0]!r} +lat_0={BOSTON[1]!r} +h_0=0"
    )
    to_map = pyproj.Transformer.from_pipeline(pipeline)
    position = np.stack(to_map.transform(track.longitude_deg, track.latitude_deg, track.height_m), axis=1)
    # The direction of the ego's axes: points one metre ahead and above, converted in the same way.
    to_ecef = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
    ecef = np.stack(to_ecef.transform(track.longitude_deg, track.latitude_deg, track.height_m), axis=1)
    lon, lat = np.radians(track.longitude_deg), np.radians(track.latitude_deg)
    east = np.stack([-np.sin(lon), np.cos(lon), 0 * lon], axis=1)
    north = np.stack([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)], axis=1)
    enu = np.stack([east, north, np.cross(east, north)], axis=2)
    axes = enu @ matrix_from_quaternion(track.rotation)
    to_geodetic = pyproj.Transformer.from_crs(4978, 4979, always_xy=True)
    columns = []
    for axis in range(3):
        moved = to_geodetic.transform(*(ecef + axes[:, :, axis]).T)
        ahead = np.stack(to_map.transform(*moved), axis=1)
        columns.append(ahead - position)
    matrix = np.tile(np.eye(4), (len(lon), 1, 1))
    matrix[:, :3, :3] = np.linalg.svd(np.stack(columns, axis=2))[0] @ np.linalg.svd(np.stack(columns, axis=2))[2]
    matrix[:, :3, 3] = position
    return track.timestamp_ns, Poses.from_matrix(matrix)


def test_scenes_are_read_back_exactly(pristine: Path, drives: tuple[StreetDrive, ...]) -> None:
    found = find_recordings([pristine])
    assert found.recordings == (pristine / "scene-0001", pristine / "scene-0002")
    for path, drive in zip(found.recordings, drives):
        recording = open_recording(path)
        info = recording.info
        assert (info.drive_id, info.vehicle_id, info.city, info.frame) == (path.name, drive.vehicle, "Boston", None)
        assert info.is_clip and info.light == (None if drive.light == "day" else "night")
        stamps, poses = local_poses(recording)
        compare_poses(stamps, poses, drive, Tolerances(position_m=1e-5, angle_rad=1e-7))
        # Every image has the pose of its own stamp.
        assert set(np.concatenate(list(drive.image_ns.values())).tolist()) <= set(stamps.tolist())
        compare_cameras(recording, drive, NAMES, Tolerances())
        velocities = compare_boxes(
            recording, drive, lambda name, drive=drive: token("instance", drive.name, name), Tolerances()
        )
        for one in drive.objects:
            centre, seconds = one.world_SE3_box.translation, drive.box_ns * 1e-9
            expected = np.gradient(centre, axis=0) / np.gradient(seconds)[:, None]
            assert np.abs(velocities[one.track_id] - expected).max() < 1e-5
        boxes = recording.boxes()
        assert boxes is not None
        assert set(boxes.column("source_version").to_pylist()) == {"v1.0-mini"}
        assert set(boxes.column("category").to_pylist()) <= {"vehicle.car", "vehicle.truck", "vehicle.bus.rigid"}


def test_ingest_finds_the_traversals_of_both_scenes(pristine: Path, tmp_path: Path) -> None:
    lon, lat, _ = _geodetic(OFFSET_M)
    scene = Roi(scene_id="place", longitude_deg=lon, latitude_deg=lat, radius_m=100.0)
    report = ingest_recordings(
        find_recordings([pristine]).recordings, [scene], tmp_path / "d", IngestOptions(workers=1)
    )
    assert not report.failures
    assert [one.images > 0 and one.without_pose == 0 for one in report.traversals] == [True, True]
    assert {info.path.name for info in report.drives.values()} == {"scene-0001", "scene-0002"}


def _geodetic(position_m: tuple[float, float, float]) -> tuple[float, float, float]:
    from mirror.geometry.geodesy import TangentFrame

    lon, lat, height = TangentFrame(*BOSTON).to_geodetic(np.array([position_m]))
    return float(lon[0]), float(lat[0]), float(height[0])


def test_a_location_without_a_known_origin_keeps_its_metric_frame(tmp_path: Path) -> None:
    drive = straight_drive()
    recording = open_recording(write_nuscenes(tmp_path / "n", [drive], location="mars-base"))
    assert recording.info.frame == "mars-base"
    track = recording.track()
    assert track.x_m is not None and track.rotation is not None
    compare_poses(
        track.timestamp_ns,
        Poses(track.rotation, np.stack([track.x_m, track.y_m, track.height_m], axis=1)),
        drive,
        Tolerances(),
    )


def test_an_origin_in_the_log_gives_degrees(tmp_path: Path) -> None:
    root = write_nuscenes(tmp_path / "n", [straight_drive()], location="mars-base")
    change(root, "log", lambda rows: rows[0].update(origin_wgs84=[8.4, 49.0, 115.0]))
    track = open_recording(root).track()
    assert track.longitude_deg is not None and track.height_m is not None
    # The ninth pose lies 16 m east of the first; a degree is 111,320 m times the cosine of the latitude.
    assert track.longitude_deg[0] == pytest.approx(8.4 - 40.0 / (111_320 * np.cos(np.radians(49.0))), abs=3e-6)
    assert track.height_m[0] == pytest.approx(115.5, abs=1e-3)
    change(root, "log", lambda rows: rows[0].update(origin_wgs84=[8.4, 149.0, 115.0]))
    with pytest.raises(RecordingError, match="not a place"):
        _ = open_recording(root).info


def test_poses_in_the_plane_have_no_height(tmp_path: Path) -> None:
    root = write_nuscenes(tmp_path / "n", [straight_drive()])
    change(root, "ego_pose", lambda rows: [row["translation"].__setitem__(2, 0.0) for row in rows])
    assert open_recording(root).track().height_m is None


def test_annotated_frames_alone_when_sweeps_are_absent(folder: Path) -> None:
    shutil.rmtree(folder / "sweeps")
    recording = open_recording(folder / "scene-0001")
    with pytest.raises(RecordingError, match="missing") as caught:
        recording.files()
    assert "sweeps=no" in str(caught.value.remedy)
    keys = open_recording(folder / "scene-0001", options={"sweeps": "no"})
    assert all("/samples/" in f"/{name}" for name, _ in keys.files() if name.endswith(".jpg"))
    assert 0 < len(keys.images()["rear"].exposure_start_ns) < len(recording.images()["rear"].exposure_start_ns)


def test_a_half_downloaded_folder_costs_only_its_scenes(folder: Path, tmp_path: Path) -> None:
    gone = next((folder / "samples" / "CAM_BACK").glob("*02__*.jpg"))
    gone.unlink()
    lon, lat, _ = _geodetic(OFFSET_M)
    scene = Roi(scene_id="place", longitude_deg=lon, latitude_deg=lat, radius_m=100.0)
    report = ingest_recordings(find_recordings([folder]).recordings, [scene], tmp_path / "d", IngestOptions(workers=1))
    ((path, error),) = report.failures
    assert path.name == "scene-0002" and error.file == str(gone) and "download" in str(error.remedy)
    assert len(report.traversals) == 1


def test_versions_side_by_side(folder: Path, tmp_path: Path) -> None:
    """Each scene is listed once, from the version with more scenes; the path names the version."""
    shutil.copytree(folder / "v1.0-mini", folder / "v1.0-trainval")
    change(folder, "scene", lambda rows: rows.pop())
    reader = NuscenesReader()
    assert list(reader.drives(folder)) == ["v1.0-trainval/scene-0001", "v1.0-trainval/scene-0002"]
    assert open_recording(folder / "v1.0-trainval" / "scene-0002").info.drive_id == "scene-0002"
    with pytest.raises(RecordingError, match="has no drive 'scene-0002'"):
        open_recording(folder / "v1.0-mini" / "scene-0002")
    (folder / "v1.0-trainval").rename(folder / "v2.0-trainval")
    with pytest.raises(RecordingError, match=r"version v2\.0-trainval is not supported"):
        open_recording(folder / "v2.0-trainval" / "scene-0001")


def test_the_folder_alone_is_several_drives(pristine: Path) -> None:
    with pytest.raises(RecordingError, match="the folder holds 2 drives") as caught:
        open_recording(pristine)
    assert "scene-0001" in str(caught.value.remedy)
    with pytest.raises(RecordingError, match="no drive 'scene-9'"):
        open_recording(pristine / "scene-9")


@pytest.mark.parametrize(
    ("table", "edit", "problem", "place"),
    [
        ("scene", lambda rows: rows[0].update(log_token="x"), "log_token 'x' names no object of log.json", "token"),
        ("sample", lambda rows: rows[3].update(scene_token="x"), "names no object of scene.json", "object 3"),
        ("sample_data", lambda rows: rows[5].update(sample_token="x"), "names no object of sample.json", "object 5"),
        ("sample_data", lambda rows: rows[0].update(ego_pose_token="x"), "names no object of ego_pose", "scene-0001"),
        ("sample_data", lambda rows: rows[0].update(calibrated_sensor_token="x"), "of calibrated_sensor", "scene-0001"),
        ("sample_data", lambda rows: rows[7].pop("timestamp"), "no value 'timestamp'", "object 7"),
        ("sample_data", lambda rows: rows[0].update(filename="../secret.jpg"), "leads out of the recording", "secret"),
        ("ego_pose", lambda rows: rows[4].update(rotation=[1.0, 0.0]), "no value 'rotation'", "object 4"),
        ("ego_pose", lambda rows: rows[4].update(translation=[1.0, None, 0.0]), "no value 'translation'", "object 4"),
        ("calibrated_sensor", lambda rows: rows[0].update(sensor_token="x"), "names no object of sensor.json", "token"),
        ("calibrated_sensor", lambda rows: rows[0].update(camera_intrinsic=[]), "a matrix of shape (0,)", "CAM_FRONT"),
        ("calibrated_sensor", lambda rows: rows[0].pop("rotation"), "the key 'rotation' is missing", "CAM_FRONT"),
        ("sample_annotation", lambda rows: rows[0].update(instance_token="x"), "of instance.json", "scene-0001"),
        ("sample_annotation", lambda rows: rows[0].update(rotation=[0.0] * 4), "is no rotation", "instance"),
        ("instance", lambda rows: rows[0].update(category_token="x"), "names no object of category.json", "object 0"),
        ("log", lambda rows: rows[0].pop("location"), "no text 'location'", "token"),
        ("log", lambda rows: rows.clear(), "names no object of log.json", "token"),
        ("sensor", lambda rows: rows.append({}), "an object without a token", "object 7"),
    ],
)
def test_faults_are_named(folder: Path, table: str, edit: Callable[..., Any], problem: str, place: str) -> None:
    change(folder, table, edit)
    with pytest.raises(RecordingError) as caught:
        recording = open_recording(folder / "scene-0001")
        _ = recording.info, recording.rig
        recording.files()
        recording.track()
        recording.calibrations()
        recording.images()
        recording.boxes()
    error = caught.value
    assert problem in error.problem
    assert error.place is not None and place in error.place
    assert error.file is not None and (table in error.file)
    assert error.expected is not None and error.remedy is not None


@pytest.mark.parametrize("table", ["sample_data", "scene", "ego_pose", "sample_annotation"])
def test_missing_and_truncated_tables_are_named(folder: Path, table: str) -> None:
    file = folder / "v1.0-mini" / f"{table}.json"
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])
    with pytest.raises(RecordingError, match="not valid JSON") as caught:
        recording = open_recording(folder / "scene-0001")
        recording.files()
        recording.boxes()
    assert caught.value.file == str(file) and caught.value.place is not None
    file.unlink()
    with pytest.raises(RecordingError, match="missing") as caught:
        open_recording(folder / "scene-0001")
    assert caught.value.file == str(file) and "13 tables" in str(caught.value.remedy)


def test_links_outside_and_pipes_are_refused(folder: Path, tmp_path: Path) -> None:
    image = next((folder / "samples" / "CAM_FRONT").glob("*01__*.jpg"))
    outside = tmp_path / "outside.jpg"
    shutil.copy(image, outside)
    image.unlink()
    image.symlink_to(outside)
    with pytest.raises(RecordingError, match="leads out of the recording"):
        open_recording(folder / "scene-0001").images()
    table = folder / "v1.0-mini" / "map.json"
    table.unlink()
    os.mkfifo(table)
    with pytest.raises(RecordingError, match="no plain file"):
        open_recording(folder / "scene-0002")


def test_words_of_a_description() -> None:
    assert parse_description("Rain, many peds, night") == ("night", "rain")
    assert parse_description("After rain, no rain, parked") == (None, None)
    assert parse_description("Train station, knight") == (None, None)
    assert parse_description("dusk, fog") == ("dusk", "fog")


def test_info_lists_the_scenes_and_describes_one(pristine: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(pristine), "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert (listed["kind"], listed["drives"]) == ("drives", ["scene-0001", "scene-0002"])
    assert main(["info", str(pristine)]) == 0
    assert f"mirror info {pristine}/scene-0001" in capsys.readouterr().out
    assert main(["info", str(pristine / "scene-0002"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["info"]["drive_id"] == "scene-0002"
    assert main(["info", str(pristine / "scene-9")]) == 2
    assert "no drive 'scene-9'" in capsys.readouterr().err
