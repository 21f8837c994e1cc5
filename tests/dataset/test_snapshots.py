"""Snapshots of the index: readers see one, writers add to them without a lock, and old datasets get them."""

from __future__ import annotations

import json
import pickle
import shutil
import threading
from pathlib import Path

import fsspec
import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.index import append_drives, build_index
from mirror.dataset.migration import migrate
from mirror.errors import DatasetError, SchemaError
from mirror.integrity import check
from mirror.schema.version import DATASET_VERSION
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass
from tests.builders.folder import compact_tree, tree
from tests.builders.index import segment_folder, segment_names, tables_of
from tests.builders.snapshot_reader import read_while_changing, require_whole, write_drive
from tests.golden.half_done import unpack

STEP = 50 * SECOND


def grown(root: Path, drives: int) -> Builder:
    """A dataset of two scenes, whose first drive was indexed; the others are there, and in no snapshot."""
    builder = Builder(root, cameras=("front_wide",))
    builder.scene("a")
    builder.scene("b", 2.35, 48.85)
    for number in range(drives):
        passes = [Pass("ab"[number % 2], EPOCH + number * STEP, frames=2, light="night" if number else "day")]
        builder.drive(f"d{number}", passes, refused=number % 2)
        if number == 0:
            build_index(root)
    return builder


def test_what_runs_append_is_what_one_build_derives(tmp_path: Path) -> None:
    grown(tmp_path / "one", 5)
    build_index(tmp_path / "one", force=True)
    layout = grown(tmp_path / "two", 5).layout
    numbers = [append_drives(layout, drives) for drives in (["d3"], ["d1", "d4"], ["d2"], ["d2"])]
    assert numbers[:3] == [2, 3, 4] and len(segment_names(tmp_path / "two")) == 4
    assert tables_of(tmp_path / "two") == tables_of(tmp_path / "one")
    one, two = mirror.open(tmp_path / "one"), mirror.open(tmp_path / "two")
    time = (EPOCH, EPOCH + 3 * STEP)
    for filters in ({"scene": "b"}, {"light": "night", "time": time}, {"within": (2.35, 48.85, 9.0)}):
        assert two.where(**filters).table("images").to_pylist() == one.where(**filters).table("images").to_pylist()
    assert [frame.timestamp_ns for frame in two.frames()] == [frame.timestamp_ns for frame in one.frames()]
    assert two.sql("select sum(images) from scenes").column(0)[0].as_py() == two.count("images") == one.count("images")
    assert not check(tmp_path / "two", only=["IDX", "FIL"]).findings
    assert compact_tree(tmp_path / "two") == tree(tmp_path / "one")
    assert mirror.open(tmp_path / "two").index_sha256 == one.index_sha256


def test_an_earlier_snapshot_is_opened_until_its_files_are_replaced(tmp_path: Path) -> None:
    builder = grown(tmp_path, 3)
    append_drives(builder.layout, ["d1"])
    append_drives(builder.layout, ["d2"])
    assert [mirror.open(tmp_path, at=number).drives() for number in (1, 2, 3)] == [
        ["d0"], ["d0", "d1"], ["d0", "d1", "d2"],
    ]  # fmt: skip
    early = mirror.open(tmp_path, at=2)
    assert early.snapshot == 2 and pickle.loads(pickle.dumps(early)).drives() == ["d0", "d1"]
    build_index(tmp_path, compact=True)
    assert mirror.open(tmp_path, at=1).count("images") == 2
    for number in (0, 5):
        with pytest.raises(DatasetError, match=f"no snapshot {number}; expected a number from 1 to 4"):
            mirror.open(tmp_path, at=number)
    builder.drive("d1", [Pass("b", EPOCH + STEP, frames=3)])
    build_index(tmp_path)
    assert mirror.open(tmp_path, at=5).where(drive="d1").count("images") == 3
    with pytest.raises(DatasetError, match=r"snapshot 4 have been replaced or removed since; .* from 5 to 5"):
        mirror.open(tmp_path, at=4)


def test_runs_that_end_together_all_get_their_snapshot(tmp_path: Path) -> None:
    layout = grown(tmp_path, 9).layout
    start, seen, stop = threading.Barrier(8), [], threading.Event()
    put: list[int] = []

    def append(number: int) -> None:
        start.wait()
        put.append(append_drives(layout, [f"d{number}"]))

    def read() -> None:
        while not stop.is_set():
            dataset = mirror.open(tmp_path)
            seen.append((dataset.snapshot, len(dataset.drives()), dataset.count("images")))

    reader = threading.Thread(target=read)
    reader.start()
    writers = [threading.Thread(target=append, args=(number,)) for number in range(1, 9)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join(120)
    stop.set()
    reader.join(60)
    assert sorted(put) == list(range(2, 10))
    assert len(list(layout.snapshots.iterdir())) == 9
    # A reader sees each snapshot whole: a drive more, with its images.
    assert seen and all(drives == snapshot and images == 2 * drives for snapshot, drives, images in seen)
    assert mirror.open(tmp_path).drives() == [f"d{number}" for number in range(9)]


def test_another_process_sees_whole_snapshots_during_rounds_of_append_and_compaction(tmp_path: Path) -> None:
    openings, snapshots = read_while_changing(tmp_path / "changing", 8)
    assert openings >= snapshots >= 2
    # What it requires is not met by a dataset that lost a drive.
    builder = Builder(tmp_path / "lost", cameras=("front_wide",))
    builder.scene("a")
    for number in (0, 2):
        write_drive(builder, number)
    build_index(builder.root)
    with pytest.raises(DatasetError, match="snapshot 1: drives"):
        require_whole(mirror.open(builder.root))


def test_opening_asks_three_times_however_many_drives_there_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    layout = grown(tmp_path, 6).layout
    for number in range(1, 6):
        append_drives(layout, [f"d{number}"])
    memory = fsspec.filesystem("memory")
    for path in tmp_path.rglob("*"):
        if path.is_file():
            memory.pipe(f"/snapshots/{path.relative_to(tmp_path)}", path.read_bytes())
    asked: list[str] = []
    for name in ("cat_file", "ls", "open", "cat", "info"):
        plain = getattr(type(memory), name)

        def counted(self: object, path: object, *words: object, plain=plain, name=name, **more: object) -> object:
            asked.append(f"{name} {path}")
            return plain(self, path, *words, **more)

        monkeypatch.setattr(type(memory), name, counted)
    dataset = mirror.open("memory://snapshots")
    names = {line.rpartition("/")[2] for line in asked if not line.startswith("open")}
    assert names == {"dataset.json", "snapshots", "00000006.json"} and len(asked) <= 6
    assert len(dataset.drives()) == 6


def test_a_damaged_snapshot_is_refused_and_the_index_mends_it(tmp_path: Path) -> None:
    layout = grown(tmp_path, 2).layout
    append_drives(layout, ["d1"])
    (layout.snapshots / "00000002.json").write_text("{")
    with pytest.raises(SchemaError, match=r"00000002\.json"):
        mirror.open(tmp_path)
    assert [rule.rule_id for rule, _ in check(tmp_path, only=["IDX"]).findings] == ["IDX001"]
    assert main(["index", str(tmp_path)]) == 0
    dataset = mirror.open(tmp_path)
    assert (dataset.snapshot, dataset.drives()) == (3, ["d0", "d1"])
    assert not check(tmp_path, only=["IDX"]).findings


def but_index(files: dict[str, str]) -> dict[str, str]:
    """The files that a migration leaves as they are."""
    changed = ("index", "dataset.json", ".superseded")
    return {name: sha256 for name, sha256 in files.items() if name.partition("/")[0] not in changed}


def test_a_dataset_of_an_earlier_version_is_migrated_and_keeps_its_bytes(tmp_path: Path) -> None:
    root = unpack(tmp_path)
    kept = but_index(tree(root))
    tables = {name.removeprefix("index/"): digest for name, digest in tree(root).items() if name.startswith("index/")}
    for words in (["info"], ["index"], ["check"], ["ingest", str(tmp_path), "--out"]):
        assert main([*words, str(root)]) != 0
    with pytest.raises(SchemaError, match=r"version 1\.1\.0.*mirror dataset migrate .*dataset"):
        mirror.open(root)
    assert main(["dataset", "migrate", str(root)]) == 0
    after = tree(root)
    assert but_index(after) == kept
    segment = f"index/{segment_folder(root).name}/"
    moved = {name.removeprefix(segment): digest for name, digest in after.items() if name.startswith(segment)}
    assert moved.pop("sources.json")
    # The tables, and the manifest by whose hash others know the dataset.
    assert moved == tables
    assert mirror.open(root).index_sha256 == tables["manifest.json"]
    assert {path.name for path in (root / "index").iterdir()} == {"snapshots", segment_folder(root).name}
    before = json.loads((unpack(tmp_path / "again") / "dataset.json").read_text())
    assert json.loads((root / "dataset.json").read_text()) == {**before, "schema_version": DATASET_VERSION}
    # Again it does nothing.
    assert migrate(root).index is None and tree(root) == after


def test_a_migration_that_was_stopped_goes_on(tmp_path: Path) -> None:
    root = unpack(tmp_path)
    whole = Path(shutil.copytree(root, tmp_path / "whole"))
    document = json.loads((root / "dataset.json").read_text())
    # As it is left by a kill after the version was written.
    (root / "dataset.json").write_text(json.dumps({**document, "schema_version": DATASET_VERSION}, indent=1) + "\n")
    with pytest.raises(DatasetError, match="mirror index"):
        mirror.open(root)
    assert migrate(root).index is not None
    migrate(whole)
    assert {k: v for k, v in tree(root).items() if k != "dataset.json"} == {
        k: v for k, v in tree(whole).items() if k != "dataset.json"
    }
