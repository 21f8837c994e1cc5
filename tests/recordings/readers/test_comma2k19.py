"""comma2k19: the real segment, routes of several segments, and broken arrays."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from mirror.cli.main import main
from mirror.errors import RecordingError
from mirror.geometry.quaternions import rotate
from mirror.ingest.run import ingest_recordings
from mirror.recordings.readers.comma2k19 import Comma2k19Reader
from mirror.recordings.registry import open_recording
from mirror.schema.documents import Roi
from tests.recordings.clean_track import clean_track
from tests.recordings.videos import FRAMES, decode_all, write_video

ROUTE = "b0c9d2329ad1606b|2018-08-02--08-34-47"
# San Francisco in ECEF, level and heading along -x; forward, right, down axes.
POSITION = (-2712087.5, -4261670.0, 3881014.5)


def write_segment(path: Path, start_s: float, frames: int = 5) -> Path:
    folder = path / "global_pose"
    folder.mkdir(parents=True)
    arrays = {
        "frame_gps_times": np.stack([np.full(frames, 2012.0), start_s + np.arange(frames) * 0.05], axis=1),
        "frame_positions": np.array(POSITION) + np.arange(frames)[:, None],
        "frame_orientations": np.tile([0.21, -0.80, -0.44, -0.35], (frames, 1))
        / np.linalg.norm([0.21, 0.8, 0.44, 0.35]),
    }
    for name, array in arrays.items():
        with (folder / name).open("wb") as file:
            np.save(file, array)
    return path


@pytest.mark.real_data
def test_real_segment_agrees_with_its_receivers(real_data: Path) -> None:
    route = real_data / "comma2k19" / "Example_1" / ROUTE
    recording = open_recording(route)
    assert recording.info.drive_id == "b0c9d2329ad1606b_2018-08-02--08-34-47"
    assert recording.info.vehicle_type == "Toyota RAV4"
    assert recording.rig is None and recording.images() == {} and recording.boxes() is None
    track = recording.track()
    assert len(track) == 1200
    assert np.abs(np.diff(track.timestamp_ns) - 50_000_000).max() < 2_000_000

    # The receivers' own UTC (milliseconds), less the time a message takes.
    segment = route / "40"
    boot = np.load(segment / "global_pose" / "frame_times", allow_pickle=False)
    gnss = segment / "processed_log" / "GNSS" / "live_gnss_ublox"
    utc = np.load(gnss / "value", allow_pickle=False)[:, 3] / 1e3
    arrival = np.load(gnss / "t", allow_pickle=False)
    ours = np.interp(arrival, boot, (track.timestamp_ns - track.timestamp_ns[0]) / 1e9) + track.timestamp_ns[0] / 1e9
    inside = (arrival > boot[0]) & (arrival < boot[-1])
    assert 0.1 < np.median((ours - utc)[inside]) < 0.3

    # The receiver's positions agree with the track, and forward is the direction of travel.
    fixes = np.load(gnss / "value", allow_pickle=False)
    assert track.longitude_deg is not None and track.latitude_deg is not None and track.rotation is not None
    assert np.abs(np.interp(arrival, boot, track.latitude_deg) - fixes[:, 0])[inside].max() < 1e-4
    assert np.abs(np.interp(arrival, boot, track.longitude_deg) - fixes[:, 1])[inside].max() < 1e-4
    north, east = np.diff(track.latitude_deg), np.diff(track.longitude_deg) * np.cos(np.radians(37.7))
    forward = rotate(track.rotation, (1.0, 0.0, 0.0))[:-1]
    off = np.degrees(np.arctan2(forward[:, 0], forward[:, 1]) - np.arctan2(east, north))
    assert np.abs((off + 180) % 360 - 180).max() < 5.0
    assert (rotate(track.rotation, (0.0, 0.0, 1.0))[:, 2] > 0.98).all()


@pytest.mark.real_data
def test_single_segment_is_a_recording(real_data: Path) -> None:
    recording = open_recording(real_data / "comma2k19" / "Example_1" / ROUTE / "40")
    assert recording.info.drive_id == "b0c9d2329ad1606b_2018-08-02--08-34-47_40"
    assert [name for name, _ in recording.files()] == [
        f"global_pose/{name}" for name in ("frame_gps_times", "frame_orientations", "frame_positions")
    ]


def test_segments_are_one_track_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    route = tmp_path / ROUTE
    for number in (10, 9, 2):
        write_segment(route / str(number), 404_000.0 + 60 * number)
    (route / "notes").mkdir()
    track = open_recording(route).track()
    assert len(track) == 15
    assert (np.diff(track.timestamp_ns) > 0).all()
    # 2018-08-02T16:13:02 UTC less 18 leap seconds is second 404,000 of GPS week 2012.
    assert track.timestamp_ns[0] == (315_964_800 + 2012 * 604_800 + 404_120 - 18) * 10**9


def test_the_videos_of_the_segments_are_one_stream(tmp_path: Path) -> None:
    route = tmp_path / ROUTE
    for number in (0, 1):
        segment = write_segment(route / str(number), 404_000.0 + 60 * number, FRAMES)
        shutil.move(write_video(tmp_path / "video.h264", b_frames=0), segment / "video.hevc")
    recording = open_recording(route)
    assert recording.rig is not None
    stream = recording.images()["front"]
    assert len(stream.exposure_start_ns) == len(stream.exposure_end_ns) == 2 * FRAMES
    assert stream.exposure_start_ns.tolist() == recording.track().timestamp_ns.tolist()
    reference = decode_all(route / "0" / "video.hevc")
    wanted = [3, FRAMES - 1, FRAMES, FRAMES + 7]
    assert dict(stream.read(wanted)) == {index: reference[index % FRAMES][1] for index in wanted}
    assert stream.path(0) is None
    row = recording.calibrations().to_pylist()[0]
    assert (row["camera"], row["fx_px"], row["cx_px"]) == ("front", 910.0, 582.0)


def test_broken_arrays_are_named(tmp_path: Path) -> None:
    def refusal(name: str, data: bytes | np.ndarray | None) -> RecordingError:
        route = tmp_path / f"route{len(list(tmp_path.iterdir()))}"
        file = write_segment(route / "0", 0.0) / "global_pose" / name
        if data is None:
            file.unlink()
        elif isinstance(data, bytes):
            file.write_bytes(data)
        else:
            with file.open("wb") as out:
                np.save(out, data, allow_pickle=True)
        with pytest.raises(RecordingError) as caught:
            clean_track(Comma2k19Reader().open(route, {}))
        return caught.value

    whole = (write_segment(tmp_path / "whole" / "0", 0.0) / "global_pose" / "frame_positions").read_bytes()
    quaternions = np.tile([1.0, 0, 0, 0], (5, 1))
    quaternions[3] = 0
    times = np.tile([2012.0, 1.0], (5, 1))
    times[2, 1] = np.nan
    for name, data, problem, place in (
        ("frame_positions", whole[:-40], "cannot be read", None),
        ("frame_positions", b"", "cannot be read", None),
        ("frame_gps_times", None, "missing", None),
        ("frame_positions", np.array([{"a": 1}], dtype=object), "cannot be read", None),
        ("frame_positions", np.zeros((5, 2)), "shape (5, 2)", None),
        ("frame_positions", np.zeros((0, 3)), "shape (0, 3)", None),
        ("frame_positions", np.zeros((4, 3)), "different lengths", None),
        ("frame_orientations", quaternions, "not usable", "row 3"),
        ("frame_gps_times", times, "not usable", "row 2"),
    ):
        error = refusal(name, data)
        assert problem in error.problem, error
        assert error.place == place
        assert error.file is not None and ("different" in problem or error.file.endswith(name))


def test_folder_without_segments_is_refused(tmp_path: Path) -> None:
    assert not Comma2k19Reader().recognises(tmp_path)
    with pytest.raises(RecordingError, match="no segment"):
        Comma2k19Reader().open(tmp_path, {})


@pytest.mark.parametrize("name", ["frame_positions", "frame_gps_times", None])
@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_damaged_segment_is_counted_and_named(name: str | None, number: int, tmp_path: Path) -> None:
    """Its rows are bad rows of the drive; it counts as one row if no array can be read."""
    route = tmp_path / ROUTE
    for segment in range(3):
        write_segment(route / str(segment), 404_000.0 + 60 * segment)
    damaged = route / str(number) / "global_pose"
    for file in damaged.iterdir():
        if name in (None, file.name):
            file.unlink()
    recording = open_recording(route)
    track = recording.track()
    assert len(track) == 10
    start_ns = (315_964_800 + 2012 * 604_800 + 404_000 - 18) * 10**9
    assert ((track.timestamp_ns[::5] - start_ns) // 10**9).tolist() == [60 * n for n in range(3) if n != number]
    assert track.bad is not None
    lost = 1 if name is None else 5
    assert track.bad.counts() == {"file": lost}
    assert track.bad.before.tolist() == [5 * number] * lost
    assert track.bad.first.file == str(damaged / (name or "frame_gps_times"))
    assert track.bad.first.problem == "missing"
    assert len(recording.files()) == 9 - (3 if name is None else 1)


def test_info_counts_and_names_a_damaged_segment(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    route = tmp_path / ROUTE
    for segment in range(2):
        write_segment(route / str(segment), 404_000.0 + 60 * segment)
    (route / "1" / "global_pose" / "frame_positions").unlink()
    assert main(["info", str(route)]) == 0
    shown = capsys.readouterr().out
    assert "10 (5 usable)" in shown
    assert f"file 5; the first: {route / '1' / 'global_pose' / 'frame_positions'}: missing" in shown


def test_ingest_refuses_a_route_by_the_damaged_segment(tmp_path: Path) -> None:
    route = tmp_path / ROUTE
    for segment in range(3):
        write_segment(route / str(segment), 404_000.0 + 60 * segment)
    (route / "1" / "global_pose" / "frame_positions").write_bytes(b"")
    report = ingest_recordings([route], [Roi(scene_id="s", longitude_deg=0.0, latitude_deg=0.0)], tmp_path / "d")
    (path, error), *others = report.failures
    assert path == route and not others
    assert error.file == str(route / "1" / "global_pose" / "frame_positions")
    assert "5 of 15 rows make no pose (file 5), more than 1.00%" in error.problem
    assert error.remedy is not None and "--max-bad-rows 0.334" in error.remedy
