"""Holds a result against the plan of its dataset, and scores its renders again."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import mirror
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.evaluation.result import GroupFigure, Result
from mirror.evaluation.run import EvaluationOptions, evaluate, list_warnings
from mirror.evaluation.scorers import load_scorer
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.scorers.scorer import STAND_IN_PREFIX, Job, ScoredJob
from mirror.progress import ProgressReporter
from mirror.protocols.views import Plan, plan_views
from mirror.weights.resolve import WeightResolver
from mirror.weights.table import KNOWN
from mirror_leaderboard.recount import read_rows
from mirror_leaderboard.refused import RefusedError

_TOLERANCE: Final = 1e-9
_OF_IMAGES: Final = ("reconstruction", "lane-shift")
"""Tasks whose figures are means of the scores of single images."""

MEASURED_HERE: Final = "measured"
"""Group of the task runtime with the figures that an evaluator measured."""

_RUNTIME: Final = "runtime"
_AGAIN: Final = "evaluate the submission again: mirror evaluate"
_ROW_KEYS: Final = ("group", "scene_id", "traversal_id", "frame_index", "camera", "timestamp_ns", "light", "weather")
_COMPARED: Final = ("value", "n", "n_inf", "n_missing", "low", "high", "reason", "note", "interval_reason")


@dataclass(frozen=True)
class RolloutPlan:
    """Request of an organiser: to drive each scenario of a folder, with its seed, in each street.

    Attributes:
        streets: synthetic streets ``synth:PRESET[:SEED[:DRIVE]]``, and datasets, of which each scene is a street.
        scenarios: folder of scenarios (``.toml``); files with one name and different seeds are several drives.
        road_map: file of the map of the streets; None: their own.
        boxes: layer of boxes ``source@version`` of the datasets; None: they have one at most.
    """

    streets: tuple[str, ...]
    scenarios: Path
    road_map: Path | None = None
    boxes: str | None = None


@dataclass(frozen=True)
class SuitePlan:
    """Request of an organiser: the drives of the protocol's suite, on its own streets."""


@dataclass(frozen=True)
class Sources:
    """The data that an organiser compares a result with.

    Attributes:
        dataset: folder or URL of the dataset with the truth; for the protocol safety, the folder of the rollouts.
        submission: folder or zip of the renders; None: they are not scored again.
        hidden: folder of hidden truth, for protocols that use it.
        features: folder of cached features of the truth, by hash; None: none are kept.
        workers: number of worker processes.
        extractor: extractor of edited regions; None: the built-in one. What a result states is never taken.
        plan: for the protocol safety, what was asked to be driven; None: controls are not driven again.
        secret: the organiser's secret of a suite, which its drives follow from; None: it has none.
        ran_here: whether the organiser drove the rollouts, with the policy in a sandbox or a container.
        measured: for the protocol runtime, an installed method and its model, whose speed is measured here; None: all
            figures are those that the submission states.
    """

    dataset: str
    submission: Path | None = None
    hidden: Path | None = None
    features: Path | None = None
    workers: int = 2
    extractor: str | None = None
    plan: RolloutPlan | SuitePlan | None = None
    secret: bytes | None = None
    ran_here: bool = False
    measured: tuple[str, Path] | None = None


def rescore(result: Result, path: Path, sources: Sources, progress: ProgressReporter | None = None) -> Result:
    """Score a submission again, and return the new result if it equals the given one.

    Args:
        result: the given result.
        path: its file, for messages.
        sources: dataset, submission and hidden truth.
        progress: receives the progress.

    Raises:
        RefusedError: the submission is another one or has problems, or a figure, a reason, a warning or weights differ.
        UsageError: `sources` has no submission.
    """
    if sources.submission is None:
        raise UsageError("no submission to score", expected="--submission")
    stand_ins = any(figure.metric.startswith(STAND_IN_PREFIX) for figure in result.figures)
    with tempfile.TemporaryDirectory(prefix="mirror-rescore-") as folder:
        options = EvaluationOptions(
            hidden=sources.hidden,
            stand_ins=stand_ins,
            workers=sources.workers,
            extractor=sources.extractor,
            features=sources.features,
            measured=sources.measured,
        )
        out = Path(folder) / "results"
        done = evaluate(
            sources.submission, sources.dataset, result.protocol, result.dataset.split, out, options, progress
        )
    if done.result is None:
        problem = done.check.problems[0]
        raise RefusedError(f"{problem.path} {problem.message}", file=sources.submission, expected="a whole submission")
    require_equal("submission_hash", result.submission_hash, done.result.submission_hash, path)
    require_equal("dataset", result.dataset, done.result.dataset, path)
    require_equal("submission", result.submission, done.result.submission, path)
    require_equal("unavailable", sorted(result.unavailable), sorted(done.result.unavailable), path)
    require_equal("weights", result.weights, done.result.weights, path)
    require_equal("options", result.options, done.result.options, path)
    require_equal("warnings", result.warnings, done.result.warnings, path)
    # Two measurements differ: the one that was taken here counts.
    groups = () if sources.measured is None else (MEASURED_HERE,)
    stated, found = ([figure for figure in one.figures if figure.group not in groups] for one in (result, done.result))
    require_equal_figures(stated, found, path)
    return done.result


def require_plan(result: Result, path: Path, dataset: str) -> None:
    """Require that views, metrics, weights, counts, means, intervals and warnings agree with the dataset's plan.

    The scores of single images are taken from the table beside the result: only `rescore` shows that they are true.

    Args:
        result: the result.
        path: its file; the table of images lies beside it.
        dataset: folder or URL of the dataset.

    Raises:
        RefusedError: something differs from the plan, or does not follow from the table of images, as the figures of
            whole sets (FID, KID, FVD, detection) and of edited regions never do.
    """
    if result.protocol.task not in (*_OF_IMAGES, _RUNTIME):
        raise RefusedError(
            f"figures of the task {result.protocol.task} do not follow from the table of images, so that nothing "
            "shows that they are true",
            file=path,
            place="figures",
            expected="the renders that they were computed from",
            remedy="mirror leaderboard add ... --submission SUBMISSION",
        )
    # Each option has a table of its own, which a result must not open by stating one.
    require_equal("options", result.options, {}, path)
    opened = mirror.open(dataset)
    plan = plan_views(opened, result.protocol, result.dataset.split)
    require_equal("dataset.dataset_hash", result.dataset.dataset_hash, plan.dataset_hash, path)
    require_equal("dataset.plan_hash", result.dataset.plan_hash, plan.hash, path)
    _require_available(result, plan, path)
    stand_ins = tuple(dict.fromkeys(f.metric for f in result.figures if f.metric.startswith(STAND_IN_PREFIX)))
    require_equal("warnings", result.warnings, tuple(list_warnings(plan, result.submission, stand_ins)), path)
    # The task runtime has no images: its figures are those of the manifest.
    scored = _scored_jobs(plan, read_rows(path), path) if result.protocol.task in _OF_IMAGES else []
    inputs = _stated_inputs(result, path, opened, plan, stand_ins)
    require_equal_figures(result.figures, load_scorer(result.protocol.task).figures(plan, scored, inputs), path)


def _require_available(result: Result, plan: Plan, path: Path) -> None:
    """Only a metric with weights can be unavailable for want of them; used weights are the pinned ones."""
    scorer = load_scorer(result.protocol.task)
    needs, without = scorer.needs(plan), scorer.unavailable(plan, result.submission)
    for metric in result.unavailable:
        if metric not in needs and metric not in without:
            raise RefusedError(
                f"{metric} is stated to be unavailable, but it needs no weights",
                file=path,
                place="unavailable",
                remedy=_AGAIN,
            )
    for metric, names in needs.items():
        if metric in result.protocol.metric_names and metric not in result.unavailable:
            for name in names:
                pinned = KNOWN[name].sha256
                if name not in result.weights or pinned not in (None, result.weights[name]):
                    raise RefusedError(
                        f"{metric} was not computed with the pinned weights {name}",
                        file=path,
                        place="weights",
                        expected=str(pinned),
                    )


def _scored_jobs(plan: Plan, rows: Sequence[Mapping[str, Any]], path: Path) -> list[ScoredJob]:
    by_path = {str(row.get("path")): row for row in rows}
    if len(by_path) != len(rows) or set(by_path) != {view.path for view in plan.views}:
        raise RefusedError(
            f"the table of images has {len(rows)} rows, and not one for each of the {len(plan.views)} views",
            file=path,
            place="images.parquet",
            remedy=_AGAIN,
        )
    jobs = []
    for view in plan.views:
        row = by_path[view.path]
        for key in _ROW_KEYS:
            if row.get(key) != getattr(view, key):
                raise RefusedError(
                    f"{key} of {view.path} is {row.get(key)!r}",
                    file=path,
                    place="images.parquet",
                    expected=repr(getattr(view, key)),
                )
        jobs.append(ScoredJob(Job(view.path, (view,), (view.path,)), row))
    return jobs


def _stated_inputs(
    result: Result, path: Path, dataset: Dataset, plan: Plan, stand_ins: tuple[str, ...]
) -> ScoringInputs:
    return ScoringInputs(
        protocol=result.protocol,
        submission=path,
        manifest=result.submission,
        dataset=dataset,
        hashes={},
        layers=plan.layers,
        hidden=None,
        resolver=WeightResolver(),
        unavailable=result.unavailable,
        stand_ins=stand_ins,
        features=path.parent,
    )


def require_equal(place: str, stated: object, expected: object, path: Path) -> None:
    """Require that a result equals the result of the evaluation here.

    Raises:
        RefusedError: it states something else.
    """
    if stated != expected:
        raise RefusedError(
            f"{str(stated)!r:.200} is not what the evaluation finds",
            file=path,
            place=place,
            expected=f"{str(expected)!r:.200}",
            remedy=_AGAIN,
        )


def require_equal_figures(stated: Sequence[GroupFigure], expected: Sequence[GroupFigure], path: Path) -> None:
    """Require that a result's figures equal the figures of the evaluation here, to 1e-9.

    Raises:
        RefusedError: a figure differs, is missing, or was not found.
    """
    found = {_figure_key(figure): figure for figure in stated}
    computed = {_figure_key(figure): figure for figure in expected}
    for key in sorted(found.keys() ^ computed.keys()):
        whose = "stated, but not found by the evaluation" if key in found else "missing"
        raise RefusedError(
            f"{key[0]} of {' '.join(filter(None, key[1:]))} is {whose}",
            file=path,
            place="figures",
            remedy="evaluate the submission again, and add that result",
        )
    if len(found) != len(stated):
        raise RefusedError(
            "states a figure twice",
            file=path,
            place="figures",
            remedy="evaluate the submission again, and add that result",
        )
    for key, figure in computed.items():
        for name, one, other in _differences(found[key], figure):
            raise RefusedError(
                f"{name} of {key[0]} of {' '.join(filter(None, key[1:]))} is {one}",
                file=path,
                place="figures",
                expected=str(other),
                remedy=_AGAIN,
            )


def _figure_key(figure: GroupFigure) -> tuple[str, str, str, str]:
    return figure.metric, figure.group, figure.level, figure.key


def _differences(stated: GroupFigure, expected: GroupFigure) -> Iterator[tuple[str, object, object]]:
    for name in _COMPARED:
        one, other = getattr(stated, name), getattr(expected, name)
        if isinstance(one, float) and isinstance(other, float):
            if not math.isclose(one, other, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE):
                yield name, one, other
        elif one != other:
            yield name, one, other
