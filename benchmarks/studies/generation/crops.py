"""Where the distance of crops comes from: by class and by drive. It was not declared, and no bar is held against it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, TypeAlias

import numpy as np

from benchmarks.studies.generation.comparison import collect_statistics, measure_distance
from benchmarks.studies.generation.score_files import EMPTY, TRUTH, list_scored, read_scores
from benchmarks.studies.generation.scoring import Scores
from benchmarks.studies.generation.study import Figures, Study
from hybridworldsim.generation.clips.clip import CATEGORIES
from mirror.arrays import Bool

STAGE: Final = "crops"
_LEAST_CROPS: Final = 100

_Chosen: TypeAlias = Mapping[str, Bool]
"""The crops of each clip that count."""


def measure_crops(study: Study, least_crops: int = _LEAST_CROPS) -> Figures:
    """Return the distance of crops to those of the truth, over that of the empty background.

    Args:
        study: the study; every model that was scored over all test clips is measured.
        least_crops: classes and drives with fewer crops are left out.

    Returns:
        By model: ``all``, and ``classes`` and ``drives`` by name.
    """
    truth, empty, drives = read_scores(study, TRUTH), read_scores(study, EMPTY), study.drives
    every = {clip: np.ones(len(one["crop"]), bool) for clip, one in truth.items()}
    by_class = {
        category: {clip: one["crop_class"] == number for clip, one in truth.items()}
        for number, category in enumerate(CATEGORIES)
    }
    by_drive = {
        drive: {clip: rows & (drives[clip] == drive) for clip, rows in every.items()}
        for drive in sorted(set(drives.values()))
    }

    def ratio(model: Mapping[str, Scores], chosen: _Chosen) -> float:
        target, own, other = (collect_statistics(_choose(one, chosen), drives, "crop") for one in (truth, model, empty))
        return measure_distance(own, target) / measure_distance(other, target)

    figures: Figures = {}
    for name in list_scored(study):
        model = read_scores(study, name)
        figures[name] = {"all": ratio(model, every)} | {
            kind: {key: ratio(model, chosen) for key, chosen in groups.items() if _count(chosen) >= least_crops}
            for kind, groups in (("classes", by_class), ("drives", by_drive))
        }
    return figures


def _choose(scores: Mapping[str, Scores], chosen: _Chosen) -> dict[str, Scores]:
    return {clip: {"crop": scores[clip]["crop"][rows]} for clip, rows in chosen.items()}


def _count(chosen: _Chosen) -> int:
    return sum(int(rows.sum()) for rows in chosen.values())
