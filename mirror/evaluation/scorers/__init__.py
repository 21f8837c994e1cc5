"""Scorers, one a file; `TASKS` says which a protocol's task has."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Final

from mirror.evaluation.scorers.scorer import Scorer
from mirror.protocols.document import ScoringTask

TASKS: Final[Mapping[ScoringTask, str]] = {
    "reconstruction": "reconstruction",
    "lane-shift": "reconstruction",
    "vehicle-translation": "distributions",
    "generation": "distributions",
    "editing-accuracy": "editing_accuracy",
    "annotation": "annotation",
    "runtime": "runtime",
}


def load_scorer(task: ScoringTask) -> Scorer:
    """The scorer of a task."""
    scorer: Scorer = import_module(f"mirror.evaluation.scorers.{TASKS[task]}").SCORER
    return scorer
