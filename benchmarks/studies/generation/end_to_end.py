"""The part `end_to_end`, an addition to the study with its own declaration: backgrounds of `mirror reconstruct`."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from benchmarks.studies.generation.comparison import Ratio, collect_statistics, compare
from benchmarks.studies.generation.edits import EditScore, generate_edits, normalise, score_edit
from benchmarks.studies.generation.road_models import Road, RoadModel
from benchmarks.studies.generation.rollouts import roll_out_all
from benchmarks.studies.generation.score_files import EMPTY, TRUTH, read_scores, write_scores
from benchmarks.studies.generation.stages import plan_declared_edits
from benchmarks.studies.generation.study import Figures, Stage, Study
from benchmarks.studies.generation.train_judges import load_judges
from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.clips.folder import ClipList, clip_path, read_clip, write_clip, write_list
from mirror.arrays import UInt8
from mirror.errors import UsageError
from mirror.progress import ProgressReporter
from mirror.schema.hashing import hash_document

FILE: Final = Path(__file__).with_name("end_to_end.toml")
OUTCOMES: Final = Path(__file__).with_name("end_to_end.jsonl")
NAME: Final = "end_to_end"
"""The name of this part in the experiment's declaration, and of its folder in the study's."""
DISTANCES: Final = "distances"


@dataclass(frozen=True)
class Addition:
    """The choices that are fixed before the addition is run; `end_to_end.toml` explains each value.

    Attributes:
        experiment: hash of the experiment.
        model: name of the model.
        recordings: of each road.
        roads: routes and lengths of the roads, by name.
        reconstruction: options of `mirror reconstruct`.
        backgrounds: how they are rendered.
        scoring: what differs from the experiment.
        budget: processor time.
        hash: SHA-256 of all values.
    """

    experiment: str
    model: str
    recordings: Mapping[str, Any]
    roads: Mapping[str, Mapping[str, Any]]
    reconstruction: Mapping[str, Any]
    backgrounds: Mapping[str, Any]
    scoring: Mapping[str, str]
    budget: Mapping[str, float]
    hash: str


def load_addition(file: Path = FILE) -> Addition:
    """Load the declaration of the addition; its hash is of its values."""
    document = tomllib.loads(file.read_text())
    return Addition(**document, hash=hash_document(document))


def open_addition(study: Study, addition: Addition, published: Path = OUTCOMES) -> Study:
    """Return the addition as a study of its own, in a folder of the study's, with the study's models and judges.

    Raises:
        UsageError: the addition is to another experiment.
    """
    if addition.experiment != study.declaration.hash:
        raise UsageError(
            f"an addition to the experiment {addition.experiment[:12]}",
            file=FILE,
            expected=f"to {study.declaration.hash[:12]}",
        )
    return replace(
        study,
        folder=study.folder / NAME,
        declaration=replace(study.declaration, hash=addition.hash),
        published=published,
        trained=study.folder,
    )


class Backgrounds(Protocol):
    """The backgrounds of a road: recorded, reconstructed and rendered."""

    road: Road

    def record(self) -> Figures:
        """Make the recordings that are reconstructed."""
        ...

    def reconstruct(self) -> Figures:
        """Make the model that is rendered."""
        ...

    def render(self, clip: Clip) -> UInt8:
        """Return the images (F, V, H, W, 3) at the views of a clip."""
        ...


def list_roads(addition: Addition, folder: Path) -> list[RoadModel]:
    """Return the models of all roads, in folders of the addition's."""
    return [
        RoadModel(
            Road(
                name, tuple(one["routes"]), float(one["stretch_m"]), addition.recordings, addition.reconstruction,
                int(addition.backgrounds["factor"]),
            ),
            folder / "roads" / name,
        )
        for name, one in addition.roads.items()
    ]  # fmt: skip


def list_parts(study: Study, addition: Addition, roads: Sequence[Backgrounds]) -> list[Stage]:
    """Return the stages of the addition in their order; they run in the study that `open_addition` returns.

    Args:
        study: the experiment's study.
        addition: the declaration.
        roads: the sources of the backgrounds.
    """
    parts = []
    for one in roads:
        many = len(one.road.routes)
        parts.append(Stage(f"record-{one.road.name}", 2.0 * many, partial(_record, road=one)))
        parts.append(Stage(f"reconstruct-{one.road.name}", 14.0 + 2.0 * many, partial(_reconstruct, road=one)))
    return [
        *parts,
        Stage("render", 10.0, partial(_render, exact=study, roads=roads)),
        Stage(EMPTY, 1.5, _score_backgrounds),
        Stage(f"score-{addition.model}", 6.0, partial(_score, model=addition.model)),
        Stage("edits", 4.0, partial(_edits, exact=study, model=addition.model)),
        Stage(DISTANCES, 1.0, partial(_distances, exact=study, model=addition.model)),
    ]


def _record(study: Study, progress: ProgressReporter, *, road: Backgrounds) -> Figures:
    return road.record()


def _reconstruct(study: Study, progress: ProgressReporter, *, road: Backgrounds) -> Figures:
    return road.reconstruct()


def _render(study: Study, progress: ProgressReporter, *, exact: Study, roads: Sequence[Backgrounds]) -> Figures:
    """Write the test clips with the models' backgrounds; figures are of these against the exact ones, in all pixels.

    ``shift`` is the mean difference in brightness steps of red, green and blue.
    """
    by_route = {route: one for one in roads for route in one.road.routes}
    squares, shifts = [], []
    progress.start("clips", len(exact.test))
    for clip in exact.test:
        route, _, _ = clip.drive_id.rpartition("-s")
        if not clip_path(study.clips, clip.clip_id).is_file():
            write_clip(study.clips, replace(clip, background=by_route[route].render(clip)))
        error = read_clip(study.clips, clip.clip_id).background.astype(np.float64) - clip.background
        squares.append(float((error**2).mean()))
        shifts.append(error.mean(axis=(0, 1, 2, 3)))
        progress.advance(1)
    test = tuple(clip.clip_id for clip in exact.test)
    write_list(study.clips, ClipList(source="test clips over reconstructed streets", training=(), test=test))
    square = float(np.mean(squares)) / 255.0**2
    return {
        "db": -10.0 * float(np.log10(square)) if square > 0.0 else float("inf"),
        "shift": np.mean(shifts, axis=0).tolist(),
        "db_by_clip": {name: -10.0 * float(np.log10(max(one, 1e-9) / 255.0**2)) for name, one in zip(test, squares)},
    }


def _score_backgrounds(study: Study, progress: ProgressReporter) -> Figures:
    given = {clip.clip_id: clip.background[study.references :] for clip in study.test}
    return write_scores(study, EMPTY, given, progress)


def _score(study: Study, progress: ProgressReporter, *, model: str) -> Figures:
    steps = int(study.declaration.scoring["sampler_steps"])
    out = study.folder / "rollouts" / model
    images = roll_out_all(study.model(model), study.autoencoder, study.test, out, steps, progress)
    return write_scores(study, model, images, progress)


def _edits(study: Study, progress: ProgressReporter, *, exact: Study, model: str) -> Figures:
    """As the study's stage; the segmenter gets the background generated over, for recorded images the exact one."""
    scoring = study.declaration.scoring
    segmenter, _ = load_judges(study.judges)
    least, figures = int(scoring["mask_px"]), {}
    for dy_m in scoring["edits_m"]:
        edits, recorded = (plan_declared_edits(one, float(dy_m)) for one in (study, exact))
        images = generate_edits(study.model(model), study.autoencoder, edits, int(scoring["sampler_steps"]), progress)
        scores = [
            EditScore(own.found, true.floor, true.ceiling)
            for edit, other, made in zip(edits, recorded, images, strict=True)
            for own, true in zip(
                score_edit(edit, made, segmenter, least), score_edit(other, made, segmenter, least), strict=True
            )
        ]
        figures[f"{dy_m:g}m"] = {"edits": len(edits), **(normalise(scores) if scores else {"n": 0})}
    return figures


def _distances(study: Study, progress: ProgressReporter, *, exact: Study, model: str) -> Figures:
    """Distances to the truth, as ratios.

    ``image``: to that with exact backgrounds. ``crop``, ``crop_exact``: to that of the exact background itself.
    """
    over, before, empty = (read_scores(*one) for one in ((study, model), (exact, model), (exact, EMPTY)))
    scoring, truth, drives = study.declaration.scoring, read_scores(exact, TRUTH), exact.drives

    def ratio(first: Mapping[str, Any], second: Mapping[str, Any], kind: str) -> Ratio:
        statistics = [collect_statistics(one, drives, kind) for one in (first, second, truth)]
        return compare(
            [statistics[0]], [statistics[1]], statistics[2],
            resamples=int(scoring["resamples"]), level=float(scoring["level"]),
        )  # fmt: skip

    return {
        "image": asdict(ratio(over, before, "image")),
        "crop": asdict(ratio(over, empty, "crop")),
        "crop_exact": asdict(ratio(before, empty, "crop")),
    }
