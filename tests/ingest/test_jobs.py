"""Drives made by jobs on workers that are killed, hang or wake up late: the bytes of an ingest in one process."""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest

import mirror
from mirror.cli.main import main
from mirror.errors import RecordingError, UsageError
from mirror.executors.choice import ExecutorChoice
from mirror.ingest.request import IngestOptions
from mirror.ingest.rois import write_rois
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from tests.builders.folder import SCENE, START_NS, compact_tree, tree, write_recording
from tests.ingest import hooks

HOUR_NS = 3_600_000_000_000
READER = f"{Path(hooks.__file__).relative_to(Path.cwd())}:HookedReader"
SERIAL = IngestOptions(reader=READER, workers=1, write=WriteOptions(transfer="copy"))
PROCESSES = replace(SERIAL, executor=ExecutorChoice("processes", 2), timeout_s=60.0)
ONE_PROCESS = replace(PROCESSES, executor=ExecutorChoice("processes", 1))
KILLS = ("recorded/front_wide/*.jpg drives/*/manifest.json", "recorded/manifest.json", "drives/*/passes.parquet")
"""Of each drive, the files before which a process at it is killed; `python -m benchmarks cluster` has them all."""


@pytest.fixture
def fleet(tmp_path: Path) -> list[Path]:
    write_rois(tmp_path / "rois.geojson", [SCENE])
    return [
        write_recording(tmp_path, f"drive_{number}", start_ns=START_NS + number * HOUR_NS, from_m=-90.0, to_m=90.0,
                        seed=number)
        for number in range(3)
    ]  # fmt: skip


@pytest.fixture
def whole(fleet: list[Path], tmp_path: Path) -> Path:
    ingest_recordings(fleet, [SCENE], tmp_path / "whole", SERIAL)
    return tmp_path / "whole"


def hook(recording: Path, name: str, text: str = "") -> Path:
    file = recording.with_name(f"{recording.name}.{name}")
    file.write_text(text)
    return file


def test_workers_killed_before_and_between_all_puts_make_the_same_bytes(
    fleet: list[Path], whole: Path, tmp_path: Path
) -> None:
    for recording, patterns in zip(fleet, KILLS):
        hook(recording, hooks.KILL, patterns)
    report = ingest_recordings(fleet, [SCENE], tmp_path / "jobs", PROCESSES)
    assert not report.failures and len(report.traversals) == 3
    assert len(list(tmp_path.glob("*.killed"))) == 4
    assert tree(tmp_path / "jobs") == tree(whole)
    again = ingest_recordings(fleet, [SCENE], tmp_path / "jobs", PROCESSES)
    assert again.unchanged == [f"drive_{number}" for number in range(3)] and not again.drives
    assert tree(tmp_path / "jobs") == tree(whole)


def test_a_crashing_drive_fails_alone_and_is_tried_again_by_an_option(
    fleet: list[Path], whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "jobs"
    words = ["ingest", "--out", str(out), "--copy", "--reader", READER, "--executor", "processes", "--workers", "2"]
    ruin = hook(fleet[1], hooks.RUIN, "SIGSEGV")
    assert main([*words, *map(str, fleet), "--rois", str(tmp_path / "rois.geojson")]) == 3
    said = capsys.readouterr()
    assert "drive_1" in said.err and "code -11 (3 attempts)" in said.err and "--retry-failed" in said.out
    assert (tmp_path / f"drive_1.{hooks.ATTEMPTS}").read_bytes() == b"xxx"
    assert mirror.open(out).drives() == ["drive_0", "drive_2"]
    (letters,) = (out / "failures").glob("*.parquet")
    (row,) = pq.read_table(letters).to_pylist()
    assert (row["recording"], row["status"], row["attempts"]) == (str(fleet[1]), "crashed", 3)
    ruin.write_text("ValueError")
    assert main([*words, "--retry-failed"]) == 3
    (row,) = pq.read_table(next((out / "failures").glob("*.parquet"))).to_pylist()
    assert (row["status"], row["error"], row["attempts"]) == ("failed", "RecordingError", 1)
    ruin.unlink()
    assert main([*words, "--retry-failed"]) == 0
    assert not (out / "failures").exists()
    assert compact_tree(out) == tree(whole)


def test_an_attempt_that_wakes_after_its_retry_changes_nothing(fleet: list[Path], whole: Path, tmp_path: Path) -> None:
    """A process that is held up before its puts goes on when another one has done all of the work."""
    out = tmp_path / "jobs"
    ingest_recordings(fleet[1:], [SCENE], out, SERIAL)
    hook(fleet[0], hooks.HOLD, "recorded/manifest.json")
    words = ["ingest", str(fleet[0]), "--out", str(out), "--copy", "--reader", READER, "--executor", "processes"]
    late = subprocess.Popen([sys.executable, "-m", "mirror", *words, "--workers", "1"], stdout=subprocess.DEVNULL)
    while not (tmp_path / "drive_0.held").exists():
        assert late.poll() is None
        time.sleep(0.01)
    ingest_recordings(fleet[:1], [SCENE], out, ONE_PROCESS)
    before = {name: sha256 for name, sha256 in tree(out).items() if not name.startswith(".staging")}
    hook(fleet[0], hooks.GO)
    assert late.wait(120) == 0
    assert tree(out) == before
    assert mirror.open(out).drives() == ["drive_0", "drive_1", "drive_2"]
    assert compact_tree(out) == tree(whole)


def test_of_recordings_that_contradict_each_other_the_first_is_ingested(fleet: list[Path], tmp_path: Path) -> None:
    other = write_recording(tmp_path / "other", "drive_0", start_ns=START_NS)
    rig = write_recording(tmp_path, "drive_7", start_ns=START_NS + 7 * HOUR_NS, cameras=("front_wide",))
    report = ingest_recordings([fleet[0], other, rig], [SCENE], tmp_path / "jobs", ONE_PROCESS)
    assert list(report.drives) == ["drive_0"]
    assert [path for path, _ in report.failures] == [other, rig]
    assert "also that of" in str(report.failures[0][1]) and "other cameras" in str(report.failures[1][1])
    with pytest.raises(RecordingError, match="also that of"):
        ingest_recordings([fleet[0], other], [SCENE], tmp_path / "fast", replace(ONE_PROCESS, fail_fast=True))
    assert not (tmp_path / "fast").exists()


def test_jobs_replace_nothing(fleet: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "jobs"
    ingest_recordings(fleet[:2], [SCENE], out, ONE_PROCESS)
    with pytest.raises(UsageError, match="--replace"):
        ingest_recordings(fleet[:2], [SCENE], out, replace(ONE_PROCESS, replace=True))
    scenes = [SCENE, SCENE.model_copy(update={"scene_id": "wider", "radius_m": 80.0})]
    report = ingest_recordings(fleet, scenes, out, ONE_PROCESS)
    assert list(report.drives) == ["drive_2"]
    assert all("without --executor" in str(error) for _, error in report.failures) and len(report.failures) == 2
    before = tree(out)
    judged = ingest_recordings(fleet, scenes, out, replace(ONE_PROCESS, dry_run=True))
    assert len(judged.drives) == 3 and tree(out) == before
