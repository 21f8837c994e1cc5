"""Jobs of the study: one method trained on one scene with one seed and budget, and its files in a working folder."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mirror.errors import UsageError

_RUNS: Final = "runs"
_OUTCOMES: Final = "outcomes"
_TRUTH: Final = "truth"
_NAME: Final = re.compile(
    r"(?P<entry>.+)\.(?P<scene>[a-z][a-z-]*)\.(?P<minutes>[\d.]+)min\.(?P<width>\d+)px\.(?P<seed>\d+)"
)


@dataclass(frozen=True)
class Job:
    """One model to train and score.

    Attributes:
        entry: row of the comparison.
        scene: the scene to train on.
        seed: of the training.
        core_minutes: of training.
        width_px: of the images.
    """

    entry: str
    scene: str
    seed: int
    core_minutes: float
    width_px: int

    @property
    def name(self) -> str:
        """Name of the job's model folder and of its files."""
        return f"{self.entry}.{self.scene}.{self.core_minutes:g}min.{self.width_px}px.{self.seed}"


def parse_job(name: str) -> Job:
    """Return the job that has a name.

    Raises:
        UsageError: the name is not one of a job.
    """
    found = _NAME.fullmatch(name)
    if found is None:
        raise UsageError(f"a run called {name!r}", expected="ENTRY.SCENE.MINUTESmin.WIDTHpx.SEED")
    return Job(found["entry"], found["scene"], int(found["seed"]), float(found["minutes"]), int(found["width"]))


def models_folder(folder: Path) -> Path:
    """Return the folder of all trained models."""
    return folder / _RUNS


def model_folder(folder: Path, job: Job) -> Path:
    """Return the folder of the model that a job trains."""
    return models_folder(folder) / job.name


def outcomes_folder(folder: Path) -> Path:
    """Return the folder of one JSON file for each finished job."""
    return folder / _OUTCOMES


def outcome_file(folder: Path, job: Job) -> Path:
    """Return the file that a job writes last."""
    return outcomes_folder(folder) / f"{job.name}.json"


def truth_folder(folder: Path) -> Path:
    """Return the folder of the measurements of `truth`: a JSON file for each model and each exact street."""
    return folder / _TRUTH


def truth_file(folder: Path, job: Job) -> Path:
    """Return the file of a model's errors against exact truth."""
    return truth_folder(folder) / f"{job.name}.json"


def exact_street_file(folder: Path, scene: str, width_px: int) -> Path:
    """Return the file of the scores of a scene's exact street."""
    return truth_folder(folder) / f"ceiling.{scene}.{width_px}px.json"
