"""Rows that make no pose: dropped and counted up to a share, by every reader alike; the rest stays as it was.

The reference is the straight drive that the recordings were written from, in closed form.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mirror.dataset.layout import Layout
from mirror.errors import RecordingError
from mirror.geometry.geodesy import ecef_R_enu, geodetic_to_ecef, geodetic_to_utm
from mirror.geometry.quaternions import quaternion_from_matrix
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.ingest.usable import clean_usable
from mirror.recordings.protocol import Recording, Track
from mirror.recordings.registry import open_recording
from mirror.recordings.summary import summarise
from mirror.schema.documents import CleaningOptions, CleaningReport, DriveDocument, Roi, TriggerOptions
from mirror.schema.files import read_json
from tests.builders.folder import SCENE, folder_document, write_recording

COUNT = 400
START_NS = 1_622_000_000_000_000_000
STAMPS = START_NS + np.arange(COUNT) * 100_000_000
X_M, Y_M = 1.25 * np.arange(COUNT), np.full(COUNT, 3.0)
LON, LAT = 8.4 + 1e-5 * np.arange(COUNT), np.full(COUNT, 49.0)

Spoil = Callable[[int, list[str]], list[str]]


def put(column: int, text: str) -> Spoil:
    return lambda row, cells: [text if index == column else cell for index, cell in enumerate(cells)]


def table(columns: list[np.ndarray], header: str, bad: Mapping[int, Spoil]) -> str:
    lines = [header]
    for row, cells in enumerate(zip(*(column.tolist() for column in columns))):
        text = [str(cell) for cell in cells]
        lines.append(",".join(bad[row](row, text) if row in bad else text))
    return "\n".join(lines) + "\n"


def folder(path: Path, bad: Mapping[int, Spoil]) -> Path:
    """Columns: 0 stamp, 1 x, 2 y, 3 to 6 quaternion, 7 sigma."""
    document = folder_document("straight", frame={"kind": "local", "name": "yard"})
    path.mkdir()
    (path / "recording.json").write_text(json.dumps(document))
    zero, one = np.zeros(COUNT), np.ones(COUNT)
    columns = [STAMPS, X_M, Y_M, one, zero, zero, zero, np.full(COUNT, 0.02)]
    text = table(columns, "timestamp_ns,x_m,y_m,qw,qx,qy,qz,sigma_m", bad)
    (path / "poses.csv").write_text(text)
    return path


def gps(path: Path, bad: Mapping[int, Spoil]) -> Path:
    """Columns: 0 date and time, 1 longitude, 2 latitude."""
    seconds = STAMPS.astype("datetime64[ns]").astype("datetime64[ms]")
    when = np.array([f"{str(one)[5:7]}/{str(one)[8:10]}/{str(one)[:4]} {str(one)[11:]}Z" for one in seconds])
    file = path.with_suffix(".csv")
    file.write_text(table([when, LON, LAT], "time,lon,lat", bad))
    return file


def boreas(path: Path, bad: Mapping[int, Spoil]) -> Path:
    """Columns: 0 stamp, 1 easting, 2 northing, 3 altitude, 4 to 6 angles; in metres of the reference frame."""
    path = path.parent / "boreas-2021-08-05-13-34"
    path.mkdir()
    zero = np.zeros(COUNT)
    header = "GPSTime,easting,northing,altitude,roll,pitch,heading"
    (path / "camera_poses.csv").write_text(table([STAMPS // 1000, X_M, Y_M, zero, zero, zero, zero], header, bad))
    return path


CASES: dict[str, tuple[Callable[[Path, Mapping[int, Spoil]], Path], Spoil, str]] = {
    "folder: no stamp": (folder, put(0, "90/02/2032"), "time"),
    "folder: stamp too large": (folder, put(0, "9" * 22), "time"),
    "folder: empty stamp": (folder, put(0, ""), "time"),
    "folder: text for a number": (folder, put(1, "east"), "number"),
    "folder: a flipped bit": (folder, put(2, "3\u00e9.0"), "number"),
    "folder: a cell too few": (folder, lambda row, cells: cells[:-2], "cells"),
    "folder: a cell too many": (folder, lambda row, cells: [*cells, "1"], "cells"),
    "folder: no rotation": (folder, put(3, "0.30"), "rotation"),
    "folder: rotation not finite": (folder, put(4, "nan"), "rotation"),
    "folder: negative sigma": (folder, put(7, "-0.02"), "sigma"),
    "csv: no date": (gps, put(0, "90/02/2032 10:00:00Z"), "time"),
    "csv: date of another format": (gps, put(0, "2021-05-26T03:33:20Z"), "time"),
    "csv: the day first": (gps, put(0, "26/05/2021 03:33:20Z"), "time"),
    "csv: empty": (gps, put(0, ""), "time"),
    "csv: a cell too few": (gps, lambda row, cells: cells[:-1], "cells"),
    "csv: text for a number": (gps, put(1, "8.4x"), "number"),
    "boreas: no stamp": (boreas, put(0, "now"), "time"),
    "boreas: no angle": (boreas, put(5, "nan"), "rotation"),
    "boreas: text for an angle": (boreas, put(6, "north"), "number"),
}


def cleaned(recording: Recording, **options: float) -> tuple[Track, CleaningReport]:
    cleaning = CleaningOptions.model_validate(options)
    info = recording.info
    track, _, report = clean_usable(recording.track(), cleaning, TriggerOptions(), is_clip=info.is_clip)
    return track, report


def require_rest(track: Track, bad: list[int]) -> None:
    """The track is the drive but for the bad rows, to the last bit."""
    rest = np.setdiff1d(np.arange(COUNT), bad)
    np.testing.assert_array_equal(track.timestamp_ns, STAMPS[rest])
    if track.x_m is None or track.y_m is None:
        np.testing.assert_array_equal(track.longitude_deg, LON[rest])
        np.testing.assert_array_equal(track.latitude_deg, LAT[rest])
    else:
        np.testing.assert_array_equal(track.x_m, X_M[rest])
        np.testing.assert_array_equal(track.y_m, Y_M[rest])
    for column in (track.rotation, track.sigma_m):
        assert column is None or len(column) == len(rest)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("bad", [[0], [7, 8, 9, 250], [COUNT - 1]])
def test_one_in_a_hundred_is_dropped_and_counted(case: str, bad: list[int], tmp_path: Path) -> None:
    write, spoil, reason = CASES[case]
    recording = open_recording(write(tmp_path / "drive", dict.fromkeys(bad, spoil)))
    track, report = cleaned(recording)
    require_rest(track, bad)
    assert report.bad_rows == {reason: len(bad)}
    assert (report.poses, report.kept) == (COUNT, COUNT - len(bad))


@pytest.mark.parametrize("case", CASES)
def test_more_are_refused_with_the_first_of_them(case: str, tmp_path: Path) -> None:
    write, spoil, reason = CASES[case]
    bad = [30, 31, 32, 33, 300]
    recording = open_recording(write(tmp_path / "drive", dict.fromkeys(bad, spoil)))
    with pytest.raises(RecordingError) as caught:
        cleaned(recording)
    error = caught.value
    assert error.place is not None and error.place.startswith("line 32")
    assert f"5 of {COUNT} rows make no pose ({reason} 5), more than 1.00%" in error.problem
    assert error.remedy is not None and error.remedy.endswith("--max-bad-rows 0.013")
    require_rest(cleaned(recording, max_bad_rows=0.013)[0], bad)


def test_lines_are_counted_across_what_was_left_out(tmp_path: Path) -> None:
    bad: dict[int, Spoil] = {row: lambda row, cells: cells[:2] for row in (3, 4)}
    recording = open_recording(folder(tmp_path / "drive", bad | dict.fromkeys(range(6, 16), put(0, "x"))))
    track = recording.track()
    assert track.bad is not None
    assert (track.bad.first.place, track.bad.before.tolist()) == ("line 5", [3, 3, *[4] * 10])
    only_stamps = open_recording(folder(tmp_path / "other", dict.fromkeys(range(6, 16), put(0, "x"))))
    with pytest.raises(RecordingError) as caught:
        cleaned(only_stamps)
    assert caught.value.place == "line 8, column timestamp_ns"
    mixed = open_recording(folder(tmp_path / "mixed", {COUNT - 1: lambda row, cells: cells[:2], 6: put(0, "x")}))
    assert mixed.track().bad.first.place == "line 8, column timestamp_ns"  # type: ignore[union-attr]


def test_a_torn_line_of_broken_text_is_one_bad_row(tmp_path: Path) -> None:
    path = folder(tmp_path / "drive", {})
    lines = (path / "poses.csv").read_bytes().split(b"\n")
    lines[51] = b"\xee\x80,3.0"
    (path / "poses.csv").write_bytes(b"\n".join(lines))
    track, report = cleaned(open_recording(path))
    require_rest(track, [50])
    assert report.bad_rows == {"cells": 1}


def test_parquet_names_its_rows(tmp_path: Path) -> None:
    path = folder(tmp_path / "drive", {})
    table = pa.csv.read_csv(path / "poses.csv")
    stamps = [None if row == 7 else stamp for row, stamp in enumerate(STAMPS.tolist())]
    lengths = [0.5 if row == 9 else 1.0 for row in range(COUNT)]
    for name, values in (("timestamp_ns", stamps), ("qw", lengths)):
        table = table.set_column(table.column_names.index(name), name, pa.array(values))
    (path / "poses.csv").unlink()
    pq.write_table(table, path / "poses.parquet")
    track, report = cleaned(open_recording(path))
    require_rest(track, [7, 9])
    assert report.bad_rows == {"time": 1, "rotation": 1}
    assert track.bad is not None and track.bad.first.place == "row 7, column timestamp_ns"
    summary = summarise(open_recording(path))
    assert (summary.poses, summary.usable) == (COUNT, COUNT - 2)


def test_a_bad_row_in_one_of_several_files(tmp_path: Path) -> None:
    """A column of text in one file and of numbers in the next is one column all the same."""
    path = folder(tmp_path / "drive", {250: put(1, "east")})
    header, *lines = (path / "poses.csv").read_text().splitlines(keepends=True)
    (path / "poses.csv").unlink()
    (path / "poses").mkdir()
    for number, first in enumerate((0, 100, 200)):
        last = COUNT if first == 200 else first + 100
        (path / "poses" / f"part{number}.csv").write_text(header + "".join(lines[first:last]))
    track, report = cleaned(open_recording(path))
    require_rest(track, [250])
    assert report.bad_rows == {"number": 1}
    assert track.bad is not None
    assert (Path(track.bad.first.file or "").name, track.bad.first.place) == ("part2.csv", "line 52, column x_m")


@given(st.lists(st.tuples(st.integers(0, COUNT - 1), st.sampled_from(sorted(CASES))), max_size=4))
def test_any_bad_rows_leave_the_others_as_they_were(
    tmp_path_factory: pytest.TempPathFactory, chosen: list[tuple[int, str]]
) -> None:
    bad = {row: CASES[case][1] for row, case in chosen if case.startswith("folder")}
    reasons = {row: CASES[case][2] for row, case in chosen if case.startswith("folder")}
    track, report = cleaned(open_recording(folder(tmp_path_factory.mktemp("any") / "drive", bad)))
    require_rest(track, sorted(bad))
    assert report.bad_rows == {name: list(reasons.values()).count(name) for name in set(reasons.values())}


def test_bad_rows_may_not_uncover_a_tenth_of_the_drive(tmp_path: Path) -> None:
    for count, accepted in ((38, True), (39, False)):
        bad = dict.fromkeys(range(100, 100 + count), put(0, "x"))
        recording = open_recording(folder(tmp_path / f"drive{count}", bad))
        if accepted:
            require_rest(cleaned(recording, max_bad_rows=0.5)[0], sorted(bad))
            continue
        with pytest.raises(RecordingError, match=r"4\.0 s .*39\.9 s") as caught:
            cleaned(recording, max_bad_rows=0.5)
        assert caught.value.remedy is not None and "--max-gap-s 4" in caught.value.remedy
        assert "--max-bad-rows" not in caught.value.remedy
    spread = dict.fromkeys(range(1, COUNT - 1, 2), put(0, "x"))
    require_rest(cleaned(open_recording(folder(tmp_path / "spread", spread)), max_bad_rows=0.5)[0], sorted(spread))


def test_a_gap_that_no_bad_row_leaves_does_not_count() -> None:
    stamps = np.concatenate([STAMPS, STAMPS + 100_000_000_000])
    x = np.concatenate([X_M, X_M + 1250.0])
    track = Track(stamps, x_m=x, y_m=np.zeros(2 * COUNT), rotation=np.tile([1.0, 0, 0, 0], (2 * COUNT, 1)))
    assert track.rotation is not None
    track.rotation[50] = 0.5
    track.rotation[51] = (0.7, 0, 0, 0)
    kept, _, report = clean_usable(track, CleaningOptions(), TriggerOptions(), is_clip=False)
    # (0.5, 0.5, 0.5, 0.5) is a unit quaternion.
    assert (len(kept), report.bad_rows) == (2 * COUNT - 1, {"rotation": 1})


@pytest.mark.parametrize(("place", "counted"), [(1555.0, True), (np.inf, True), (np.nan, False)])
def test_positions_off_the_globe_count_and_missing_ones_do_not(place: float, counted: bool) -> None:
    lon = LON.copy()
    lon[200:205] = place
    track = Track(STAMPS, longitude_deg=lon, latitude_deg=LAT)
    if counted:
        with pytest.raises(RecordingError, match=r"5 of 400 rows make no pose \(position 5\)") as caught:
            clean_usable(track, CleaningOptions(), TriggerOptions(), is_clip=False)
        assert caught.value.place == "pose 200"
    _, _, report = clean_usable(track, CleaningOptions(max_bad_rows=0.02), TriggerOptions(), is_clip=False)
    assert (report.invalid, report.missing, report.kept) == (5, 0 if counted else 5, COUNT - 5)


def test_the_readers_of_arrays_drop_rows_too(tmp_path: Path) -> None:
    segment = tmp_path / "b0c9d2329ad1606b_route" / "0" / "global_pose"
    segment.mkdir(parents=True)
    week, seconds = np.divmod((STAMPS - 315_964_800_000_000_000) * 1e-9 + 18.0, 604_800.0)
    times = np.column_stack([week, seconds])
    times[20], times[21] = np.nan, (1e300, 5.0)
    orientation = np.tile(quaternion_from_matrix(ecef_R_enu(LON[:1], LAT[:1]))[0], (COUNT, 1))
    orientation[300] *= 0.9
    arrays: dict[str, Any] = {
        "frame_gps_times": times,
        "frame_positions": geodetic_to_ecef(LON, LAT, np.zeros(COUNT)),
        "frame_orientations": orientation,
    }
    for name, array in arrays.items():
        with (segment / name).open("wb") as out:
            np.save(out, array)
    track, report = cleaned(open_recording(segment.parent.parent))
    assert report.bad_rows == {"time": 2, "rotation": 1}
    rest = np.setdiff1d(np.arange(COUNT), [20, 21, 300])
    np.testing.assert_allclose(track.longitude_deg, LON[rest], atol=1e-10)
    assert np.abs(track.timestamp_ns - STAMPS[rest]).max() < 200


@pytest.mark.real_data
def test_a_quaternion_without_its_qy_is_refused(real_data: Path, tmp_path: Path) -> None:
    shutil.copytree(real_data / "dgp_scene_02", tmp_path / "scene", ignore=shutil.ignore_patterns("*.jpg", "*.npz"))
    scene = next((tmp_path / "scene").glob("scene_*.json"))
    scene.chmod(0o644)
    document = json.loads(scene.read_bytes())
    for entry in document["data"]:
        for content in entry["datum"].values():
            content["pose"]["rotation"].pop("qy", None)
    scene.write_text(json.dumps(document))
    # Scaled to unit length, as before, the drive of 2.58 m would have been one of 8.41 m.
    with pytest.raises(RecordingError, match=r"is no rotation; .* rows make no pose"):
        cleaned(open_recording(tmp_path / "scene"))


def test_drive_json_says_what_was_dropped(tmp_path: Path) -> None:
    bad: dict[int, Spoil] = {10: put(0, "x"), 11: put(1, "x"), 12: put(3, "0.2")}
    roi = Roi(scene_id="yard", frame="yard", x_m=250.0, y_m=0.0, radius_m=150.0)
    report = ingest_recordings([folder(tmp_path / "drive", bad)], [roi], tmp_path / "d")
    assert not report.failures
    document = read_json(Layout(tmp_path / "d").drive("straight") / "drive.json", DriveDocument)
    assert document.cleaning.bad_rows == {"number": 1, "time": 1, "rotation": 1}
    assert document.cleaning.poses - document.cleaning.kept == 3
    again = ingest_recordings([tmp_path / "drive"], [roi], tmp_path / "d")
    assert again.unchanged == ["straight"]
    strict = ingest_recordings(
        [tmp_path / "drive"], [roi], tmp_path / "e", IngestOptions(cleaning={"max_bad_rows": 0.0})
    )
    assert "3 of 400 rows make no pose" in str(strict.failures[0][1])


def test_a_remedy_does_not_suggest_what_was_given(tmp_path: Path) -> None:
    file = gps(tmp_path / "drive", dict.fromkeys(range(10), put(0, "90/02/2032 10:00:00Z")))
    with pytest.raises(RecordingError) as caught:
        cleaned(open_recording(file))
    assert "date_format" in str(caught.value)
    with pytest.raises(RecordingError) as caught:
        cleaned(open_recording(file, options={"date_format": "MM/DD/YYYY"}))
    assert "90/02/2032" in str(caught.value)
    assert "date_format" not in str(caught.value)
    with pytest.raises(RecordingError) as caught:
        cleaned(open_recording(file), max_bad_rows=0.02)
    assert "--max-bad-rows 0.025" in str(caught.value)


def test_rows_outside_the_utm_zone_are_counted_and_refused_past_the_limit(tmp_path: Path) -> None:
    for wrong, accepted in ((1, True), (40, False)):
        drive = write_recording(tmp_path / str(wrong), "there")
        document = json.loads((drive / "recording.json").read_text())
        document["frame"] = {"kind": "utm", "zone": 32, "hemisphere": "north"}
        (drive / "recording.json").write_text(json.dumps(document))
        rows = [line.split(",") for line in (drive / "poses.csv").read_text().splitlines()[1:]]
        lon, lat = (np.array([float(row[column]) for row in rows]) for column in (1, 2))
        east, north = geodetic_to_utm(lon, lat, 32, True)
        # Without the false easting.
        east[100 : 100 + wrong] -= 650_000.0
        text = "".join(f"{row[0]},{e:.4f},{n:.4f},520.0,90.0\n" for row, e, n in zip(rows, east, north))
        (drive / "poses.csv").write_text("timestamp_ns,easting_m,northing_m,height_m,heading_deg\n" + text)
        report = ingest_recordings([drive], [SCENE], tmp_path / str(wrong) / "d")
        if accepted:
            assert report.drives["there"].cleaning.bad_rows == {"position": 1}
            assert len(report.traversals) == 1
        else:
            ((_, error),) = report.failures
            assert error.place == "line 102" and "position 40" in error.problem
            assert "--max-bad-rows" in str(error.remedy)
