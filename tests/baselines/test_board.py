"""A baseline on a leaderboard: rendered, scored, added with images, and shown."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.dataset import Dataset
from mirror.evaluation.run import EvaluationOptions, evaluate
from mirror.evaluation.submission.writing import write_submission
from mirror.protocols.document import load_protocol
from mirror.protocols.views import plan_views
from mirror_baselines import mean_color, nearest_frame
from mirror_leaderboard.add import add_result
from mirror_leaderboard.entry import IMAGE_FOLDER, Measured, load_entries
from mirror_leaderboard.refused import RefusedError
from mirror_leaderboard.rescore import Sources
from mirror_leaderboard.site.page import build


def test_baselines_appear_on_a_leaderboard(dataset: Dataset, tmp_path: Path) -> None:
    protocol = load_protocol("static-reconstruction")
    plan = plan_views(dataset, protocol, "novel")
    truth, board = Path(dataset.root), tmp_path / "board"
    submissions = {method.METHOD.name: tmp_path / method.METHOD.name for method in (nearest_frame, mean_color)}
    for method in (nearest_frame, mean_color):
        name = method.METHOD.name
        write_submission(dataset, plan, method.render, method.METHOD, method.APPEARANCE, submissions[name])
        evaluate(submissions[name], truth, protocol, "novel", tmp_path / f"{name}-result", EvaluationOptions(workers=1))
        result = tmp_path / f"{name}-result" / "result.json"
        other = next(folder for key, folder in submissions.items() if key != name)
        if other.exists():
            with pytest.raises(RefusedError, match="submission_hash"):
                add_result(result, board, "a street", sources=Sources(str(truth), other, workers=1))
        add_result(result, board, "a street", sources=Sources(str(truth), submissions[name], workers=1))
    entries = [entry for entry in load_entries(board / "entries") if isinstance(entry, Measured)]
    assert {entry.method for entry in entries} == set(submissions)
    # All methods show the same views of the same truth.
    (truths,) = {tuple(pair.truth for pair in entry.pairs) for entry in entries}
    assert len(truths) == 3
    page = build([board], tmp_path / "site", unsigned=True)
    for file in truths:
        pixels = cv2.imread(str(page.parent / IMAGE_FOLDER / file))
        assert np.abs(pixels.mean(axis=(0, 1)) - 120).max() < 4
