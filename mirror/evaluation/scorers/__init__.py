"""The scorers, one in each file; `TASKS` maps the task of a protocol to its scorer's module."""

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
    """Import the scorer of a task."""
    scorer: Scorer = import_module(f"mirror.evaluation.scorers.{TASKS[task]}").SCORER
    return scorer
