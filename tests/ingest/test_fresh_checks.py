"""A dataset that ingest has just written passes `mirror check`, whatever the reader and the storage of its images."""

from __future__ import annotations

import json
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest

import mirror
from mirror.dataset.layout import Layout
from mirror.errors import RecordingError
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from mirror.integrity import Cost, Severity, check
from mirror.recordings.registry import load_readers, open_recording
from mirror.schema.documents import Roi
from mirror.schema.files import encode_table, read_table, write_bytes
from mirror.schema.tables import IMAGES
from tests.builders.folder import SCENE, write_recording
from tests.recordings.formats.every import WRITERS, film

pytest.importorskip("pycolmap", reason="the peer that writes the models is in the extra calibration")
pytest.importorskip("ncore", reason="needs the extra ncore")

STORAGES = get_args(get_type_hints(WriteOptions)["videos"])
# Facts of the fixtures: a video that ends before its drive, a box beside the road that no camera sees, a mounting
# without covariance.
EXPECTED = {"TIM006", "BOX003", "CAM014"}
# The tables of this fixture name lidar sweeps, of which it writes no files.
EXPECTED_OF = {"nuscenes": {"LID001"}}


def test_every_reader_has_a_fixture() -> None:
    assert set(load_readers()) == set(WRITERS)


@pytest.mark.parametrize("reader", WRITERS)
def test_a_fresh_dataset_passes_its_own_check(reader: str, tmp_path: Path) -> None:
    path = WRITERS[reader](tmp_path / "recording")
    recording = open_recording(path, reader)
    track, info = recording.track(), recording.info
    if track.longitude_deg is not None and track.latitude_deg is not None:
        scene = Roi(
            scene_id="here",
            longitude_deg=float(np.median(track.longitude_deg)),
            latitude_deg=float(np.median(track.latitude_deg)),
            radius_m=200.0,
        )
    else:
        assert track.x_m is not None and track.y_m is not None
        scene = Roi(
            scene_id="here",
            frame=info.frame,
            x_m=float(np.median(track.x_m)),
            y_m=float(np.median(track.y_m)),
            radius_m=200.0,
        )
    for storage in sorted(STORAGES, key=lambda storage: storage != "video"):
        options = IngestOptions(reader=reader, workers=1, write=WriteOptions(videos=storage))
        report = ingest_recordings([path], [scene], tmp_path / storage, options)
        assert not report.failures and len(report.traversals) == 1
        assert report.traversals[0].images > 0 or reader in ("csv", "gpx", "nmea", "video_gps")
        findings = [
            (rule.rule_id, finding)
            for rule, finding in check(tmp_path / storage, cost=Cost.IMAGES).findings
            if rule.severity is not Severity.INFO and rule.rule_id not in EXPECTED | EXPECTED_OF.get(reader, set())
        ]
        assert not findings
        images = mirror.open(tmp_path / storage).table("images", ["video_pts"]).column(0)
        if storage == "video" and images.null_count == len(images):
            # There is no video that could be stored otherwise.
            break


def _fleet_drive(root: Path, **camera: object) -> Path:
    drive = write_recording(root, "there", from_m=-50.0, to_m=50.0)
    document = json.loads((drive / "recording.json").read_text())
    document["cameras"]["rear"] = camera
    (drive / "recording.json").write_text(json.dumps(document))
    return drive


def _errors(root: Path) -> set[str]:
    return {rule.rule_id for rule, _ in check(root).findings if rule.severity is Severity.ERROR}


def test_a_clock_without_a_date_is_an_error_where_nothing_declares_it(tmp_path: Path) -> None:
    drive = write_recording(tmp_path, "there", from_m=-50.0, to_m=50.0, start_ns=1_000_000_000)
    ingest_recordings([drive], [SCENE], tmp_path / "d")
    assert "TIM007" in _errors(tmp_path / "d")


def test_a_camera_without_a_calibration_is_an_error_where_nothing_declares_it(tmp_path: Path) -> None:
    for name, camera in (("silent", {}), ("declared", {"calibrated": False})):
        drive = _fleet_drive(tmp_path / name, **camera)
        file = drive / "calibrations" / "factory.json"
        file.write_text(json.dumps([row for row in json.loads(file.read_text()) if row["camera"] != "rear"]))
        assert not ingest_recordings([drive], [SCENE], tmp_path / name / "d").failures
    assert "CAM001" in _errors(tmp_path / "silent" / "d")
    assert not _errors(tmp_path / "declared" / "d")


def test_a_declared_lack_of_a_calibration_contradicts_one(tmp_path: Path) -> None:
    drive = _fleet_drive(tmp_path, calibrated=False)
    ((_, error),) = ingest_recordings([drive], [SCENE], tmp_path / "d").failures
    assert isinstance(error, RecordingError) and error.file == str(drive / "calibrations" / "factory.json")


def test_a_frozen_video_is_still_found(tmp_path: Path) -> None:
    """Two rows of one frame are a frozen camera; two frames of one video are none."""
    drive = write_recording(tmp_path, "there", from_m=-50.0, to_m=50.0)
    film(drive, "rear")
    options = IngestOptions(write=WriteOptions(videos="video"))
    report = ingest_recordings([drive], [SCENE], tmp_path / "d", options)
    file = Layout(tmp_path / "d").recorded(report.traversals[0].traversal_id) / "images.parquet"
    assert not [rule for rule, _ in check(tmp_path / "d", only=["IMG008"]).findings]
    rows = read_table(file, IMAGES)
    pts = rows.column("video_pts").to_pylist()
    (row, *_) = (number for number in range(1, len(pts)) if pts[number] is not None and pts[number - 1] is not None)
    pts[row] = pts[row - 1]
    column = rows.schema.get_field_index("video_pts")
    write_bytes(file, encode_table(rows.set_column(column, rows.schema.field(column), [pts]), IMAGES))
    assert [finding.count for _, finding in check(tmp_path / "d", only=["IMG008"]).findings] == [1]


@pytest.mark.parametrize("reader", ["folder", "csv"])
def test_a_declared_clock_without_a_date_passes(reader: str, tmp_path: Path) -> None:
    drive = write_recording(tmp_path, "there", from_m=-50.0, to_m=50.0, start_ns=1_000_000_000)
    options = IngestOptions(reader=reader, workers=1)
    if reader == "folder":
        document = json.loads((drive / "recording.json").read_text())
        (drive / "recording.json").write_text(json.dumps({**document, "time_base": "clock_ns"}))
    else:
        rows = [line.split(",")[:3] for line in (drive / "poses.csv").read_text().splitlines()[1:]]
        drive = tmp_path / "drive.csv"
        drive.write_text("time,lon,lat\n" + "".join(f"{int(row[0]) / 1e9:.3f},{row[1]},{row[2]}\n" for row in rows))
        ((_, error),) = ingest_recordings([drive], [SCENE], tmp_path / "no").failures
        assert "--option time_unit=clock_s" in str(error.remedy)
        options = IngestOptions(reader=reader, workers=1, reader_options={"time_unit": "clock_s"})
    report = ingest_recordings([drive], [SCENE], tmp_path / "d", options)
    assert not report.failures and len(report.traversals) == 1
    assert not _errors(tmp_path / "d")
