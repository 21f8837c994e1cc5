"""The licence that recordings state: taken over into a new dataset, or named where the dataset states another."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mirror.cli.main import main
from mirror.errors import ExitCode
from mirror.integrity import check
from tests.builders.folder import LAT, LON, START_NS, write_recording

HOUR_NS = 3_600_000_000_000
ROI = ["--roi", f"{LON},{LAT},60"]


def stated(root: Path, name: str, licence: str | None, hour: int) -> str:
    drive = write_recording(root, name, from_m=-50.0, to_m=50.0, start_ns=START_NS + hour * HOUR_NS, seed=hour)
    document = json.loads((drive / "recording.json").read_text())
    document["licence"] = licence
    (drive / "recording.json").write_text(json.dumps(document))
    return str(drive)


def licence_of(dataset: Path) -> object:
    return json.loads((dataset / "dataset.json").read_text())["licence"]


def test_the_one_licence_of_all_recordings_is_the_datasets(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drives = [stated(tmp_path, f"drive_{hour}", "CC BY 4.0", hour) for hour in (0, 1)]
    out = tmp_path / "d"
    assert main(["ingest", *drives, *ROI, "--out", str(out)]) == ExitCode.DONE
    assert "licence: CC BY 4.0" in capsys.readouterr().out
    assert licence_of(out) == "CC BY 4.0"
    assert not check(out, only=["DS013"]).findings
    # A recording of another licence comes later: the dataset keeps its own, and the difference is said.
    assert main(["ingest", stated(tmp_path, "other", "CC0-1.0", 2), "--out", str(out)]) == ExitCode.DONE
    assert "recordings state CC0-1.0, the dataset CC BY 4.0" in capsys.readouterr().out
    assert licence_of(out) == "CC BY 4.0"


@pytest.mark.parametrize("second", [None, "CC0-1.0"])
def test_several_licences_are_named(second: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drives = [stated(tmp_path, "one", "CC BY 4.0", 0), stated(tmp_path, "two", second, 1)]
    out = tmp_path / "d"
    assert main(["ingest", *drives, *ROI, "--out", str(out)]) == ExitCode.DONE
    expected = "CC BY 4.0" if second is None else f"{second}, CC BY 4.0" if second < "CC BY" else f"CC BY 4.0, {second}"
    printed = capsys.readouterr().out
    assert f"recordings state {expected}, the dataset none" in printed and "--licence" in printed
    assert licence_of(out) is None


def test_a_given_licence_stays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "d"
    words = ["ingest", stated(tmp_path, "one", "CC BY 4.0", 0), *ROI, "--out", str(out), "--licence", "CC BY-NC 4.0"]
    assert main(words) == ExitCode.DONE
    assert licence_of(out) == "CC BY-NC 4.0"
    assert "recordings state CC BY 4.0, the dataset CC BY-NC 4.0" in capsys.readouterr().out
