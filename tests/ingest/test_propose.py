"""Which places `rois propose` puts first, what it says where it finds none, and folders of recordings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mirror.cli.main import main
from mirror.ingest.propose import propose_rois
from mirror.ingest.rois import read_rois, write_rois
from tests.builders.folder import LAT, LON, SCENE, START_NS, locate_on_street, tree, write_recording

HOUR_NS = 3_600_000_000_000


def write_csv(path: Path, seconds: np.ndarray, offset_m: np.ndarray, *, north_deg: float = 0.0) -> Path:
    """A drive along the street as a table of fixes."""
    path.parent.mkdir(exist_ok=True)
    lon, lat = locate_on_street(offset_m)
    rows = [f"{START_NS / 1e9 + t:.3f},{x:.9f},{y + north_deg:.9f}" for t, x, y in zip(seconds, lon, lat)]
    path.write_text("time,lon,lat\n" + "\n".join(rows) + "\n")
    return path


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    """Two drives past the street; one drive that stops for three minutes in another one, 5 km to the north."""
    seconds = np.arange(0.0, 60.0, 0.1)
    for number in range(2):
        write_csv(tmp_path / "fleet" / f"pass_{number}.csv", seconds + 3600 * number, 8.0 * seconds - 240.0)
    stops = [(0, -800), (50, -400), (110, -400), (130, -240), (240, -240), (260, -80), (370, -80), (400, 160)]
    times, places = np.array(stops, float).T
    seconds = np.arange(0.0, 400.0, 0.1)
    write_csv(tmp_path / "fleet" / "stops.csv", seconds, np.interp(seconds, times, places), north_deg=0.05)
    return tmp_path / "fleet"


def test_drives_count_before_the_traversals_that_stops_make_of_one(fleet: Path) -> None:
    ranked = propose_rois(sorted(fleet.glob("*.csv")), count=5).ranked
    best, other = ranked[0], next(one for one in ranked if (one.roi.latitude_deg or 0.0) > LAT + 0.02)
    assert (best.drives, best.traversals) == (2, 2)
    assert abs((best.roi.latitude_deg or 0.0) - LAT) < 0.01
    # One way through, with stops: more traversals, of one drive.
    assert other.drives == 1
    assert other.traversals > 2


def test_drives_that_share_only_their_last_street_are_proposed_there(tmp_path: Path) -> None:
    """One comes along the street, one from the north; both go on along the last 300 m."""
    seconds = np.arange(0.0, 150.0, 0.1)
    metres = 8.0 * seconds
    write_csv(tmp_path / "fleet" / "along.csv", seconds, metres)
    joined = 900.0
    drive = write_csv(tmp_path / "fleet" / "across.csv", seconds + 3600.0, np.maximum(metres, joined))
    header, *rows = drive.read_text().splitlines()
    north_deg = np.maximum(joined - metres, 0.0) / 111_000.0
    moved = [
        f"{time},{lon},{float(lat) + north:.9f}"
        for (time, lon, lat), north in zip((row.split(",") for row in rows), north_deg)
    ]
    drive.write_text("\n".join([header, *moved]) + "\n")
    best = propose_rois(sorted((tmp_path / "fleet").glob("*.csv")), count=1).ranked[0]
    assert (best.drives, best.traversals) == (2, 2)
    lon, lat = locate_on_street(np.array([joined - 60.0, 1200.0]))
    longitude_deg, latitude_deg = best.roi.longitude_deg or 0.0, best.roi.latitude_deg or 0.0
    assert min(lon) <= longitude_deg <= max(lon)
    assert min(lat) - 60.0 / 111_000.0 <= latitude_deg <= max(lat) + 60.0 / 111_000.0


def test_it_prints_drives_and_traversals(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rois", "propose", *map(str, sorted(fleet.iterdir())), "--count", "1"]) == 0
    header, row = capsys.readouterr().out.splitlines()[:2]
    assert header.split()[2:4] == ["drives", "traversals"]
    assert row.split()[3:5] == ["2", "2"]


def test_where_sparse_fixes_are_why_nothing_is_found_it_names_the_threshold(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    seconds = np.arange(0.0, 120.0, 5.0)
    for number in range(2):
        write_csv(tmp_path / "fleet" / f"{number}.csv", seconds + 3600 * number, 8.0 * seconds - 480.0)
    words = ["rois", "propose", str(tmp_path / "fleet" / "0.csv"), str(tmp_path / "fleet" / "1.csv")]
    assert main(words) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "the fixes of 2 of 2 drives are farther apart than --max-gap-s 2" in said
    assert "try --max-gap-s 5" in said
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["sparse"]["spacing_s"] == 5.0
    # A file that was asked for and is not written is no success.
    out = tmp_path / "rois.geojson"
    assert main([*words, "--out", str(out)]) == 1 and not out.exists()
    assert "is not written" in capsys.readouterr().out
    # What it says helps.
    assert main([*words, "--max-gap-s", "5", "--out", str(out)]) == 0 and out.exists()
    assert "farther apart" not in capsys.readouterr().out


def test_a_folder_of_recordings_is_all_that_lies_in_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fleet = tmp_path / "fleet"
    for number in range(2):
        write_recording(fleet, f"drive_{number}", start_ns=START_NS + number * HOUR_NS, seed=number)
    (fleet / "notes").mkdir()
    (fleet / "notes" / "a.txt").write_text("")
    (fleet / "rois.geojson").write_text("{}")
    (fleet / ".cache").mkdir()
    words = ["--roi", f"{LON},{LAT},{SCENE.radius_m},street"]
    assert main(["ingest", str(fleet), *words, "--out", str(tmp_path / "a")]) == 0
    said = capsys.readouterr()
    assert said.err.splitlines() == [
        f"skipped {fleet / name}: no reader recognises it" for name in ("notes", "rois.geojson")
    ]
    drives = [str(fleet / f"drive_{number}") for number in range(2)]
    assert main(["ingest", *drives, *words, "--out", str(tmp_path / "b")]) == 0
    assert tree(tmp_path / "a") == tree(tmp_path / "b")
    capsys.readouterr()
    # Named twice, it is still there once.
    assert main(["ingest", str(fleet), *drives, *words, "--out", str(tmp_path / "a"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert sorted(report["unchanged"]) == ["drive_0", "drive_1"]
    assert report["passed_over"] == [str(fleet / "notes"), str(fleet / "rois.geojson")]


def test_failures_are_printed_once_and_to_standard_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_recording(tmp_path / "fleet", "good")
    bad = write_recording(tmp_path / "fleet", "bad", start_ns=START_NS + HOUR_NS)
    (bad / "poses.csv").unlink()
    roi = ["--roi", f"{LON},{LAT},60,street", "--out", str(tmp_path / "d")]
    for words in (["ingest", str(tmp_path / "fleet"), *roi], ["rois", "propose", str(tmp_path / "fleet")]):
        assert main(words) == 3
        said = capsys.readouterr()
        assert str(bad) not in said.out
        assert said.err.count("failed ") == 1
        assert said.err.count(str(bad)) == 1


def test_proposals_are_not_written_into_what_is_something_else(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive = write_recording(fleet.parent / "recordings", "a")
    before = tree(drive)
    assert main(["rois", "propose", str(fleet), "--out", str(drive / "rois.geojson")]) == 2
    assert "which is a recording" in capsys.readouterr().err
    assert tree(drive) == before
    words = ["rois", "propose", str(fleet / "pass_0.csv"), "--min-traversals", "1", "--out"]
    own = fleet.parent / "own.geojson"
    write_rois(own, [SCENE])
    own_bytes = own.read_bytes()
    assert main([*words, str(own)]) == 2
    assert "`mirror rois propose` did not write" in capsys.readouterr().err
    assert own.read_bytes() == own_bytes
    # Earlier proposals are replaced, and read as regions.
    for count in ("1", "2"):
        assert main([*words, str(fleet.parent / "proposed.geojson"), "--count", count]) == 0
    assert read_rois(fleet.parent / "proposed.geojson")


def test_a_place_passed_again_after_more_than_a_minute_comes_before_places_passed_once(tmp_path: Path) -> None:
    """A drive ends where it was 85 s before; more cells are passed once than are judged."""
    seconds = np.arange(0.0, 3672.0, 0.5)
    metres = np.where(seconds < 3600.0, 11.0 * seconds, 11.0 * 3600.0 - 5.0 * (seconds - 3600.0))
    write_csv(tmp_path / "fleet" / "there.csv", seconds, metres)
    best = propose_rois([tmp_path / "fleet" / "there.csv"], radius_m=60.0, count=1).ranked[0]
    assert best.traversals == 2
