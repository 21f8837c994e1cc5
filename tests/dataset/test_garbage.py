"""Removal of what nothing names: readers, the newest snapshot and what is young stay."""

from __future__ import annotations

import json
import os
import shutil
import time
from pathlib import Path

import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.garbage import collect_garbage
from mirror.dataset.index import append_drives, build_index
from mirror.dataset.lock import writer_lock
from mirror.errors import DatasetError, SchemaError
from mirror.integrity import check
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass
from tests.builders.folder import tree
from tests.builders.index import segment_names

DAY_S = 86400


@pytest.fixture
def builder(tmp_path: Path) -> Builder:
    """A dataset of four drives and snapshots, the last of which is compact, and a traversal that no drive names."""
    builder = Builder(tmp_path / "d", cameras=("front_wide",))
    builder.scene("a")
    for number in range(4):
        builder.drive(f"d{number}", [Pass("a", EPOCH + number * 50 * SECOND, frames=2)])
        if not number:
            build_index(builder.root)
    append_drives(builder.layout, ["d1", "d2"])
    append_drives(builder.layout, ["d3"])
    build_index(builder.root, compact=True)
    builder.drive("gone", [Pass("a", EPOCH + 500 * SECOND, frames=2)])
    shutil.rmtree(builder.layout.drive("gone"))
    return builder


def age(root: Path, days: float) -> None:
    """Let all files and folders look as old."""
    then = time.time() - days * DAY_S
    for path in (root, *root.rglob("*")):
        os.utime(path, (then, then))


def test_what_is_old_and_unnamed_goes_and_the_newest_snapshot_reads_as_before(builder: Builder) -> None:
    root = builder.root
    before, rows = tree(root), mirror.open(root).table("images").to_pylist()
    young = collect_garbage(root)
    assert (young.snapshots, young.segments, young.traversals, young.bytes) == ((), (), (), 0)
    age(root, 8)
    planned = collect_garbage(root, dry_run=True)
    assert planned.snapshots == (1, 2, 3) and len(planned.segments) == 3
    assert planned.traversals == ("a.gone.1700000500000",) and planned.bytes > 10_000
    assert mirror.open(root, at=1).drives() == ["d0"]
    assert collect_garbage(root) == planned
    assert [path.name for path in builder.layout.snapshots.iterdir()] == ["00000004.json"]
    assert sorted(path.name for path in builder.layout.index.iterdir()) == sorted([*segment_names(root), "snapshots"])
    assert mirror.open(root).table("images").to_pylist() == rows
    with pytest.raises(DatasetError, match="no snapshot 2; expected a number from 4 to 4"):
        mirror.open(root, at=2)
    # Of what the newest snapshot names nothing is lost.
    assert tree(root) == {name: sha256 for name, sha256 in before.items() if "a.gone." not in name}
    assert not check(root, only=["IDX", "FIL", "DS"]).counts()["error"]
    append_drives(builder.layout, builder_drive(builder))
    assert mirror.open(root).snapshot == 5 and "new" in mirror.open(root).drives()


def test_images_of_a_drive_whose_manifest_is_lost_stay(builder: Builder) -> None:
    (builder.layout.drive("d1") / "manifest.json").unlink()
    age(builder.root, 8)
    assert collect_garbage(builder.root).traversals == ("a.gone.1700000500000",)


def builder_drive(builder: Builder) -> list[str]:
    """Write one more drive."""
    builder.drive("new", [Pass("a", EPOCH + 900 * SECOND, frames=2)])
    return ["new"]


def test_what_a_reader_has_open_stays(builder: Builder) -> None:
    view = mirror.open(builder.root, at=2)
    age(builder.root, 8)
    assert collect_garbage(builder.root).snapshots == (1, 3)
    assert view.count("images") == len(view.table("images")) == 6
    del view
    assert collect_garbage(builder.root).snapshots == (2,)


def test_only_what_is_older_than_asked_goes(builder: Builder, capsys: pytest.CaptureFixture[str]) -> None:
    age(builder.root, 3)
    assert main(["dataset", "gc", str(builder.root), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["snapshots"] == []
    assert main(["dataset", "gc", str(builder.root), "--older-than-days", "2"]) == 0
    assert "3 snapshots, 3 segments, 1 traversal," in capsys.readouterr().out
    assert main(["dataset", "gc", str(builder.root), "--older-than-days", "-1"]) == 2


def test_nothing_is_removed_while_another_run_writes_or_where_a_document_is_broken(builder: Builder) -> None:
    age(builder.root, 8)
    before = tree(builder.root)
    with writer_lock(builder.layout, wait=False), pytest.raises(DatasetError, match="another run is writing"):
        collect_garbage(builder.root)
    (builder.layout.drive("d1") / "manifest.json").write_text("{")
    with pytest.raises(SchemaError, match=r"manifest\.json"):
        collect_garbage(builder.root)
    assert set(tree(builder.root)) == set(before)
