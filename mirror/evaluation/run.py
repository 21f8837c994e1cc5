"""Scoring a submission: checked, scored in two processes, resumed where an earlier run stopped, written as a result."""

from __future__ import annotations

import hashlib
import importlib.util
import io
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.parquet as pq

import mirror
from mirror.errors import DatasetError, UsageError
from mirror.evaluation.extractors import make_extractor
from mirror.evaluation.result import IMAGES, RESULT, DatasetIdentity, Result
from mirror.evaluation.scorers import load_scorer
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.scorers.scorer import STAND_IN_PREFIX, ScoredJob
from mirror.evaluation.submission.check import CheckReport, Problem, check_submission
from mirror.evaluation.submission.manifest import SubmissionManifest
from mirror.evaluation.submission.untrusted import open_untrusted
from mirror.evaluation.workers import ScoreLog, score_jobs
from mirror.installation import install_command
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.document import Protocol
from mirror.protocols.truth.hidden import require_hidden_truth
from mirror.protocols.views import Plan, plan_views
from mirror.schema.files import write_bytes, write_json
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.version import __version__
from mirror.weights.errors import WeightsUnavailableError
from mirror.weights.resolve import WeightResolver

WORK: Final = "work"
_PACKAGES: Final = ("numpy", "opencv-contrib-python-headless", "scipy", "torch", "numba", "pyarrow")
DEFAULT_EXTRACTOR: Final = "diff-grabcut"
_EDITING: Final = "editing-accuracy"


@dataclass(frozen=True)
class EvaluationOptions:
    """How a submission is scored, besides what the protocol says.

    Attributes:
        hidden: folder of an organiser's true pictures, in the layout of a submission.
        require: metrics that must be had; their names, or the part before the first ``_``.
        stand_ins: other metrics are computed in place of those that cannot be had, under their own names.
        workers: processes.
        resolver: finds weights.
        extractor: of edited regions; None: `DEFAULT_EXTRACTOR` where the protocol has some.
        measured: an installed method and the folder of its model, whose speed is measured; None: none is.
        features: folder of cached features; None: under the output folder.
    """

    hidden: Path | None = None
    require: Sequence[str] = ()
    stand_ins: bool = False
    workers: int = 2
    resolver: WeightResolver = field(default_factory=WeightResolver)
    extractor: str | None = None
    measured: tuple[str, Path] | None = None
    features: Path | None = None


@dataclass(frozen=True)
class Evaluation:
    """What came of it.

    Attributes:
        plan: the views that were asked for.
        check: the submission's check.
        result: as written; None: the submission has problems, and nothing was scored.
        inputs: what was read; None as well.
        scored: jobs and their values.
        reused: how many of them an earlier run had scored.
    """

    plan: Plan
    check: CheckReport
    result: Result | None = None
    inputs: ScoringInputs | None = None
    scored: tuple[ScoredJob, ...] = ()
    reused: int = 0


def evaluate(
    submission: Path,
    truth: str | Path,
    protocol: Protocol,
    split: str,
    out: Path,
    options: EvaluationOptions | None = None,
    progress: ProgressReporter | None = None,
) -> Evaluation:
    """Score a submission and write ``result.json`` and ``images.parquet``.

    Args:
        submission: its folder or zip.
        truth: the dataset.
        protocol: how it is scored.
        split: name of the split.
        out: folder for the results; what an interrupted run left there is used.
        options: see `EvaluationOptions`.
        progress: told what goes on.

    Raises:
        UsageError: a required metric cannot be had, there is no such metric, weights that are named explicitly are not
            those, hidden truth or an extractor is asked for and not given or given and not asked for, there are no
            workers, or `out` is something else.
        DatasetError: the truth is incomplete, or the results cannot be written.
        UntrustedError: the submission is refused as a whole.
    """
    options, progress = options or EvaluationOptions(), progress or NullProgress()
    if options.workers < 1:
        raise UsageError(f"{options.workers} workers", expected="at least one")
    require_output_folder(out, FolderKind.RESULTS)
    if options.features is not None:
        require_output_folder(options.features, FolderKind.OTHER, place="--features")
    dataset = mirror.open(truth)
    plan = plan_views(dataset, protocol, split)
    _require_fitting(plan, options)
    files = open_untrusted(submission)
    progress.start("checking", len(plan.views))
    check = check_submission(files, plan, advance=progress.advance)
    if check.problems or check.manifest is None:
        return Evaluation(plan, check)
    if options.hidden is not None:
        require_hidden_truth(options.hidden, plan)
    available = _availability(plan, check.manifest, options)
    unavailable = available.unavailable
    _require(options.require, protocol, unavailable)
    inputs = ScoringInputs(
        protocol=protocol,
        submission=submission,
        manifest=check.manifest,
        dataset=dataset,
        layers=plan.layers,
        hidden=options.hidden,
        resolver=options.resolver,
        unavailable=unavailable,
        stand_ins=available.stand_ins,
        features=options.features or out / WORK / "features",
        extractor=options.extractor or DEFAULT_EXTRACTOR,
        measured=options.measured,
    )
    scorer = load_scorer(protocol.task)
    some = len(unavailable) < len(protocol.metrics) or bool(available.stand_ins) or options.measured is not None
    jobs = scorer.jobs(plan, inputs) if some else []
    progress.start("scoring", len(jobs))
    outcome = score_jobs(
        jobs, inputs, ScoreLog(out / WORK / "scored.jsonl"), workers=options.workers, advance=progress.advance
    )
    if outcome.failed:
        problems = tuple(Problem("corrupt", name, why) for name, why in sorted(outcome.failed.items()))
        broken = CheckReport(check.expected, check.present, problems, check.manifest, check.hash)
        return Evaluation(plan, broken, reused=outcome.reused)
    result = Result(
        protocol=protocol,
        protocol_hash=protocol.hash,
        dataset=DatasetIdentity(
            split=split,
            dataset_hash=plan.dataset_hash,
            plan_hash=plan.hash,
            hidden_truth=None if options.hidden is None else _hidden_hash(plan, inputs),
        ),
        submission=check.manifest,
        submission_hash=check.hash,
        figures=tuple(scorer.figures(plan, outcome.scored, inputs)) if some else (),
        unavailable=unavailable,
        weights=available.weights,
        versions=_versions(),
        options={"extractor": inputs.extractor} if protocol.task == _EDITING else {},
        warnings=tuple(_warnings(plan, check.manifest, available)),
    )
    write_bytes(out / IMAGES, _table(outcome.scored, protocol))
    write_json(out / RESULT, result)
    return Evaluation(plan, check, result, inputs, outcome.scored, outcome.reused)


@dataclass(frozen=True)
class _Availability:
    """Metrics that cannot be had, others that stand in for them, and the hashes of the weights of those that can."""

    unavailable: dict[str, str]
    stand_ins: tuple[str, ...]
    weights: dict[str, str]


def _availability(plan: Plan, manifest: SubmissionManifest, options: EvaluationOptions) -> _Availability:
    scorer = load_scorer(plan.protocol.task)
    unavailable = dict(scorer.unavailable(plan, manifest))
    lacking = set(unavailable)
    weights: dict[str, str] = {}
    stand_ins: list[str] = []
    for metric, names in scorer.needs(plan).items():
        asked, original = metric in plan.protocol.metric_names, metric.removeprefix(STAND_IN_PREFIX)
        # Who lacks more than weights has nothing to compute a stand-in of either.
        if original in lacking or (not asked and (not options.stand_ins or original not in unavailable)):
            continue
        for name in names:
            if name in options.resolver.paths:
                _require_weights(options.resolver, name)
        try:
            found = {name: options.resolver.resolve(name).sha256 for name in names}
        except WeightsUnavailableError as error:
            if asked:
                unavailable[metric] = str(error)
            continue
        if importlib.util.find_spec("torch") is not None:
            weights.update(found)
            stand_ins += [] if asked else [metric]
        elif asked:
            unavailable[metric] = f"torch is not installed: {install_command('models')}"
    return _Availability(unavailable, tuple(stand_ins), weights)


def _require_fitting(plan: Plan, options: EvaluationOptions) -> None:
    """What is given is what the protocol uses, and what it cannot do without is given."""
    name, needed = plan.protocol.name, load_scorer(plan.protocol.task).needs_hidden(plan)
    if needed and options.hidden is None:
        raise UsageError(
            f"nobody recorded the pictures of moved cameras that protocol {name} asks for",
            place="--hidden",
            expected="the folder of an organiser's true pictures",
            remedy="of a synthetic street `mirror submission hidden` renders them",
        )
    if not needed and options.hidden is not None:
        raise UsageError(
            f"protocol {name} has recorded truth, and uses no other", place="--hidden", expected="no such option"
        )
    if options.extractor is not None:
        if plan.protocol.task != _EDITING:
            raise UsageError(f"protocol {name} extracts no regions", place="--extractor", expected="no such option")
        make_extractor(options.extractor)


def _require_weights(resolver: WeightResolver, name: str) -> None:
    """Who names a file means that file: another one is a mistake, and not a metric that cannot be had."""
    try:
        resolver.resolve(name)
    except WeightsUnavailableError as error:
        raise UsageError(error.problem, file=error.file, place=f"--weights {name}", expected=error.expected) from error


def _require(required: Sequence[str], protocol: Protocol, unavailable: Mapping[str, str]) -> None:
    for name in required:
        meant = [metric for metric in protocol.metric_names if name in (metric, metric.partition("_")[0])]
        if not meant:
            raise UsageError(
                f"protocol {protocol.name} has no metric {name!r}",
                place="--require",
                expected=f"one of {', '.join(protocol.metric_names)}",
            )
        for metric in meant:
            if metric in unavailable:
                raise UsageError(f"{metric} is required and unavailable: {unavailable[metric]}", place="--require")


def _hidden_hash(plan: Plan, inputs: ScoringInputs) -> str:
    digest = hashlib.sha256()
    for view in plan.views:
        digest.update(f"{view.path} {inputs.truth.image_hash(view)}\n".encode())
    return digest.hexdigest()


def _versions() -> dict[str, str]:
    found = {"mirror": __version__, "python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def _warnings(plan: Plan, manifest: SubmissionManifest, available: _Availability) -> list[str]:
    found = [f"group {name} has no views in split {plan.split}" for name in plan.empty_groups]
    for name in available.stand_ins:
        found.append(
            f"{name} stands in for {name.removeprefix(STAND_IN_PREFIX)}: another metric, with figures of its own"
        )
    if manifest.appearance.held_out_pixels:
        found.append("the method's appearance was fitted to held-out pixels; they are not scored")
    return found


def _table(scored: Sequence[ScoredJob], protocol: Protocol) -> bytes:
    """One row a picture, as Parquet."""
    rows = []
    names: dict[str, None] = {}
    for one in scored:
        if not one.job.in_table:
            continue
        view = one.job.views[0]
        keys = ("group", "scene_id", "traversal_id", "frame_index", "camera", "timestamp_ns", "light", "weather")
        rows.append({"path": one.job.name, **{key: getattr(view, key) for key in keys}, **one.values})
        names.update(dict.fromkeys(rows[-1]))
    columns = {name: [row.get(name) for row in rows] for name in names}
    table = pa.table(columns).replace_schema_metadata({"mirror_protocol_hash": protocol.hash})
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd", version="2.6")
    return sink.getvalue()


def read_result(path: Path) -> Result:
    """A result of its file, or of the folder that it lies in.

    Raises:
        DatasetError: there is none.
        SchemaError: it is broken.
    """
    from mirror.schema.files import read_json

    file = path / RESULT if path.is_dir() else path
    if not file.is_file():
        raise DatasetError(
            "no such result", file=file, expected=f"the {RESULT} of `mirror evaluate`, or the folder that it lies in"
        )
    return read_json(file, Result)
