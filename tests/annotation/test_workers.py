"""Annotating on workers, a traversal at a time: the layers of one process, and a worker that ends fails alone."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import mirror
from mirror.annotation.registry import AnnotatorChoice
from mirror.annotation.run import annotate
from mirror.cli.main import main
from mirror.errors import DatasetError
from mirror.executors.choice import ExecutorChoice
from tests.annotation.known import Known
from tests.builders.folder import compact_tree

WHERE = "tests/annotation/where.py:ANNOTATOR"


def test_traversals_on_workers_have_the_layers_of_one_process(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    alone = Path(shutil.copytree(root, tmp_path / "alone"))
    annotate(mirror.open(alone), Known())
    first, second = mirror.open(root).traversals()
    words = ["annotate", str(root), "--annotator", WHERE, "--set", f"folder={tmp_path}", "--executor", "processes"]
    assert main([*words, "--workers", "2", "--set", f"crash={first}"]) == 3
    assert f"{first}: its process ended with code -11 (3 attempts)" in capsys.readouterr().out
    assert [bool(list(root.glob(f"traversals/{one}/layers/boxes/known@1"))) for one in (first, second)] == [False, True]
    assert main([*words, "--workers", "1"]) == 0
    assert compact_tree(root) == compact_tree(alone)


def test_a_worker_with_another_annotator_is_refused(root: Path, tmp_path: Path) -> None:
    dataset = mirror.open(root)
    other = Known()
    other.fingerprint = "other"
    choice = AnnotatorChoice(WHERE, {"folder": str(tmp_path)}, "cpu")
    with pytest.raises(DatasetError, match="another one on a node"):
        annotate(dataset, other, executor=ExecutorChoice("processes", 1), choice=choice)
