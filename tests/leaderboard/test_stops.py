"""Ctrl-C and SIGTERM at random instants of `mirror leaderboard add`, which scores renders in several processes."""

from __future__ import annotations

from pathlib import Path

from mirror.dataset.dataset import Dataset
from mirror.evaluation.run import EvaluationOptions, evaluate
from mirror.protocols.document import load_protocol
from tests.builders.folder import tree
from tests.evaluation.submissions import SPLIT, write_renders
from tests.interruptions import MIRROR, SIGNALS, finish, stop_thrice


def test_add_stops_and_continues(dataset: Dataset, root: Path, tmp_path: Path) -> None:
    protocol, submission = load_protocol("static-reconstruction-omnire"), tmp_path / "submission"
    write_renders(dataset, protocol, submission)
    assert evaluate(submission, root, protocol, SPLIT, tmp_path / "out", EvaluationOptions(workers=1)).result
    words = [*MIRROR, "leaderboard", "add", tmp_path / "out" / "result.json", root, "--submission", submission]
    words += ["--dataset-name", "street", "--board"]
    whole_s = finish([*words, tmp_path / "whole"])
    hits = stop_thrice([*words, tmp_path / "stopped"], 0.5 * whole_s, seed=8)
    # A run that was complete before its signal, because the first one was slow, has written its entry.
    assert hits < len(SIGNALS) or not list((tmp_path / "stopped").rglob("*.json"))
    finish([*words, tmp_path / "stopped"])
    assert tree(tmp_path / "stopped") == tree(tmp_path / "whole")
    assert len(list((tmp_path / "whole" / "entries").iterdir())) == 1
