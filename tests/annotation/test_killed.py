"""`mirror annotate` and its verbs, killed or interrupted after a layer."""

from __future__ import annotations

from pathlib import Path

import pytest

import mirror
from mirror.annotation import annotate
from mirror.cli.main import main
from tests.annotation.known import Known
from tests.killed_after_a_layer import require_resumable


def test_annotate_continues(root: Path, tmp_path: Path) -> None:
    annotate(mirror.open(root), Known())
    assert main(["annotate", "export", str(root), "--out", str(tmp_path / "results.json")]) == 0
    words = ["annotate", str(root), "--annotator", "file", "--set", f"path={tmp_path / 'results.json'}"]
    require_resumable(root, words)


@pytest.mark.parametrize("verb", ["track", "masks"])
def test_verbs_on_boxes_continue(root: Path, verb: str) -> None:
    annotate(mirror.open(root), Known())
    require_resumable(root, ["annotate", verb, str(root), "--boxes", "known@1"])
