"""The `folder` layout: every frame, time base and file format, and every error."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mirror.errors import RecordingError
from mirror.geometry.geodesy import ecef_R_enu, geodetic_to_ecef, geodetic_to_utm, utm_convergence_rad
from mirror.geometry.quaternions import (
    heading_deg,
    quaternion_from_heading_pitch_roll,
    quaternion_from_matrix,
    rotate,
)
from mirror.recordings.protocol import Recording, Track
from mirror.recordings.registry import open_recording
from mirror.schema.files import conform
from mirror.schema.tables import BOXES, CALIBRATIONS
from tests.builders.small_folder import CALIBRATION, POSES, POSES_ONLY, ROWS, START_NS, write_recording
from tests.recordings.clean_track import clean_track

LON, LAT, HEIGHT = np.array([13.40, 13.41]), np.array([52.50, 52.51]), np.array([40.0, 41.0])
HEADING, PITCH, ROLL = np.array([30.0, 250.0]), np.array([2.0, -1.0]), np.array([0.5, 3.0])
ROTATION = quaternion_from_heading_pitch_roll(HEADING, PITCH, ROLL)


def csv_of(**columns: Any) -> str:
    lines = zip(*([str(value) for value in np.asarray(column).tolist()] for column in columns.values()))
    return "\n".join([",".join(columns), *(",".join(line) for line in lines)]) + "\n"


def track_of(path: Path, poses: str, **changes: Any) -> Track:
    return open_recording(write_recording(path, poses=poses, **POSES_ONLY, **changes)).track()


def refusal(path: Path) -> RecordingError:
    with pytest.raises(RecordingError) as caught:
        read_everything(open_recording(path))
    return caught.value


def read_everything(recording: Recording) -> None:
    _ = recording.info, recording.rig
    recording.files()
    clean_track(recording)
    recording.calibrations()
    recording.images()
    recording.boxes()


def quaternions(rotation: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(("qw", "qx", "qy", "qz"), rotation.T))


def test_recording_with_all_parts_is_read(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "drive", city="Berlin", weather="rain", light="night", licence="CC0")
    (path / "calibrations").mkdir()
    for stage in ("factory", "refined"):
        (path / "calibrations" / f"{stage}.json").write_text(json.dumps([CALIBRATION]))
    recording = open_recording(path)
    info = recording.info
    assert (info.drive_id, info.vehicle_id, info.vehicle_type) == ("drive-1", "car-7", "van")
    assert (info.city, info.weather, info.light, info.licence) == ("Berlin", "rain", "night", "CC0")
    assert (info.time_base, info.frame, info.body_frame, info.is_clip) == ("Unix nanoseconds", None, "ego", False)
    assert recording.rig is not None
    camera = recording.rig.cameras[0]
    assert (camera.name, camera.source_name, camera.static_mask) == ("front_wide", "cam0", None)
    track = recording.track()
    assert track.timestamp_ns.tolist() == [row[0] for row in ROWS]
    np.testing.assert_array_equal(track.longitude_deg, [row[1] for row in ROWS])
    assert track.rotation is None and track.sigma_m is None
    table = conform(recording.calibrations(), CALIBRATIONS, file="calibrations")
    assert table.column("stage").to_pylist() == ["factory", "refined"]
    assert set(table.column("vehicle_id").to_pylist()) == {"car-7"}
    stream = recording.images()["front_wide"]
    assert stream.exposure_start_ns.tolist() == [row[0] for row in ROWS]
    assert recording.boxes() is None
    names = [name for name, _ in recording.files()]
    assert names == sorted(names)
    assert len(names) == 2 + 2 + 5


@pytest.mark.parametrize("angles", [False, True])
def test_every_frame_gives_the_same_track(tmp_path: Path, angles: bool) -> None:
    east, north = geodetic_to_utm(LON, LAT, 33, True)
    convergence = np.degrees(utm_convergence_rad(LON, LAT, 33))
    grid = quaternion_from_heading_pitch_roll(HEADING - convergence, PITCH, ROLL)
    ecef = quaternion_from_matrix(ecef_R_enu(LON, LAT) @ np.stack([rotate(q, np.eye(3)).T for q in ROTATION]))
    x, y, z = geodetic_to_ecef(LON, LAT, HEIGHT).T
    time = {"timestamp_ns": [START_NS, START_NS + 1]}

    def orientation(rotation: np.ndarray, heading: np.ndarray) -> dict[str, Any]:
        if angles:
            return {"heading_deg": heading, "pitch_deg": PITCH, "roll_deg": ROLL}
        return quaternions(rotation)

    found = [
        track_of(
            tmp_path / "wgs84",
            csv_of(**time, longitude_deg=LON, latitude_deg=LAT, height_m=HEIGHT, **orientation(ROTATION, HEADING)),
        ),
        track_of(
            tmp_path / "utm",
            csv_of(
                **time, easting_m=east, northing_m=north, height_m=HEIGHT, **orientation(grid, HEADING - convergence)
            ),
            frame={"kind": "utm", "zone": 33, "hemisphere": "north"},
        ),
        track_of(
            tmp_path / "ecef",
            csv_of(**time, x_m=x, y_m=y, z_m=z, **orientation(ecef, HEADING)),
            frame={"kind": "ecef"},
        ),
    ]
    for track in found:
        assert track.timestamp_ns.tolist() == [START_NS, START_NS + 1]
        np.testing.assert_allclose(track.longitude_deg, LON, atol=1e-10)
        np.testing.assert_allclose(track.latitude_deg, LAT, atol=1e-10)
        np.testing.assert_allclose(track.height_m, HEIGHT, atol=1e-6)
        np.testing.assert_allclose(track.rotation, ROTATION, atol=1e-9)


def test_a_local_frame_keeps_its_name_and_numbers(tmp_path: Path) -> None:
    poses = csv_of(timestamp=[1, 2], x_m=[0.0, 1.0], y_m=[5.0, 5.5], z_m=[0.1, 0.2], heading_deg=[90.0, 0.0])
    path = write_recording(
        tmp_path, poses=poses, **POSES_ONLY, frame={"kind": "local", "name": "yard"}, time_base="unix_s"
    )
    recording = open_recording(path)
    track = recording.track()
    assert recording.info.frame == "yard"
    assert track.timestamp_ns.tolist() == [10**9, 2 * 10**9]
    assert track.longitude_deg is None
    np.testing.assert_array_equal(np.stack([track.x_m, track.y_m, track.height_m]), [[0, 1], [5, 5.5], [0.1, 0.2]])
    np.testing.assert_allclose(rotate(track.rotation, (1.0, 0, 0)), [[1, 0, 0], [0, 1, 0]], atol=1e-15)


@pytest.mark.parametrize(
    ("base", "stamp", "expected"),
    [
        ("unix_us", "1628184886438099", 1_628_184_886_438_099_000),
        ("unix_s", "1628184886.438099123", 1_628_184_886_438_099_123),
        ("gps_us", "1312220104438099", 1_628_184_886_438_099_000),
        ("gps_ns", "1312220104438099001", 1_628_184_886_438_099_001),
    ],
)
def test_time_bases(tmp_path: Path, base: str, stamp: str, expected: int) -> None:
    poses = f"timestamp,longitude_deg,latitude_deg\n{stamp},13.4,52.5\n"
    track = track_of(tmp_path, poses, time_base=base)
    assert track.timestamp_ns.tolist() == [expected]
    assert track.height_m is None


def test_poses_in_many_files_are_one_track(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "csv", poses=None, **POSES_ONLY)
    (path / "poses").mkdir()
    for part in (2, 10, 1):
        rows = csv_of(timestamp_ns=[START_NS + part], longitude_deg=[13.4], latitude_deg=[52.5], speed=[part])
        (path / "poses" / f"part{part}.csv").write_text(rows)
    assert (open_recording(path).track().timestamp_ns - START_NS).tolist() == [1, 2, 10]

    path = write_recording(tmp_path / "parquet", poses=None, **POSES_ONLY, time_base="unix_us")
    (path / "poses").mkdir()
    for part in (0, 1):
        columns = {"timestamp": [part + 1], "longitude_deg": [13.4], "latitude_deg": [52.5], "sigma_m": [0.02]}
        pq.write_table(pa.table(columns), path / "poses" / f"{part}.parquet")
    track = open_recording(path).track()
    assert track.timestamp_ns.tolist() == [1_000, 2_000]
    np.testing.assert_array_equal(track.sigma_m, [0.02, 0.02])


def test_poses_of_an_antenna_become_poses_of_the_ego(tmp_path: Path) -> None:
    poses = csv_of(timestamp_ns=[0, 1], x_m=[2.0, 0.0], y_m=[0.0, 2.0], z_m=[1.5, 1.5], heading_deg=[90.0, 0.0])
    frame = {"kind": "local", "name": "yard"}
    changes = {"frame": frame, "body_frame": "antenna", "ego_SE3_body": [1, 0, 0, 0, 2.0, 0, 1.5]}
    track = track_of(tmp_path / "a", poses, **changes)
    np.testing.assert_allclose(np.stack([track.x_m, track.y_m, track.height_m]), np.zeros((3, 2)), atol=1e-15)
    error = refusal(
        write_recording(tmp_path / "b", poses=poses.replace("heading_deg", "speed"), **POSES_ONLY, **changes)
    )
    assert "no orientation" in error.problem


def test_missing_positions_stay_in_the_track(tmp_path: Path) -> None:
    poses = "timestamp_ns,longitude_deg,latitude_deg,height_m\n0,nan,52.5,\n1,,52.5,3\n"
    track = track_of(tmp_path, poses)
    assert np.isnan(np.asarray(track.longitude_deg)).all()
    assert np.isnan(np.asarray(track.height_m)).tolist() == [True, False]


def test_masks_are_read_inside_the_recording(tmp_path: Path) -> None:
    cameras = {"front_wide": {"static_mask": "masks/front.png"}}
    path = write_recording(tmp_path / "drive", cameras=cameras)
    assert "mask is missing" in refusal(path).problem
    (path / "masks").mkdir()
    mask = np.zeros((6, 8), np.uint8)
    mask[4:] = 255
    cv2.imwrite(str(path / "masks" / "front.png"), mask)
    rig = open_recording(path).rig
    assert rig is not None
    np.testing.assert_array_equal(rig.cameras[0].static_mask, mask)
    assert rig.cameras[0].source_name == "front_wide"
    (path / "masks" / "front.png").write_bytes(b"no image")
    assert "not an image" in refusal(path).problem


def test_boxes_follow_the_table(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "drive")
    row: dict[str, Any] = dict.fromkeys(BOXES.schema.names, 0.0)
    row |= {
        "timestamp_ns": START_NS,
        "track_id": "a",
        "category": "car",
        "source": "s",
        "source_version": "1",
        "qw": 1.0,
        "attributes": None,
    }
    table = pa.Table.from_pylist([row], schema=BOXES.schema)
    pq.write_table(table, path / "boxes.parquet")
    boxes = open_recording(path).boxes()
    assert boxes is not None and boxes.num_rows == 1
    pq.write_table(table.drop_columns("length_m"), path / "boxes.parquet")
    error = refusal(path)
    assert error.place == "column length_m"
    assert error.file == str(path / "boxes.parquet")


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({"format": "other"}, "format"),
        ({"version": "2.0"}, "version"),
        ({"drive_id": "a/b"}, "drive_id"),
        ({"drive_id": ...}, "drive_id"),
        ({"speed": 3}, "speed"),
        ({"weather": "wet"}, "weather"),
        ({"time_base": "tai_s"}, "the whole document"),
        ({"frame": {"kind": "utm"}}, "frame"),
        ({"frame": {"kind": "utm", "zone": 61, "hemisphere": "north"}}, "frame.zone"),
        ({"frame": {"kind": "local"}}, "frame"),
        ({"frame": {"kind": "wgs84", "name": "x"}}, "frame"),
        ({"rig_id": None}, "the whole document"),
        ({"reference_camera": "rear"}, "the whole document"),
        ({"cameras": {"../front": {}}}, "cameras.../front.[key]"),
        ({"ego_SE3_body": [1, 0, 0]}, "ego_SE3_body"),
    ],
)
def test_wrong_keys_are_named(tmp_path: Path, changes: dict[str, Any], place: str) -> None:
    error = refusal(write_recording(tmp_path, **changes))
    assert error.place == place
    assert error.file == str(tmp_path / "recording.json")
    assert error.remedy is not None


@pytest.mark.parametrize("name", ["/etc/hostname", "../secret.png", "masks/../../secret.png", "link.png"])
def test_names_that_lead_out_are_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "secret.png").write_bytes(b"secret")
    path = write_recording(tmp_path / "drive", cameras={"front_wide": {"static_mask": name}})
    (path / "link.png").symlink_to(tmp_path / "secret.png")
    error = refusal(path)
    assert "leads out of the recording" in error.problem
    assert error.place == "cameras.front_wide.static_mask"


@pytest.mark.parametrize(
    ("header", "row", "place"),
    [
        ("timestamp_ns,longitude_deg,latitude_deg,qw,qx,qy,qz", "1,13.4,52.5,0,0,0,0", "line 3, column qw"),
        ("timestamp_ns,longitude_deg,latitude_deg,qw,qx,qy,qz", "1,13.4,52.5,nan,0,0,0", "line 3, column qw"),
        ("timestamp_ns,longitude_deg,latitude_deg,heading_deg", "1,13.4,52.5,", "line 3, column heading_deg"),
        ("timestamp_ns,longitude_deg,latitude_deg", "now,13.4,52.5", "line 3, column timestamp_ns"),
        ("timestamp_ns,longitude_deg,latitude_deg", ",13.4,52.5", "line 3, column timestamp_ns"),
        ("timestamp,longitude_deg,latitude_deg", "90/02/2032,13.4,52.5", "line 3, column timestamp"),
    ],
)
def test_wrong_rows_are_named(tmp_path: Path, header: str, row: str, place: str) -> None:
    good = ",".join(["0", "13.4", "52.5", "1", "0", "0", "0"][: header.count(",") + 1])
    error = refusal(write_recording(tmp_path, poses=f"{header}\n{good}\n{row}\n"))
    assert error.place == place
    assert error.file == str(tmp_path / "poses.csv")
    assert error.remedy is not None


@pytest.mark.parametrize(
    ("poses", "problem", "place"),
    [
        ("timestamp_ns,lon,lat\n0,13.4,52.5\n", "2 columns are missing", "column longitude_deg, latitude_deg"),
        ("longitude_deg,latitude_deg\n13.4,52.5\n", "the column is missing", "column timestamp"),
        (
            "timestamp_ns,longitude_deg,latitude_deg,qw,qx,qy\n0,13.4,52.5,1,0,0\n",
            "the column is missing",
            "column qz",
        ),
        (
            "timestamp_ns,longitude_deg,latitude_deg,pitch_deg\n0,13.4,52.5,1\n",
            "the column is missing",
            "column heading_deg",
        ),
        ("timestamp_ns,longitude_deg,latitude_deg\n", "no rows", None),
        ("", "empty", None),
    ],
)
def test_wrong_tables_are_named(tmp_path: Path, poses: str, problem: str, place: str | None) -> None:
    error = refusal(write_recording(tmp_path, poses=poses))
    assert error.problem == problem
    assert error.place == place
    assert error.file == str(tmp_path / "poses.csv")


def test_truncated_files_are_named(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "drive", poses=None)
    columns = {"timestamp_ns": [START_NS], "longitude_deg": [13.4], "latitude_deg": [52.5]}
    pq.write_table(pa.table(columns), path / "poses.parquet")
    whole = (path / "poses.parquet").read_bytes()
    for size in (0, 10, len(whole) - 4):
        (path / "poses.parquet").write_bytes(whole[:size])
        error = refusal(path)
        assert error.file == str(path / "poses.parquet")
        assert error.remedy is not None
    (path / "poses.parquet").write_bytes(whole)
    (path / "calibrations").mkdir()
    (path / "calibrations" / "online.json").write_text(json.dumps([CALIBRATION])[:-9])
    error = refusal(path)
    assert error.file == str(path / "calibrations" / "online.json")
    assert error.place is not None and error.place.startswith("line 1")
    (path / "recording.json").write_text('{"format": "mirror-folder",')
    assert refusal(path).file == str(path / "recording.json")


@pytest.mark.parametrize(
    ("changes", "place", "problem"),
    [
        ({"camera": "rear"}, "1.camera", "unknown camera 'rear'"),
        ({"model": "fisheye"}, "1", "no camera model"),
        ({"distortion": [0.1]}, "1", "distortion"),
        ({"fx_px": -1}, "1", "fx, fy > 0"),
        ({"fx_px": float("nan")}, "1", "fx, fy > 0"),
        ({"ego_SE3_camera": [0, 0, 0, 0, 1, 2, 3]}, "1", "length 0"),
        ({"ego_SE3_camera": [1, 0, 0, 0]}, "1.ego_SE3_camera", "at least 7"),
        ({"covariance": [0.0]}, "1.covariance", "at least 36"),
        ({"shutter_direction": "sideways"}, "1.shutter_direction", "top_to_bottom"),
        ({"readout_ns": -1}, "1.readout_ns", "greater than or equal to 0"),
        ({"valid_from_ns": 2, "valid_to_ns": 1}, "1", "lies after"),
        ({"fov": 90}, "1.fov", "key is not known"),
    ],
)
def test_wrong_calibrations_are_named(tmp_path: Path, changes: dict[str, Any], place: str, problem: str) -> None:
    path = write_recording(tmp_path)
    (path / "calibrations").mkdir()
    (path / "calibrations" / "factory.json").write_text(json.dumps([CALIBRATION, {**CALIBRATION, **changes}]))
    error = refusal(path)
    assert error.place == place
    assert problem in error.problem
    assert error.file == str(path / "calibrations" / "factory.json")


def test_poses_of_two_kinds_are_refused(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "two")
    pq.write_table(pa.table({"timestamp_ns": [1]}), path / "poses.parquet")
    assert "poses.csv, poses.parquet" in refusal(path).problem
    assert "no poses" in refusal(write_recording(tmp_path / "none", poses=None)).problem
    path = write_recording(tmp_path / "mixed", poses=None)
    (path / "poses").mkdir()
    (path / "poses" / "a.csv").write_text(POSES)
    pq.write_table(pa.table({"timestamp_ns": [1]}), path / "poses" / "b.parquet")
    assert "poses/a.csv, poses/b.parquet" in refusal(path).problem
    path = write_recording(tmp_path / "columns", poses=None)
    (path / "poses").mkdir()
    (path / "poses" / "a.csv").write_text(POSES)
    (path / "poses" / "b.csv").write_text(POSES.replace("height_m", "up_m"))
    assert "differ from those of a.csv: height_m, up_m" in refusal(path).problem


def test_open_reads_only_the_document(tmp_path: Path) -> None:
    path = write_recording(tmp_path, poses="broken", images=[])
    assert open_recording(path).info.drive_id == "drive-1"


def test_headings_of_wgs84_refer_to_true_north(tmp_path: Path) -> None:
    poses = csv_of(timestamp_ns=[0], longitude_deg=[179.99], latitude_deg=[-80.0], heading_deg=[123.0])
    track = track_of(tmp_path, poses)
    assert heading_deg(np.asarray(track.rotation))[0] == pytest.approx(123.0, abs=1e-12)


def test_truth_beside_a_recording_is_not_one_of_its_files(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "drive")
    before = open_recording(path).files()
    (path / "truth" / "depth").mkdir(parents=True)
    (path / "truth" / "depth" / "0.png").write_bytes(b"depth")
    assert list(open_recording(path).files()) == list(before)
    assert "recording.json" in [name for name, _ in before]


def test_arrow_timestamps_and_floats_in_parquet(tmp_path: Path) -> None:
    """Timestamps of any unit are read; a float64 of nanoseconds has lost digits, in poses and in boxes."""
    stamps = np.array([row[0] for row in ROWS]) + 123_456_789
    columns = {"longitude_deg": [row[1] for row in ROWS], "latitude_deg": [row[2] for row in ROWS]}
    path = write_recording(tmp_path / "drive", poses=None, **POSES_ONLY)
    for column in (pa.array(stamps), pa.array(stamps, pa.timestamp("ns")), pa.array(stamps, pa.timestamp("ns", "UTC"))):
        pq.write_table(pa.table({"timestamp_ns": column, **columns}), path / "poses.parquet")
        track = open_recording(path).track()
        assert track.bad is None and track.timestamp_ns.tolist() == stamps.tolist()
    pq.write_table(pa.table({"timestamp_ns": stamps.astype(np.float64), **columns}), path / "poses.parquet")
    track = open_recording(path).track()
    assert len(track) == 0 and track.bad is not None and len(track.bad) == len(ROWS)
    assert "2^53" in track.bad.first.problem and "int64" in track.bad.first.problem
