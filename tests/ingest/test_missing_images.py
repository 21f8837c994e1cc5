"""Recordings with image files that are missing: refused by name, or read without them on request."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import mirror
from mirror.cli.main import main
from mirror.errors import ExitCode
from mirror.ingest.rois import write_rois
from mirror.integrity import Severity, check
from mirror.recordings.protocol import FileStream
from mirror.recordings.registry import open_recording
from mirror.schema.documents import Roi
from tests.builders.folder import SCENE, write_recording
from tests.recordings.formats.every import WRITERS

pytest.importorskip("pycolmap", reason="the peer that writes the models is in the extra calibration")


def _folder(root: Path) -> Path:
    """A `folder` recording whose images are named by tables of exposures."""
    drive = write_recording(root, "there", from_m=-50.0, to_m=50.0)
    for camera in ("front_wide", "rear"):
        names = sorted(path.name for path in (drive / "images" / camera).iterdir())
        rows = "".join(f"{name},{name[:-4]},{name[:-4]}\n" for name in names)
        (drive / "images" / f"{camera}.csv").write_text("file,exposure_start_ns,exposure_end_ns\n" + rows)
    return drive


CASES = {"folder": _folder, **{name: WRITERS[name] for name in ("nuscenes", "nuplan", "colmap", "dgp")}}


@pytest.mark.parametrize("reader", CASES)
def test_a_drive_with_missing_images_has_a_way_on(
    reader: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = CASES[reader](tmp_path / "recording")
    recording = open_recording(path, reader)
    track, streams = recording.track(), recording.images()
    files = [str(file) for stream in streams.values() if isinstance(stream, FileStream) for file in stream.paths]
    lost = files[1:-1:7]
    for file in lost:
        Path(file).unlink()
    if track.longitude_deg is not None and track.latitude_deg is not None:
        lon, lat = sorted(track.longitude_deg)[len(track) // 2], sorted(track.latitude_deg)[len(track) // 2]
        scene = Roi(scene_id="here", longitude_deg=float(lon), latitude_deg=float(lat), radius_m=300.0)
    else:
        scene = Roi(scene_id="here", frame=recording.info.frame, x_m=0.0, y_m=0.0, radius_m=300.0)
    write_rois(tmp_path / "rois.geojson", [scene])
    words = ["ingest", str(path), "--reader", reader, "--rois", str(tmp_path / "rois.geojson")]
    words += ["--out", str(tmp_path / "d")]
    assert main([*words, "--json"]) == ExitCode.COULD_NOT_RUN
    (failure,) = json.loads(capsys.readouterr().out)["failures"]
    assert f"{len(lost)} of {len(files)} images are missing" in failure["problem"]
    option = failure["remedy"].partition("--max-missing-images ")[2].split()[0]
    less = ["--max-missing-images", str(float(option) / 2)]
    assert main([*words, *less, "--json"]) == ExitCode.COULD_NOT_RUN
    (failure,) = json.loads(capsys.readouterr().out)["failures"]
    assert f"--max-missing-images {option}" in failure["remedy"]
    assert main([*words, "--max-missing-images", option]) == ExitCode.DONE
    assert f"{len(lost)} of {len(files)} images are missing: the drive is read without them" in capsys.readouterr().out
    dataset = mirror.open(tmp_path / "d")
    assert dataset.count("images") == len(files) - len(lost)
    errors = {rule.rule_id for rule, _ in check(tmp_path / "d").findings if rule.severity is Severity.ERROR}
    assert not errors
    # The same command finds nothing to do.
    assert main([*words, "--max-missing-images", option, "--json"]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["drives"] == {}


def test_a_share_is_between_0_and_1(tmp_path: Path) -> None:
    words = ["ingest", str(tmp_path), "--out", str(tmp_path / "d"), "--max-missing-images", "15"]
    assert main(words) == ExitCode.COULD_NOT_RUN


def test_a_complete_recording_is_the_same_with_the_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive = write_recording(tmp_path, "there", from_m=-50.0, to_m=50.0)
    roi = f"{SCENE.longitude_deg},{SCENE.latitude_deg},60"
    words = ["ingest", str(drive), "--roi", roi, "--out", str(tmp_path / "d"), "--max-missing-images", "0.5"]
    assert main(words) == ExitCode.DONE
    assert "missing: the drive" not in capsys.readouterr().out
