"""Trainings that an earlier version left half done continue at their step, and end as trainings without a break."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from mirror.progress import NullProgress  # noqa: E402
from tests.golden.half_done_training import DONE, STEPS, TRAININGS, unpack  # noqa: E402


@pytest.mark.parametrize("name", TRAININGS)
def test_a_checkpoint_of_an_earlier_version_continues(name: str, tmp_path: Path) -> None:
    torch.set_num_threads(1)
    half, whole = tmp_path / "half", tmp_path / "whole"
    for root in (half, whole):
        unpack(root)
    shutil.rmtree(whole / name)
    done = rows(half / name)
    assert 0 < done[-1]["step"] <= DONE[name]
    for root in (half, whole):
        TRAININGS[name](root, NullProgress())
    # The rows of the steps that were done keep their times: none is done again.
    assert all(before.items() <= after.items() for before, after in zip(done, rows(half / name)))
    assert [row["step"] for row in rows(half / name)] == [row["step"] for row in rows(whole / name)]
    outcome, expected = (json.loads((root / name / "outcome.json").read_text()) for root in (half, whole))
    assert outcome["steps"] == expected["steps"] == STEPS[name]
    # Not the same bytes: another processor may have done the first steps.
    figure = "psnr_db" if name == "street" else "loss"
    assert outcome[figure] == pytest.approx(expected[figure], rel=0.02)


def rows(folder: Path) -> list[dict[str, float]]:
    """The curves of a run."""
    with (folder / "curves.csv").open(newline="") as file:
        return [{name: float(value) for name, value in row.items() if value} for row in csv.DictReader(file)]
