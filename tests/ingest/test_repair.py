"""Damaged datasets are mended by the command that made them; what was sealed is never lost."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.generation import supersede
from mirror.dataset.layout import Layout
from mirror.errors import MirrorError, UsageError
from mirror.ingest import drive as drive_module
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.recordings.folder_document import read_document
from mirror.recordings.protocol import ENTRY_POINT_GROUP, Track
from mirror.recordings.readers.folder import FolderRecording
from mirror.schema.files import unwritable_error
from tests.builders.folder import SCENE, START_NS, compact_tree, tree, write_recording
from tests.wheels import install_plugins

WEST = SCENE.model_copy(update={"scene_id": "west", "longitude_deg": SCENE.longitude_deg - 0.0008})


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    fleet, later = tmp_path_factory.mktemp("repair") / "fleet", START_NS + 3_600_000_000_000
    return [write_recording(fleet, "a"), write_recording(fleet, "b", start_ns=later, seed=1)]


@pytest.fixture(scope="module")
def ingested(drives: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("ingested") / "d"
    ingest_recordings(drives, [SCENE], out)
    return out


@pytest.fixture
def out(ingested: Path, tmp_path: Path) -> Path:
    """A copy of the dataset, which tests damage."""
    return Path(shutil.copytree(ingested, tmp_path / "d"))


class FaultyRecording(FolderRecording):
    """A recording of another package's reader, which has a fault."""

    def track(self) -> Track:
        raise KeyError("speed")


class FaultyReader:
    """A reader of another package."""

    name = "faulty"
    expects = "a folder with faulty.json"

    def recognises(self, path: Path) -> bool:
        return (path / "faulty.json").is_file()

    def open(self, path: Path, options: Mapping[str, str]) -> FaultyRecording:
        return FaultyRecording(path, read_document(path / "faulty.json"))


def traversal(out: Path, drive: str) -> Path:
    return next((out / "traversals").glob(f"street.{drive}.*"))


DAMAGE = {
    "traversal lost": lambda out: shutil.rmtree(traversal(out, "a")),
    "traversal without manifest": lambda out: (traversal(out, "a") / "recorded/manifest.json").unlink(),
    "traversal with an empty manifest": lambda out: (traversal(out, "a") / "recorded/manifest.json").write_text(""),
    "truncated table": lambda out: (traversal(out, "a") / "recorded/ego_poses.parquet").write_bytes(b"PAR1"),
    "drive with an empty manifest": lambda out: (out / "drives/a/manifest.json").write_text(""),
    "truncated ledger": lambda out: (out / "drives/a/passes.parquet").write_bytes(b"PAR1"),
    "drive document lost": lambda out: (out / "drives/a/drive.json").unlink(),
}


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("replace", [False, True])
def test_the_same_command_mends_it(damage: str, replace: bool, drives: list[Path], out: Path) -> None:
    before = tree(out)
    DAMAGE[damage](out)
    report = ingest_recordings(drives, [SCENE], out, IngestOptions(replace=replace, verify=not replace))
    assert not report.failures
    assert tree(out) == before


@pytest.mark.parametrize("lost", ["drives/a", "traversals/street.a.1700000007500"])
def test_what_is_lost_as_a_whole_comes_back_without_verifying(lost: str, drives: list[Path], out: Path) -> None:
    before = tree(out)
    shutil.rmtree(out / lost)
    assert ingest_recordings(drives, [SCENE], out).unchanged == ["b"]
    assert compact_tree(out) == before


def test_a_lost_image_comes_back_with_replace(drives: list[Path], out: Path) -> None:
    before = tree(out)
    next(traversal(out, "a").rglob("*.jpg")).unlink()
    ingest_recordings(drives[:1], [SCENE], out, IngestOptions(replace=True))
    assert tree(out) == before


def test_full_disk_during_replacement_loses_no_drive(
    drives: list[Path], out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:

    def full(path: Path, data: bytes) -> None:
        raise unwritable_error(path, OSError(28, "No space left on device"))

    monkeypatch.setattr(drive_module, "write_bytes", full)
    with pytest.raises(MirrorError, match="No space left"):
        ingest_recordings(drives, [SCENE, WEST], out)
    monkeypatch.undo()
    assert Layout(out).drive_ids() == ["a", "b"]
    assert main(["index", str(out)]) == 0
    assert mirror.open(out).drives() == ["a", "b"]
    ingest_recordings(drives, [SCENE, WEST], out)
    ingest_recordings(drives, [SCENE, WEST], tmp_path / "e")
    assert compact_tree(out) == compact_tree(tmp_path / "e")


def test_a_replacement_that_was_killed_is_settled_by_the_index(out: Path) -> None:
    before = tree(out)
    one = traversal(out, "a")
    supersede(Layout(out), out / "drives/a")
    supersede(Layout(out), one)
    # The new traversal was there already, the new drive was not.
    (one / "recorded").mkdir(parents=True)
    (one / "recorded/manifest.json").write_text("{}")
    assert Layout(out).drive_ids() == ["b"]
    (out / ".rois.geojson.77.tmp").write_text("half")
    assert main(["index", str(out)]) == 0
    assert tree(out) == before


def test_a_reader_that_fails_stops_only_its_recording(
    drives: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install_plugins(monkeypatch, tmp_path / "site", ENTRY_POINT_GROUP, ("faulty", f"{__name__}:FaultyReader"))
    shutil.copytree(drives[0], tmp_path / "a")
    (tmp_path / "a" / "recording.json").rename(tmp_path / "a" / "faulty.json")
    report = ingest_recordings([tmp_path / "a", drives[1]], [SCENE], tmp_path / "d")
    assert sorted(report.drives) == ["b"]
    assert "its reader failed (KeyError: 'speed')" in str(report.failures[0][1])


def test_margins_do_not_reach_across_a_jump(tmp_path: Path) -> None:
    """The receiver jumps 3 km at the end of the pass; the margin of poses must not follow it."""
    drive = write_recording(tmp_path / "fleet", "a", to_m=58.0)
    rows = (drive / "poses.csv").read_text().splitlines()
    last = rows[-1].split(",")
    for step in range(1, 40):
        stamp = int(last[0]) + step * 100_000_000
        rows.append(f"{stamp},{float(last[1]) + 0.04:.9f},{float(last[2]) + step * 1e-5:.9f},{last[3]},{last[4]}")
    (drive / "poses.csv").write_text("\n".join(rows) + "\n")
    report = ingest_recordings([drive], [SCENE], tmp_path / "d")
    assert report.drives["a"].cleaning.restarts == 1
    poses = mirror.open(tmp_path / "d").table("ego_poses", ["tx_m"]).column("tx_m").to_numpy()
    assert abs(poses).max() < 80.0


@pytest.mark.parametrize(
    "options",
    [
        IngestOptions(trigger={"min_overlap": 90.0}),
        IngestOptions(trigger={"max_gap_s": float("nan")}),
        IngestOptions(cleaning={"max_speed_mps": 0.0}),
        IngestOptions(workers=0),
    ],
)
def test_thresholds_out_of_range_are_named(options: IngestOptions, drives: list[Path], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"^--(min-overlap|max-gap-s|max-speed-mps): |workers"):
        ingest_recordings(drives, [SCENE], tmp_path / "d", options)
    assert tree(tmp_path / "d") == {}


def test_a_dataset_is_not_written_into_a_recording(drives: list[Path]) -> None:
    before = tree(drives[0])
    with pytest.raises(UsageError, match="inside a recording"):
        ingest_recordings(drives, [SCENE], drives[0] / "dataset")
    assert tree(drives[0]) == before
