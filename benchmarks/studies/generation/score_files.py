"""The files of scores: arrays of each test clip, for each model, for the truth and for the empty background."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.studies.generation.scoring import Scores
from benchmarks.studies.generation.study import Study

TRUTH: Final = "truth"
EMPTY: Final = "background"


def scores_file(study: Study, name: str, clip_id: str) -> Path:
    """Where the scores of a clip are: of a model, of the truth, or of the empty background."""
    return study.folder / "scores" / name / f"{clip_id}.npz"


def read_scores(study: Study, name: str) -> dict[str, Scores]:
    """The scores of all test clips, by clip."""
    found: dict[str, Scores] = {}
    for clip in study.test:
        with np.load(scores_file(study, name, clip.clip_id)) as file:
            found[clip.clip_id] = {key: file[key] for key in file.files}
    return found


def list_scored(study: Study) -> list[str]:
    """Names of the models whose rollouts over all test clips are scored."""
    names = sorted(path.name for path in (study.folder / "scores").glob("*") if path.is_dir())
    return [
        name
        for name in names
        if name not in (TRUTH, EMPTY) and all(scores_file(study, name, clip.clip_id).is_file() for clip in study.test)
    ]
