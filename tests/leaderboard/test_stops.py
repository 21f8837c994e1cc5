"""Ctrl-C and SIGTERM at three instants of `mirror leaderboard add`, which scores renders in several processes."""

from __future__ import annotations

from pathlib import Path

from mirror.dataset.dataset import Dataset
from mirror.evaluation.run import EvaluationOptions, evaluate
from mirror.protocols.document import load_protocol
from tests.builders.folder import tree
from tests.evaluation.submissions import SPLIT, write_renders
from tests.interruption import SIGNALS, finish, interrupt


def test_add_stops_and_continues(dataset: Dataset, root: Path, tmp_path: Path) -> None:
    protocol, submission = load_protocol("static-reconstruction-omnire"), tmp_path / "submission"
    write_renders(dataset, protocol, submission)
    assert evaluate(submission, root, protocol, SPLIT, tmp_path / "out", EvaluationOptions(workers=1)).result
    words = ["leaderboard", "add", tmp_path / "out" / "result.json", root, "--submission", submission]
    words += ["--dataset-name", "street", "--board"]
    whole_s = finish([*words, tmp_path / "whole"])
    stopped: list[Path] = []
    for share, (number, group) in zip((0.0, 0.2, 0.4), SIGNALS):
        board = tmp_path / f"stopped at {share}"
        ended = interrupt([*words, board], share * whole_s, number, group=group)
        if ended.hit:
            ended.require_stopped()
            assert not list(board.rglob("*.json"))
            stopped.append(board)
    finish([*words, stopped[-1]])
    assert tree(stopped[-1]) == tree(tmp_path / "whole")
    assert len(list((tmp_path / "whole" / "entries").iterdir())) == 1
