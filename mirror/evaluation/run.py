"""Evaluation of a submission: check, scoring in worker processes (resumable), and the written result."""

from __future__ import annotations

import hashlib
import importlib.util
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from mirror.dataset import open as open_dataset
from mirror.dataset.dataset import Dataset
from mirror.devices import CPU, hardware_name
from mirror.errors import DatasetError, UsageError
from mirror.evaluation.clusters import compute_clusters
from mirror.evaluation.extractors import DEFAULT_EXTRACTOR, make_extractor
from mirror.evaluation.result import IMAGES, RESULT, DatasetIdentity, Result
from mirror.evaluation.scorers import load_scorer
from mirror.evaluation.scorers.edit_fidelity import fidelity_metrics
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.scorers.scorer import STAND_IN_PREFIX, Job, ScoredJob
from mirror.evaluation.submission.check import SubmissionCheck, SubmissionProblem, check_submission
from mirror.evaluation.submission.manifest import SubmissionManifest
from mirror.evaluation.submission.untrusted import open_untrusted
from mirror.evaluation.versions import list_versions
from mirror.evaluation.workers import ScoreLog, score_jobs
from mirror.installation import install_command
from mirror.methods.registry import load_method
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.document import Protocol
from mirror.protocols.metrics import metric_name
from mirror.protocols.truth.hidden import require_hidden_truth
from mirror.protocols.views import Plan, plan_views
from mirror.schema.files import write_bytes, write_json
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.weights.errors import WeightsUnavailableError
from mirror.weights.resolve import WeightResolver

WORK: Final = "work"
_EDITING: Final = "editing-accuracy"
_RUNTIME: Final = "runtime"
_WITHOUT_TRUTH: Final = (
    "needs the exact truth of the edits (--hidden); `mirror submission hidden` renders that of a synthetic street"
)
_ROW_KEYS: Final = (
    "group", "scene_id", "traversal_id", "frame_index", "camera", "timestamp_ns", "light", "weather"
)  # fmt: skip
_SCORES_HASH: Final = b"mirror_scores_hash"
"""Key of the metadata of the table of images: `ScoringOutcome.hash` of its rows."""


@dataclass(frozen=True)
class EvaluationOptions:
    """Options of an evaluation that are not part of the protocol.

    Attributes:
        hidden: folder of hidden truth, in the layout of a submission.
        require: metrics that must be available, by name or by the part of the name before the first ``_``.
        stand_ins: whether stand-in metrics are computed, under their own names, for metrics without weights.
        workers: greatest number of worker processes; few images are scored in this process.
        resolver: finds the weights of networks.
        extractor: extractor of edited regions; None: `DEFAULT_EXTRACTOR` if the protocol needs one.
        measured: a method (an installed one, or ``FILE.py:OBJECT``) and the folder of its model, for a measurement of
            its speed; None: no measurement.
        features: folder of cached features; None: a folder under the output folder.
        device: where networks run, as torch names it. Scores for a board are those of the CPU.
    """

    hidden: Path | None = None
    require: Sequence[str] = ()
    stand_ins: bool = False
    workers: int = 2
    resolver: WeightResolver = field(default_factory=WeightResolver)
    extractor: str | None = None
    measured: tuple[str, Path] | None = None
    features: Path | None = None
    device: str = CPU


@dataclass(frozen=True)
class Evaluation:
    """The outcome of an evaluation.

    Attributes:
        plan: requested views.
        check: report of the submission's check.
        result: the written result; None: the submission has problems, and there is no result.
        inputs: inputs of the scorers; None if there is no result.
        scored: scored jobs with their values.
        reused: number of jobs whose values an earlier run computed.
    """

    plan: Plan
    check: SubmissionCheck
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
        submission: folder or zip of the submission.
        truth: dataset with the truth.
        protocol: protocol of the evaluation.
        split: name of the split.
        out: folder for the results; values from an interrupted run in this folder are reused.
        options: see `EvaluationOptions`.
        progress: receives the progress.

    Raises:
        UsageError: a required metric is unknown or unavailable; explicitly named weights have another hash; hidden
            truth or an extractor is missing or not used by the protocol; the number of workers is below 1; or `out`
            is a folder of another kind.
        DatasetError: the truth is incomplete, such as that of a published dataset, or the results cannot be written.
        UntrustedError: the submission is refused as a whole.
    """
    options, progress = options or EvaluationOptions(), progress or NullProgress()
    if options.workers < 1:
        raise UsageError(f"{options.workers} workers", expected="at least one")
    require_output_folder(out, FolderKind.RESULTS)
    if options.features is not None:
        require_output_folder(options.features, FolderKind.OTHER, place="--features")
    dataset = open_dataset(truth)
    plan = plan_views(dataset, protocol, split)
    _require_matching_options(plan, options)
    required = _list_required(options.require, protocol)
    files = open_untrusted(submission)
    progress.start("checking", len(plan.views))
    check = check_submission(files, plan, advance=progress.advance)
    if check.problems or check.manifest is None:
        return Evaluation(plan, check)
    if options.hidden is not None:
        require_hidden_truth(options.hidden, plan)
    available = _find_availability(plan, check.manifest, options)
    unavailable = available.unavailable
    _require_available(required, unavailable)
    inputs = ScoringInputs(
        protocol=protocol,
        submission=submission,
        manifest=check.manifest,
        dataset=dataset,
        hashes=check.hashes,
        layers=plan.layers,
        hidden=options.hidden,
        resolver=options.resolver,
        unavailable=unavailable,
        stand_ins=available.stand_ins,
        features=options.features or out / WORK / "features",
        extractor=options.extractor or DEFAULT_EXTRACTOR,
        measured=options.measured,
        device=options.device,
    )
    scorer = load_scorer(protocol.task)
    has_metrics = len(unavailable) < len(protocol.metrics) or bool(available.stand_ins) or options.measured is not None
    jobs = scorer.jobs(plan, inputs) if has_metrics else []
    _require_recorded_images(dataset, [job for job in jobs if options.hidden is None or job.recorded])
    progress.start("scoring", len(jobs))
    outcome = score_jobs(
        jobs,
        inputs,
        ScoreLog(out / WORK / "scored.jsonl"),
        workers=options.workers,
        begins_here=not available.weights and options.measured is None,
        advance=progress.advance,
    )
    if outcome.failed:
        problems = tuple(
            SubmissionProblem("corrupt", name, problem) for name, problem in sorted(outcome.failed.items())
        )
        failed_check = SubmissionCheck(
            check.expected, check.present, problems, check.manifest, check.hash, check.hashes
        )
        return Evaluation(plan, failed_check, reused=outcome.reused)
    result = Result(
        protocol=protocol,
        protocol_hash=protocol.hash,
        dataset=DatasetIdentity(
            split=split,
            dataset_hash=plan.dataset_hash,
            plan_hash=plan.hash,
            hidden_truth=None if options.hidden is None else _hash_hidden_truth(plan, inputs),
        ),
        submission=check.manifest,
        submission_hash=check.hash,
        figures=tuple(scorer.figures(plan, outcome.scored, inputs)) if has_metrics else (),
        clusters=compute_clusters(protocol, _list_image_rows(outcome.scored)),
        unavailable=unavailable,
        weights=available.weights,
        versions=list_versions(),
        options=_list_options(inputs),
        warnings=tuple(list_warnings(plan, check.manifest, available.stand_ins)) + _warn_of_device(options.device),
    )
    if _read_scores_hash(out / IMAGES) != outcome.hash:
        write_bytes(out / IMAGES, _encode_image_table(outcome.scored, protocol, outcome.hash))
    write_json(out / RESULT, result)
    return Evaluation(plan, check, result, inputs, outcome.scored, outcome.reused)


def _list_options(inputs: ScoringInputs) -> dict[str, str]:
    """List the options that the figures depend on and the protocol does not state."""
    listed = {"extractor": make_extractor(inputs.extractor).identity} if inputs.protocol.task == _EDITING else {}
    return listed if inputs.device == CPU else {**listed, "device": hardware_name(inputs.device)}


def _warn_of_device(device: str) -> tuple[str, ...]:
    if device == CPU:
        return ()
    return (f"networks ran on {hardware_name(device)}: scores for a board are those of the CPU",)


@dataclass(frozen=True)
class _Availability:
    """Unavailable metrics with their reasons, the stand-ins that are computed, and the hashes of the used weights."""

    unavailable: dict[str, str]
    stand_ins: tuple[str, ...]
    weights: dict[str, str]


def _find_availability(plan: Plan, manifest: SubmissionManifest, options: EvaluationOptions) -> _Availability:
    scorer = load_scorer(plan.protocol.task)
    unavailable = dict(scorer.unavailable(plan, manifest))
    if options.hidden is None:
        unavailable.update({metric_name(metric): _WITHOUT_TRUTH for metric in fidelity_metrics(plan.protocol)})
    without_data = set(unavailable)
    weights: dict[str, str] = {}
    stand_ins: list[str] = []
    for metric, names in scorer.needs(plan).items():
        in_protocol, original = metric in plan.protocol.metric_names, metric.removeprefix(STAND_IN_PREFIX)
        # A metric that lacks more than weights has no stand-in.
        if original in without_data or (not in_protocol and (not options.stand_ins or original not in unavailable)):
            continue
        for name in names:
            if name in options.resolver.paths:
                _require_weights(options.resolver, name)
        try:
            hashes = {name: options.resolver.resolve(name).sha256 for name in names}
        except WeightsUnavailableError as error:
            if in_protocol:
                unavailable[metric] = str(error)
            continue
        if importlib.util.find_spec("torch") is not None:
            weights.update(hashes)
            stand_ins += [] if in_protocol else [metric]
        elif in_protocol:
            unavailable[metric] = f"torch is not installed: {install_command('models')}"
    return _Availability(unavailable, tuple(stand_ins), weights)


def _require_matching_options(plan: Plan, options: EvaluationOptions) -> None:
    """Check that hidden truth, extractor and a model to measure are given only if the protocol uses them."""
    name, use = plan.protocol.name, load_scorer(plan.protocol.task).hidden_use(plan)
    if use == "required" and options.hidden is None:
        raise UsageError(
            f"protocol {name} scores images of moved cameras, which nobody recorded",
            place="--hidden",
            expected="the folder of the organiser's true images",
            remedy="for a synthetic street, `mirror submission hidden` renders them",
        )
    if use == "unused" and options.hidden is not None:
        raise UsageError(
            f"protocol {name} is scored against recorded images and uses no hidden truth",
            place="--hidden",
            expected="no such option",
        )
    if options.extractor is not None:
        if plan.protocol.task != _EDITING:
            raise UsageError(f"protocol {name} extracts no regions", place="--extractor", expected="no such option")
        make_extractor(options.extractor)
    if options.measured is not None:
        if plan.protocol.task != _RUNTIME:
            raise UsageError(
                f"protocol {name} measures no speed", place="--measure", expected="no such option",
                remedy="evaluate with --protocol runtime, or leave --measure out",
            )  # fmt: skip
        if not options.measured[1].is_dir():
            raise UsageError(
                "no such folder", file=options.measured[1], place="--measure", expected="METHOD=MODEL, a trained model",
                remedy="name the folder that `mirror reconstruct` wrote",
            )  # fmt: skip
        # A method that cannot be loaded is said before the work.
        try:
            load_method(options.measured[0])
        except UsageError as error:
            raise UsageError(
                error.problem, file=error.file, place="--measure", expected=error.expected, remedy=error.remedy
            ) from error


def _require_weights(resolver: WeightResolver, name: str) -> None:
    """Raise if an explicitly named weights file is wrong: this is a usage error, not an unavailable metric."""
    try:
        resolver.resolve(name)
    except WeightsUnavailableError as error:
        raise UsageError(error.problem, file=error.file, place=f"--weights {name}", expected=error.expected) from error


def _list_required(names: Sequence[str], protocol: Protocol) -> list[str]:
    """The metrics of a protocol that ``--require`` names."""
    required = []
    for name in names:
        matching = [metric for metric in protocol.metric_names if name in (metric, metric.partition("_")[0])]
        if not matching:
            raise UsageError(
                f"protocol {protocol.name} has no metric {name!r}",
                place="--require",
                expected=f"one of {', '.join(protocol.metric_names)}",
            )
        required += matching
    return required


def _require_available(required: Sequence[str], unavailable: Mapping[str, str]) -> None:
    for metric in required:
        if metric in unavailable:
            raise UsageError(
                f"{metric} is required and unavailable: {unavailable[metric]}",
                place="--require",
                remedy=f"supply what it needs, or leave --require {metric} out",
            )


def _require_recorded_images(dataset: Dataset, jobs: Sequence[Job]) -> None:
    """Raise if a published dataset lacks recorded images that the jobs read."""
    withheld = dataset.catalog.withheld
    if not withheld:
        return
    scored = {(view.traversal_id, view.camera, view.timestamp_ns) for job in jobs if job.truth for view in job.views}
    columns = ["traversal_id", "camera", "timestamp_ns", "uri"]
    for traversal, camera, timestamp, uri in zip(
        *(column.to_pylist() for column in dataset.table("images", columns).columns)
    ):
        if uri in withheld and (traversal, camera, timestamp) in scored:
            raise DatasetError(
                "a published dataset: it lacks the images that the protocol scores",
                file=dataset.root,
                place=f"traversal {traversal}, camera {camera}",
                expected="the complete dataset, which the organiser has",
                remedy="send the submission to the organiser, who scores it with that (docs/benchmark.md)",
            )


def _hash_hidden_truth(plan: Plan, inputs: ScoringInputs) -> str:
    digest = hashlib.sha256()
    for view in plan.views:
        digest.update(f"{view.path} {inputs.truth.image_hash(view)}\n".encode())
    return digest.hexdigest()


def list_warnings(plan: Plan, manifest: SubmissionManifest, stand_ins: Sequence[str]) -> list[str]:
    """List the warnings of a result: empty groups, stand-ins, and a fitted appearance."""
    warnings = [f"group {name} has no views in split {plan.split}" for name in plan.empty_groups]
    for name in stand_ins:
        warnings.append(
            f"{name} stands in for {name.removeprefix(STAND_IN_PREFIX)}: another metric, with figures of its own"
        )
    part = plan.protocol.fitted_part
    if manifest.appearance.policy == "fitted" and part is not None:
        warnings.append(
            f"the method's appearance was fitted to {part} of held-out images; it is not scored in any image"
        )
    return warnings


def _read_scores_hash(path: Path) -> str | None:
    """Read which scores a table of images has; None: there is no whole table.

    A table that has the scores already is not encoded again: that would import pandas, which takes a third of the time
    of a run that finds everything scored.
    """
    try:
        metadata = pq.read_schema(path).metadata
    except (OSError, pa.ArrowInvalid):
        return None
    found = (metadata or {}).get(_SCORES_HASH)
    return None if found is None else found.decode()


def _encode_image_table(scored: Sequence[ScoredJob], protocol: Protocol, scores_hash: str) -> bytes:
    """Encode the table of images, with one row for each image, as Parquet."""
    rows = _list_image_rows(scored)
    names = {name: None for row in rows for name in row}
    columns = {name: [row.get(name) for row in rows] for name in names}
    table = pa.table(columns).replace_schema_metadata(
        {"mirror_protocol_hash": protocol.hash, _SCORES_HASH: scores_hash}
    )
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd", version="2.6")
    return sink.getvalue()


def _list_image_rows(scored: Sequence[ScoredJob]) -> list[dict[str, Any]]:
    """List the rows of the table of images."""
    rows = []
    for scored_job in scored:
        if scored_job.job.in_table:
            view = scored_job.job.views[0]
            fields = {key: getattr(view, key) for key in _ROW_KEYS}
            rows.append({"path": scored_job.job.name, **fields, **scored_job.values})
    return rows


def read_result(path: Path) -> Result:
    """Read a result from its file or from its folder.

    Raises:
        DatasetError: the file does not exist.
        SchemaError: the file is invalid.
    """
    from mirror.schema.files import read_json

    file = path / RESULT if path.is_dir() else path
    if not file.is_file():
        raise DatasetError(
            "no such result", file=file, expected=f"the {RESULT} that `mirror evaluate` wrote, or its folder"
        )
    return read_json(file, Result)
