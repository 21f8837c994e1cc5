"""The files of scores: arrays of each test clip, for each model, for the truth and for the empty background."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.studies.generation.scoring import Scores, background_db, identity, score_clip
from benchmarks.studies.generation.study import Figures, Study
from benchmarks.studies.generation.train_judges import load_judges
from mirror.progress import ProgressReporter

TRUTH: Final = "truth"
EMPTY: Final = "background"


def scores_file(study: Study, name: str, clip_id: str) -> Path:
    """Return the path of the scores of a clip: of a model, of the truth, or of the empty background."""
    return study.folder / "scores" / name / f"{clip_id}.npz"


def read_scores(study: Study, name: str) -> dict[str, Scores]:
    """Return the scores of all test clips, by clip."""
    found: dict[str, Scores] = {}
    for clip in study.test:
        with np.load(scores_file(study, name, clip.clip_id)) as file:
            found[clip.clip_id] = {key: file[key] for key in file.files}
    return found


def list_scored(study: Study) -> list[str]:
    """Return the names of the models whose rollouts over all test clips are scored."""
    names = sorted(path.name for path in (study.folder / "scores").glob("*") if path.is_dir())
    return [
        name
        for name in names
        if name not in (TRUTH, EMPTY) and all(scores_file(study, name, clip.clip_id).is_file() for clip in study.test)
    ]


def write_scores(study: Study, name: str, images: Mapping[str, np.ndarray], progress: ProgressReporter) -> Figures:
    """Score images of all test clips, write the arrays of each clip, and return the figures of all."""
    judges = load_judges(study.judges)
    progress.start("scoring", len(study.test))
    for clip in study.test:
        path = scores_file(study, name, clip.clip_id)
        path.parent.mkdir(parents=True, exist_ok=True)
        scores = score_clip(clip, study.references, images[clip.clip_id], study.features, judges)
        temporary = path.with_name(f".{path.name}")
        with temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **scores)
        temporary.replace(path)
        progress.advance(1)
    every = list(read_scores(study, name).values())
    scoring = study.declaration.scoring
    classes, found = (np.concatenate([one[key] for one in every]) for key in ("crop_class", "crop_found"))
    ious = np.concatenate([one["iou"] for one in every])
    return {
        **background_db(every),
        **identity(every, int(scoring["long_track_frames"]), int(scoring["least_long_tracks"])),
        "classified": float((classes == found).mean()) if len(classes) else float("nan"),
        "crops": len(classes),
        "iou": float(ious.mean()) if len(ious) else float("nan"),
        "masks": len(ious),
        "images": sum(len(one["image"]) for one in every),
    }
