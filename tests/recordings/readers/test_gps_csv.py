"""GPS tables: the real drives, usual column names, named columns, and errors."""

from __future__ import annotations

import gzip
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from mirror.errors import RecordingError
from mirror.ingest.clean import clean
from mirror.recordings.protocol import Recording
from mirror.recordings.readers.gps_csv import CsvReader, CsvRecording
from mirror.recordings.registry import open_recording
from mirror.schema.documents import CleaningOptions
from tests.builders.small_folder import POSES, POSES_ONLY, START_NS, write_recording
from tests.recordings.clean_track import clean_track

PLAIN = "timestamp,lat,lon\n1628184886,43.78,-79.46\n1628184887,43.79,-79.45\n"
LOCAL = "Date,Time,LAT,LON,ALT,Weather\n"


def write(file: Path, text: str) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    return file


def refusal(path: Path, options: Mapping[str, str] | None = None) -> RecordingError:
    with pytest.raises(RecordingError) as caught:
        recording = CsvReader().open(path, options or {})
        clean_track(recording)
    return caught.value


@pytest.mark.real_data
def test_real_drives_are_read(real_data: Path) -> None:
    files = sorted((real_data / "rsk_twizy_t3").glob("*.csv"))
    assert len(files) == 10
    options = {"tz": "Africa/Casablanca", "date_format": "MM/DD/YYYY", "vehicle_type": "Renault Twizy"}
    starts = []
    for file in files:
        recording = open_recording(file, options=options)
        assert isinstance(recording, CsvRecording) and isinstance(recording, Recording)
        assert recording.info.drive_id == file.stem
        assert recording.info.weather == "clouds"
        assert recording.rig is None and recording.images() == {} and recording.boxes() is None
        assert recording.calibrations().num_rows == 0
        track = recording.track()
        assert track.rotation is None
        raw = np.genfromtxt(file, delimiter=",", names=True, dtype=None, encoding="utf-8")
        np.testing.assert_array_equal(track.longitude_deg, raw["LON"])
        np.testing.assert_array_equal(track.latitude_deg, raw["LAT"])
        np.testing.assert_array_equal(track.height_m, raw["ALT"])
        starts.append(str(np.datetime64(int(track.timestamp_ns[0]), "ns"))[:19])
    # In Ramadan (until 2021-05-16) Morocco kept UTC, then UTC+1.
    assert starts[0] == "2021-04-22T08:42:50"
    assert starts[-1] == "2021-06-07T15:06:28"
    wild = open_recording(files[-1], options=options).track()
    assert wild.longitude_deg is not None and np.nanmax(wild.longitude_deg) > 1555


@pytest.mark.real_data
def test_only_one_real_drive_has_an_ambiguous_date(real_data: Path) -> None:
    for file in sorted((real_data / "rsk_twizy_t3").glob("*.csv")):
        if file.name == "T3_06_07_2021.csv":
            assert "date_format=MM/DD/YYYY" in str(refusal(file, {"tz": "UTC"}))
        else:
            open_recording(file, options={"tz": "UTC"}).track()


@pytest.mark.parametrize(
    ("text", "first_ns"),
    [
        (PLAIN, 1_628_184_886_000_000_000),
        ("time_us;latitude;longitude\n1628184886438099;43.8;-79.5\n", 1_628_184_886_438_099_000),
        ("Timestamp\tLATITUDE\tLng\n1628184886438\t43.8\t-79.5\n", 1_628_184_886_438_000_000),
        ("timestamp_ns,lat,lon\n1628184886438099001,43.8,-79.5\n", 1_628_184_886_438_099_001),
        ("t,lat,lon\n1628184886.438099001,43.8,-79.5\n", 1_628_184_886_438_099_001),
        ('"datetime","gps_lat","gps_lon"\n"2021-08-05T17:34:46.438099001Z",43.8,-79.5\n', 1_628_184_886_438_099_001),
        ("\ufefftime,lat,long\n2021-08-05 19:34:46+02:00,43.8,-79.5\n", 1_628_184_886_000_000_000),
    ],
)
def test_usual_tables_need_no_options(tmp_path: Path, text: str, first_ns: int) -> None:
    recording = open_recording(write(tmp_path / "drive 1.csv", text))
    assert recording.track().timestamp_ns[0] == first_ns
    assert recording.info.drive_id == "drive_1"
    assert recording.info.vehicle_id == "unknown"


@pytest.mark.parametrize("digits", [8, 11, 14, 17])
def test_the_unit_changes_at_a_power_of_ten(tmp_path: Path, digits: int) -> None:
    """Each unit begins at 1973-03-03; an earlier number is a far date in the next smaller unit."""
    recording = open_recording(write(tmp_path / "x.csv", f"time,lat,lon\n{10**digits},43.8,-79.5\n"))
    assert recording.track().timestamp_ns[0] == 10**17
    if digits > 8:
        assert refusal(write(tmp_path / "y.csv", f"time,lat,lon\n{10**digits - 100},43.8,-79.5\n")).place


def test_numbers_below_1973_in_seconds_have_no_unit(tmp_path: Path) -> None:
    assert "time_unit" in str(refusal(write(tmp_path / "x.csv", "time,lat,lon\n99999999,43.8,-79.5\n")))


def test_stated_columns_units_and_ids(tmp_path: Path) -> None:
    file = write(
        tmp_path / "x.csv", "a,b,c,d,e,f\n1312220104,43.8,-79.5,120,0.5,van 3\n1312220105,43.9,-79.4,,,van 3\n"
    )
    options = {
        "columns": "time=a,lat=b,lon=c,height=d,sigma=e,vehicle=f",
        "time_unit": "gps_s",
        "drive_id": "loop-1",
        "vehicle_type": "van",
    }
    recording = open_recording(file, options=options)
    track = recording.track()
    # GPS second 1,312,220,104 is 2021-08-05T17:34:46 UTC, 18 leap seconds on.
    assert str(np.datetime64(int(track.timestamp_ns[0]), "ns"))[:19] == "2021-08-05T17:34:46"
    assert (recording.info.drive_id, recording.info.vehicle_id) == ("loop-1", "van_3")
    assert recording.info.time_base == "GPS seconds"
    np.testing.assert_array_equal(track.height_m, [120, np.nan])
    np.testing.assert_array_equal(track.sigma_m, [0.5, np.nan])


def test_a_folder_is_one_drive_in_the_order_of_the_names(tmp_path: Path) -> None:
    for number in (10, 9, 1):
        write(tmp_path / "drive" / f"part{number}.csv", f"timestamp,lat,lon\n{1628184886 + number},43.8,-79.5\n")
    write(tmp_path / "drive" / "README.md", "notes")
    recording = open_recording(tmp_path / "drive")
    assert recording.info.drive_id == "drive"
    assert (np.diff(recording.track().timestamp_ns) // 10**9).tolist() == [8, 1]
    assert [name for name, _ in recording.files()] == ["part1.csv", "part10.csv", "part9.csv"]


def test_folder_of_separate_drives_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", "timestamp,lat,lon\n1628184886,43.8,-79.5\n")
    write(tmp_path / "b.csv", "timestamp,lat,lon\n1628100000,43.8,-79.5\n")
    error = refusal(tmp_path)
    assert "one by one" in str(error)
    assert error.file is not None and error.file.endswith("b.csv")


def test_two_files_may_start_with_the_same_stamp(tmp_path: Path) -> None:
    """A logger may split its file within one tick of its clock; only an earlier start is another drive."""
    for name in ("a", "b"):
        write(tmp_path / f"{name}.csv", "timestamp,lat,lon\n1628184886,43.8,-79.5\n")
    assert (np.diff(open_recording(tmp_path).track().timestamp_ns) == 0).all()


def test_folder_layout_is_not_recognised_as_tables(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "drive")
    assert not CsvReader().recognises(path)
    write(tmp_path / "tables" / "poses.csv", POSES)
    write(tmp_path / "tables" / "calibration.json", "{}")
    assert not CsvReader().recognises(tmp_path / "tables")
    write(tmp_path / "other" / "prices.csv", "item,price\nbread,3\n")
    assert not CsvReader().recognises(tmp_path / "other")


def test_the_wrong_date_of_the_sibling_files_is_named(tmp_path: Path) -> None:
    rows = ["05/25/2021,15:46:55", "05/25/2021,15:46:56", "90/02/2032,15:46:57"]
    file = write(tmp_path / "T3.csv", LOCAL + "".join(f"{row},33.9,-6.7,139,Clouds\n" for row in rows))
    error = refusal(file, {"tz": "Africa/Casablanca"})
    assert error.file == str(file)
    assert error.place == "line 4, column Date+Time"
    assert "90/02/2032" in error.problem
    assert error.remedy is not None and "date_format" in error.remedy
    assert "90/02/2032" in refusal(file, {"tz": "UTC", "date_format": "MM/DD/YYYY"}).problem


def test_weather_is_the_most_frequent_word(tmp_path: Path) -> None:
    rows = [("Rain", 10), ("Clouds", 11), ("Rain", 12)]
    file = write(
        tmp_path / "d.csv",
        LOCAL + "".join(f"05/25/2021,15:46:{second},33.9,-6.7,139,{word}\n" for word, second in rows),
    )
    assert open_recording(file, options={"tz": "UTC"}).info.weather == "rain"


@pytest.mark.parametrize(
    ("text", "options", "expected"),
    [
        (PLAIN, {"colums": "lat=a"}, "has no option --option colums=VALUE"),
        (PLAIN.replace("lat", "breite"), {}, "--columns lat="),
        (PLAIN, {"columns": "lat=breite"}, "names no column"),
        (PLAIN, {"columns": "speed=lat"}, "is not a role of a column"),
        (PLAIN, {"time_unit": "hours"}, "unknown time base"),
        (PLAIN.replace("1628184886", "12"), {}, "not a time since 1970 in any unit"),
        (PLAIN.replace("1628184887", "later"), {}, "line 3, column timestamp"),
        (PLAIN.replace("1628184887", ""), {}, "line 3, column timestamp: missing"),
        (PLAIN.replace("43.79", "north"), {}, "line 3, column lat: 'north' is not a number"),
        (PLAIN + "1628184888,43.8\n", {}, "line 4: 2 cells; 1 of 3 rows make no pose (cells 1)"),
        (PLAIN.replace("162818488", "2021-08-05 17:34:4"), {}, "--tz"),
        ("timestamp,lat,lon\n", {}, "no rows"),
        ("", {}, "empty"),
        ("timestamp,lat,lon,vehicle\n1628184886,1,1,a\n1628184887,1,1,b\n", {}, "vehicle_id=<id>"),
    ],
)
def test_refusals_name_place_and_remedy(tmp_path: Path, text: str, options: dict[str, str], expected: str) -> None:
    assert expected in str(refusal(write(tmp_path / "drive.csv", text), options))


def test_a_binary_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "drive.csv").write_bytes(gzip.compress(PLAIN.encode()))
    assert refusal(tmp_path / "drive.csv").file == str(tmp_path / "drive.csv")


def test_wild_fixes_stay_in_the_track(tmp_path: Path) -> None:
    file = write(tmp_path / "drive.csv", PLAIN + "1628184888,nan,1555.6\n1628184880,inf,-79.46\n")
    track = open_recording(file).track()
    assert len(track) == 4
    np.testing.assert_array_equal(track.longitude_deg, [-79.46, -79.45, 1555.6, -79.46])
    assert track.latitude_deg is not None and np.isnan(track.latitude_deg[2]) and np.isinf(track.latitude_deg[3])


def test_folder_without_tables_is_refused(tmp_path: Path) -> None:
    assert not CsvReader().recognises(tmp_path)
    with pytest.raises(RecordingError, match="no tables"):
        CsvReader().open(tmp_path, {})


@pytest.mark.parametrize("stamp", ["2021-08-05 17:34:4", "2021-08-05T17:34:4"])
@pytest.mark.parametrize("zone", ["", "Z", "+02:00"])
def test_time_base_names_the_zone(stamp: str, zone: str, tmp_path: Path) -> None:
    rows = [f"{stamp}{second}{zone},{7 + second * 1e-4},33.0" for second in range(5)]
    file = write(tmp_path / "one.csv", "time,lon,lat\n" + "\n".join(rows) + "\n")
    expected = "date and time with UTC offset" if zone else "date and time, local in Europe/Berlin"
    assert open_recording(file, options={"tz": "Europe/Berlin"}).info.time_base == expected
    assert "unknown time zone 'Mars/X'" in refusal(file, {"tz": "Mars/X"}).problem


def test_the_time_base_of_rows_with_and_without_an_offset_names_both(tmp_path: Path) -> None:
    rows = "2021-08-05T17:34:46Z,7,33\n2021-08-05T19:34:47,7,33\n"
    recording = open_recording(write(tmp_path / "x.csv", "time,lon,lat\n" + rows), options={"tz": "Europe/Berlin"})
    assert recording.info.time_base == "date and time with UTC offset, or else local in Europe/Berlin"
    assert np.diff(recording.track().timestamp_ns).tolist() == [10**9]


@pytest.mark.parametrize("names", ["x_m,y_m,z_m", "X,Y,Z"])
def test_a_local_frame_is_read_as_the_folder_layout_reads_it(names: str, tmp_path: Path) -> None:
    rows = [(START_NS + index * 100_000_000, 1e5 + 0.1 * index, -3.25, 0.5 * index) for index in range(5)]
    lines = "".join(",".join(map(repr, row)) + "\n" for row in rows)
    changes = {**POSES_ONLY, "frame": {"kind": "local", "name": "yard"}}
    folder = write_recording(tmp_path / "drive", poses="timestamp_ns,x_m,y_m,z_m\n" + lines, **changes)
    file = write(tmp_path / "drive.csv", f"timestamp_ns,{names}\n" + lines)
    expected, found = open_recording(folder), open_recording(file, options={"frame": "yard"})
    assert found.info.frame == expected.info.frame == "yard"
    for name in ("timestamp_ns", "x_m", "y_m", "height_m"):
        np.testing.assert_array_equal(getattr(found.track(), name), getattr(expected.track(), name))
    assert found.track().longitude_deg is None
    np.testing.assert_array_equal(found.track().x_m, [row[1] for row in rows])


def test_a_folder_of_local_tables_is_recognised(tmp_path: Path) -> None:
    write(tmp_path / "drive" / "a.csv", "timestamp_ns,x_m,y_m\n1628184886000000000,1,2\n")
    assert CsvReader().recognises(tmp_path / "drive")
    error = refusal(tmp_path / "drive")
    assert error.remedy is not None and "--option frame=<name>" in error.remedy
    assert "--option frame" not in str(refusal(tmp_path / "drive", {"frame": "../yard"}).remedy)
    stated = refusal(write(tmp_path / "b.csv", PLAIN), {"frame": "yard"})
    assert "no column is known as x or y" in stated.problem
    east = write(tmp_path / "c.csv", "timestamp_ns,east,north\n1628184886000000000,1,2\n")
    track = open_recording(east, options={"frame": "yard", "columns": "x=east,y=north"}).track()
    assert track.x_m is not None and track.y_m is not None
    assert (track.x_m[0], track.y_m[0], track.height_m) == (1.0, 2.0, None)


def test_a_stamp_of_another_size_is_a_bad_row(tmp_path: Path) -> None:
    lines = [f"{1628184886 + row},43.78,{-79.46 + row * 1e-4}" for row in range(200)]
    lines[0] = "0" + lines[0][10:]
    recording = open_recording(write(tmp_path / "drive.csv", "timestamp,lat,lon\n" + "\n".join(lines) + "\n"))
    track = clean_track(recording)
    assert (len(track), track.timestamp_ns[0]) == (199, 1_628_184_887_000_000_000)


@pytest.mark.parametrize(("part", "line"), [("part1", 3), ("part2", 2), ("part2", 4)])
def test_bad_row_of_a_later_file_is_named_by_its_own_line(part: str, line: int, tmp_path: Path) -> None:
    rows = {"part1": ["timestamp,lat,lon"], "part2": ["timestamp,lat,lon"]}
    for number in range(6):
        rows["part1" if number < 3 else "part2"].append(f"{1628184886 + number},43.8,-79.5")
    rows[part][line - 1] = rows[part][line - 1].replace("43.8", "north")
    for name, lines in rows.items():
        write(tmp_path / "drive" / f"{name}.csv", "\n".join(lines) + "\n")
    error = refusal(tmp_path / "drive")
    assert error.file is not None and Path(error.file).name == f"{part}.csv"
    assert error.place == f"line {line}, column lat"


def test_a_leap_second_is_read(tmp_path: Path) -> None:
    """Ten fixes in 23:59:60 are no bad rows, and cleaning keeps them all; there is no such second on other days."""
    seconds = [f"2016-12-31T23:59:{58 + number // 10}.{number % 10}Z" for number in range(30)]
    seconds += [f"2017-01-01T00:00:0{number // 10}.{number % 10}Z" for number in range(20)]
    rows = [f"{stamp},{11.5 + 1e-5 * number:.6f},48.1" for number, stamp in enumerate(seconds)]
    (tmp_path / "drive.csv").write_text("time,lon,lat\n" + "\n".join(rows) + "\n")
    track = open_recording(tmp_path / "drive.csv").track()
    assert track.bad is None and len(track) == 50 and (np.diff(track.timestamp_ns) > 0).all()
    _, report = clean(track, CleaningOptions())
    assert report.kept == 50
    # The same instants in a zone.
    local = [row.replace("2016-12-31T23:59:", "2017-01-01T00:59:").replace("Z,", "+01:00,") for row in rows[:30]]
    local += [row.replace("T00:00:", "T01:00:").replace("Z,", "+01:00,") for row in rows[30:]]
    (tmp_path / "local.csv").write_text("time,lon,lat\n" + "\n".join(local) + "\n")
    np.testing.assert_array_equal(open_recording(tmp_path / "local.csv").track().timestamp_ns, track.timestamp_ns)
    (tmp_path / "other.csv").write_text("time,lon,lat\n" + "\n".join(rows).replace("2016-12-31", "2015-12-31") + "\n")
    bad = open_recording(tmp_path / "other.csv").track().bad
    assert bad is not None and bad.counts() == {"time": 10}
