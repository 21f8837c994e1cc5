"""Runs that add drives at the same time, and runs that are killed before any of the names they give."""

from __future__ import annotations

import shutil
import threading
from pathlib import Path

import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.layout import Layout
from mirror.dataset.lock import writer_lock
from mirror.errors import DatasetError
from mirror.ingest.request import IngestOptions
from mirror.ingest.rois import write_rois
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from mirror.integrity import check
from tests.builders.folder import SCENE, START_NS, compact_tree, tree, write_recording
from tests.interruption import kill_command_before

HOUR_NS = 3_600_000_000_000
COPIES = IngestOptions(workers=1, write=WriteOptions(transfer="copy"))
KILLS = (
    ("added/traversals/*/recorded/*/*.jpg", 1),
    ("added/traversals/*/recorded/*/*.jpg", 7),
    ("added/traversals/*/recorded/*.parquet", 1),
    ("added/traversals/*/recorded/*.parquet", 3),
    ("added/traversals/*/recorded/manifest.json", 1),
    ("added/drives/*/drive.json", 1),
    ("added/drives/*/manifest.json", 1),
    ("added/drives/*/manifest.json", 2),
    ("added/index/*/*/*.parquet", 2),
    ("added/index/*/sources.json", 1),
    ("added/index/*/manifest.json", 1),
    ("added/index/snapshots/*.json", 1),
)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    root = tmp_path_factory.mktemp("fleet")
    write_rois(root / "rois.geojson", [SCENE])
    return [
        write_recording(root, f"drive_{number}", start_ns=START_NS + number * HOUR_NS, seed=number)
        for number in range(3)
    ]


@pytest.fixture(scope="module")
def whole(fleet: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("undisturbed") / "whole"
    ingest_recordings(fleet, [SCENE], out, COPIES)
    return out


@pytest.fixture
def one(fleet: list[Path], tmp_path: Path) -> Path:
    """A dataset of the first drive."""
    ingest_recordings(fleet[:1], [SCENE], tmp_path / "added", COPIES)
    return tmp_path / "added"


def test_a_run_killed_before_any_name_is_repeated_to_the_same_bytes(fleet: list[Path], whole: Path, one: Path) -> None:
    words = ["ingest", *map(str, fleet), "--out", str(one), "--copy", "--workers", "1"]
    for pattern, count in KILLS:
        kill_command_before(pattern, count, words)
        # Nobody sees a part of what was killed.
        assert mirror.open(one).drives() == ["drive_0"]
    assert main(words) == 0
    assert mirror.open(one).drives() == ["drive_0", "drive_1", "drive_2"]
    assert len(list(Layout(one).snapshots.glob("*.json"))) == 2
    assert not check(one, only=["IDX", "FIL"]).findings
    assert compact_tree(one) == tree(whole)


def test_drives_are_added_by_several_runs_while_another_holds_the_lock(
    fleet: list[Path], whole: Path, one: Path
) -> None:
    failed: list[object] = []

    def add(drive: Path) -> None:
        try:
            failed.extend(ingest_recordings([drive], [SCENE], one, COPIES).failures)
        except DatasetError as error:
            failed.append(error)

    runs = [threading.Thread(target=add, args=(drive,)) for drive in fleet[1:]]
    with writer_lock(Layout(one), wait=False):
        for run in runs:
            run.start()
        for run in runs:
            run.join(120)
        assert not failed
        # What replaces drives waits for its turn.
        with pytest.raises(DatasetError, match="another run"):
            ingest_recordings(fleet[:1], [SCENE], one, IngestOptions(replace=True))
    assert mirror.open(one).drives() == ["drive_0", "drive_1", "drive_2"]
    assert compact_tree(one) == tree(whole)


def test_what_another_run_committed_of_other_bytes_is_named_and_stays(fleet: list[Path], one: Path) -> None:
    """Half a drive of another run is there, of a recording that has changed since."""
    words = ["ingest", str(fleet[1]), "--out", str(one), "--copy", "--workers", "1"]
    kill_command_before("added/drives/*/manifest.json", 1, words)
    changed = Path(shutil.copytree(fleet[1], one.parent / "drive_1"))
    first, second, *_ = sorted((changed / "images" / "rear").glob("*.jpg"))[30:]
    first.write_bytes(second.read_bytes())
    shutil.rmtree(one / ".staging")
    before = tree(one)
    with pytest.raises(DatasetError, match=r"other bytes, of SHA-256 .* of SHA-256 .*--replace") as caught:
        ingest_recordings([changed], [SCENE], one, COPIES)
    assert str(one) in str(caught.value.file)
    kept = {name: sha256 for name, sha256 in tree(one).items() if not name.startswith(".staging")}
    assert kept == before
    assert main([*words[:1], str(changed), *words[2:], "--replace"]) == 0
    assert mirror.open(one).where(drive="drive_1").count("images") > 0
