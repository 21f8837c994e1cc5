"""Boreas: time, axes and angles of the real sequences; images and calibration of a synthetic sequence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyproj
import pytest

from mirror.arrays import Float64
from mirror.errors import RecordingError
from mirror.geometry.cameras.camera import Camera
from mirror.geometry.quaternions import rotate
from mirror.recordings.readers.boreas import BoreasReader
from mirror.recordings.registry import open_recording
from tests.builders.small_folder import write_image
from tests.recordings.clean_track import clean_track

SEQUENCES = ("boreas-2021-08-05-13-34", "boreas-2021-09-02-11-42")
HEADER = "GPSTime,easting,northing,altitude,vel_east,vel_north,vel_up,roll,pitch,heading,angvel_z,angvel_y,angvel_x\n"
# The first row of the first sequence, rounded.
ROW = "1628184886438099,623426.156,4848821.131,153.6,0,0,0,1.71685,-1.32829,-0.15702,0,0,0\n"


def write_sequence(root: Path, rows: str = ROW, *, images: tuple[str, ...] = ()) -> Path:
    path = root / SEQUENCES[0]
    path.mkdir(parents=True)
    (path / "camera_poses.csv").write_text(HEADER + rows)
    for name in images:
        write_image(path / "camera" / name)
    return path


@pytest.mark.real_data
@pytest.mark.parametrize("name", SEQUENCES)
def test_camera_axis_points_along_the_motion(real_data: Path, name: str) -> None:
    recording = open_recording(real_data / "boreas" / name)
    track = recording.track()
    assert track.longitude_deg is not None and track.latitude_deg is not None and track.rotation is not None
    assert track.height_m is not None
    raw = np.genfromtxt(real_data / "boreas" / name / "camera_poses.csv", delimiter=",", names=True)
    assert len(track) == len(raw)
    velocity: Float64 = np.stack([raw["vel_east"], raw["vel_north"], raw["vel_up"]], axis=1)
    speed = np.linalg.norm(velocity, axis=1)
    driving = speed > 5.0
    # The file's velocity refers to grid north, the track's rotation to true north: 1.06 degrees apart.
    forward, up = rotate(track.rotation, (1.0, 0.0, 0.0)), rotate(track.rotation, (0.0, 0.0, 1.0))
    course = np.degrees(np.arctan2(velocity[:, 0], velocity[:, 1]))
    heading = np.degrees(np.arctan2(forward[:, 0], forward[:, 1]))
    turned = ((heading - course)[driving] + 180) % 360 - 180
    assert abs(np.median(turned) - 1.0615) < 0.2
    assert (up[:, 2] > 0.98).all()
    along = np.abs(np.einsum("ni,ni->n", forward, velocity)[driving] / speed[driving])
    assert np.median(along) > 0.999

    # Independent of the file's velocities: PROJ's azimuth from each position to the position 1 s later.
    azimuth, _, distance = pyproj.Geod(ellps="WGS84").inv(
        track.longitude_deg[:-10], track.latitude_deg[:-10], track.longitude_deg[10:], track.latitude_deg[10:]
    )
    straight = (distance > 8.0) & (np.abs(heading[10:] - heading[:-10]) < 0.5)
    off = (heading[5:-5] - azimuth + 180) % 360 - 180
    assert np.count_nonzero(straight) > 1000
    assert abs(np.median(off[straight])) < 0.15


@pytest.mark.real_data
def test_both_routes_begin_at_the_institute(real_data: Path) -> None:
    """Both loops start and end at 4925 Dufferin Street, Toronto; the first at 13:34 local time (UTC-4)."""
    starts = []
    for name in SEQUENCES:
        recording = open_recording(real_data / "boreas" / name)
        track = recording.track()
        assert track.longitude_deg is not None and track.latitude_deg is not None
        starts.append((track.longitude_deg[0], track.latitude_deg[0]))
        assert str(np.datetime64(int(track.timestamp_ns[0]), "ns"))[:10] == name[7:17]
        assert recording.info.drive_id == name
        assert recording.info.body_frame == "camera"
        assert recording.rig is None and recording.images() == {} and recording.boxes() is None
        assert recording.calibrations().num_rows == 0
        assert [file for file, _ in recording.files()] == ["camera_poses.csv"]
    np.testing.assert_allclose(starts, [(-79.4661, 43.7822)] * 2, atol=2e-4)
    first = open_recording(real_data / "boreas" / SEQUENCES[0]).track()
    assert first.timestamp_ns[0] == 1_628_184_886_438_099_000
    assert str(np.datetime64(int(first.timestamp_ns[0]), "ns")).startswith("2021-08-05T17:34:46")


def test_images_and_calibration(tmp_path: Path) -> None:
    path = write_sequence(tmp_path, images=("1628184886538099.png", "1628184886438099.png"))
    (path / "calib").mkdir()
    (path / "calib" / "P_camera.txt").write_text("1460.98 0 1230.0 0\n0 1460.93 1035.08 0\n0 0 1 0\n0 0 0 1\n")
    (path / "lidar").mkdir()
    (path / "lidar" / "1628184886438099.bin").write_bytes(b"")
    recording = open_recording(path)
    assert recording.rig is not None and recording.rig.reference_camera == "front"
    stream = recording.images()["front"]
    assert stream.codec == "png"
    assert stream.exposure_start_ns.tolist() == [1628184886438099000, 1628184886538099000]
    assert stream.path(0) == path / "camera" / "1628184886438099.png"
    row = recording.calibrations().to_pylist()[0]
    assert (row["fx_px"], row["cx_px"], row["cy_px"]) == (1460.98, 1230.5, 1035.58)
    Camera(row["model"], row["width_px"], row["height_px"], row["fx_px"], row["fy_px"], row["cx_px"], row["cy_px"])
    assert [name for name, _ in recording.files()] == [
        "calib/P_camera.txt",
        "camera/1628184886438099.png",
        "camera/1628184886538099.png",
        "camera_poses.csv",
    ]


@pytest.mark.parametrize("last", ["", "0 0 0 1\n"])
def test_projection_with_three_rows_is_accepted(last: str, tmp_path: Path) -> None:
    path = write_sequence(tmp_path, images=("1628184886438099.png",))
    (path / "calib").mkdir()
    (path / "calib" / "P_camera.txt").write_text("1460.98 0 1230.0 0\n0 1460.93 1035.08 0\n0 0 1 0\n" + last)
    row = open_recording(path).calibrations().to_pylist()[0]
    assert (row["fx_px"], row["fy_px"], row["cx_px"], row["cy_px"]) == (1460.98, 1460.93, 1230.5, 1035.58)


def test_positions_of_later_releases_are_in_a_local_frame(tmp_path: Path) -> None:
    path = tmp_path / SEQUENCES[0]
    (path / "applanix").mkdir(parents=True)
    (path / "applanix" / "camera_poses.csv").write_text(HEADER + ROW.replace("623426.156,4848821.131", "-3.5,12.25"))
    recording = BoreasReader().open(path, {})
    track = recording.track()
    assert recording.info.frame == "boreas_enu_ref"
    assert track.x_m is not None and track.y_m is not None
    assert (track.x_m[0], track.y_m[0], track.longitude_deg) == (-3.5, 12.25, None)


@pytest.mark.parametrize(
    ("rows", "place"),
    [
        (ROW + ROW.replace("-1.32829", "nan"), "line 3, column pitch"),
        (ROW + ROW.replace("1628184886438099", "now"), "line 3, column GPSTime"),
    ],
)
def test_broken_rows_are_named(tmp_path: Path, rows: str, place: str) -> None:
    with pytest.raises(RecordingError) as caught:
        clean_track(open_recording(write_sequence(tmp_path, rows)))
    assert caught.value.place == place
    assert caught.value.file is not None and caught.value.file.endswith("camera_poses.csv")


def test_unexpected_files_are_named(tmp_path: Path) -> None:
    path = write_sequence(tmp_path, images=("first.png",))
    (path / "calib").mkdir()
    (path / "calib" / "P_camera.txt").write_text("1 2 3\n")
    with pytest.raises(RecordingError, match="no image of the camera"):
        open_recording(path).images()
    with pytest.raises(RecordingError, match=r"matrix of shape \(3,\)"):
        open_recording(path).calibrations()


def test_folder_with_another_name_is_not_recognised(tmp_path: Path) -> None:
    write_sequence(tmp_path)
    assert not BoreasReader().recognises(tmp_path)
    with pytest.raises(RecordingError, match="no pose file"):
        BoreasReader().open(tmp_path, {})
