"""Annotates the frames of a dataset and writes a layer of boxes for each traversal."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa

from mirror.annotation.detections import Detections
from mirror.annotation.familiarity import NAME, TrainingData
from mirror.annotation.protocol import Annotator
from mirror.annotation.registry import AnnotatorChoice
from mirror.dataset import open as open_dataset
from mirror.dataset.content_hashes import ContentHashes
from mirror.dataset.dataset import Dataset
from mirror.dataset.derived_layer import DerivedLayer, find_missing
from mirror.dataset.frames import Frame
from mirror.dataset.layer_writer import require_layer_name
from mirror.dataset.layers import LayerChoice
from mirror.dataset.layout import Layout
from mirror.dataset.unfinished_work import ANNOTATION, remove_work, work_folder
from mirror.dataset.writing import writing_layers
from mirror.errors import DatasetError, MirrorError, UsageError
from mirror.executors.choice import ExecutorChoice
from mirror.executors.job import Failure, ParallelJob
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.finished_work import FinishedWork
from mirror.schema.tables import BOXES


@dataclass(frozen=True)
class FailedFrame:
    """A frame without a result.

    Attributes:
        traversal_id: its traversal.
        frame_index: its number there.
        reason: the error.
    """

    traversal_id: str
    frame_index: int
    reason: str


@dataclass(frozen=True)
class _FrameResult:
    """The boxes of a frame as rows, and whether its images look unlike those that the annotator was trained on."""

    boxes: list[dict[str, Any]]
    unfamiliar: bool

    @classmethod
    def decode(cls, plain: Any) -> _FrameResult:
        """Make a result of its JSON values; an earlier version wrote the boxes alone."""
        return cls(plain, False) if isinstance(plain, list) else cls(list(plain["boxes"]), bool(plain["unfamiliar"]))


@dataclass
class AnnotationReport:
    """The result of a run of an annotator over a dataset.

    Attributes:
        layer: ``source@version``.
        written: traversals whose layer was written.
        kept: traversals that had the layer already.
        incomplete: traversals without a layer, because frames failed.
        frames: frames annotated in this run.
        resumed: frames taken from an earlier run that was interrupted.
        boxes: boxes in the layers written.
        failed: frames without a result.
        trained_on: what the annotator was trained on; None: it does not state it.
        unfamiliar: frames of the layers written whose images do not look like those that it was trained on.
        broken: why workers ended without a result, by traversal.
    """

    layer: str
    written: list[str] = field(default_factory=list)
    kept: list[str] = field(default_factory=list)
    incomplete: list[str] = field(default_factory=list)
    frames: int = 0
    resumed: int = 0
    boxes: int = 0
    failed: list[FailedFrame] = field(default_factory=list)
    trained_on: str | None = None
    unfamiliar: int = 0
    broken: dict[str, str] = field(default_factory=dict)

    def add(self, one: AnnotationReport) -> None:
        """Add the results of another traversal."""
        for name in ("written", "incomplete", "failed"):
            getattr(self, name).extend(getattr(one, name))
        for name in ("frames", "resumed", "boxes", "unfamiliar"):
            setattr(self, name, getattr(self, name) + getattr(one, name))


@dataclass(frozen=True)
class _LayerTask:
    """The making of one traversal's layer, but for the annotator."""

    layer: DerivedLayer
    work: Path
    skip_failed: bool


def annotate(
    dataset: Dataset,
    annotator: Annotator,
    *,
    source: str | None = None,
    version: str | None = None,
    skip_failed: bool = False,
    progress: ProgressReporter | None = None,
    executor: ExecutorChoice | None = None,
    choice: AnnotatorChoice | None = None,
) -> AnnotationReport:
    """Annotate all frames of a view, and write one layer of boxes for each traversal.

    A layer that exists is kept. Frames that fail are reported; their traversal gets no layer, its other results are
    kept in a work folder of the dataset, and the same call continues there.

    Args:
        dataset: a local dataset, or a view of whole traversals of it.
        annotator: finds the boxes.
        source: source of the layers; None: the annotator's name.
        version: version of the source; None: the annotator's.
        skip_failed: write a layer also where frames failed; they have no boxes then.
        progress: receives the number of frames.
        executor: where traversals are annotated, one a worker at a time; None: in this process.
        choice: opens the annotator in a worker; it is needed with `executor`.

    Raises:
        UsageError: the dataset is not local, the source or version cannot name a layer, or there is an executor
            without a choice.
        DatasetError: a layer of this name was made by another annotator, another process writes the dataset, or a
            result cannot be written, such as on a full disk; the same call continues with the results before it.
    """
    progress = progress or NullProgress()
    source, version = source or annotator.name, version or annotator.version
    require_layer_name(source, version)
    report = AnnotationReport(f"{source}@{version}", trained_on=getattr(annotator, "trained_on", None))
    layout = dataset.layout
    fingerprint = hashlib.sha256(annotator.fingerprint.encode()).hexdigest()
    inputs, described = {"annotator": fingerprint}, "the same annotator, settings and recorded images"
    work = work_folder(layout, ANNOTATION, report.layer, fingerprint)
    hashes = ContentHashes(dataset.store)
    with writing_layers(layout):
        layers = {
            name: DerivedLayer(layout, name, BOXES.name, source, version, inputs, described)
            for name in dataset.traversals()
        }
        pending, report.kept = find_missing(layers.values())
        progress.start("frames", sum(len(dataset.where(traversal=name).frames()) for name in pending))
        tasks = [_LayerTask(layers[name], work, skip_failed) for name in pending]
        if executor is None:
            for task in tasks:
                report.add(_annotate_traversal(dataset, annotator, task, hashes, progress))
        elif choice is None:
            raise UsageError("an executor without a choice of an annotator", expected="one that workers can open")
        else:
            _annotate_on_workers(dataset, annotator.fingerprint, choice, tasks, executor, report, progress)
        if not report.failed and not report.broken:
            remove_work(work)
    return report


def _annotate_traversal(
    dataset: Dataset, annotator: Annotator, task: _LayerTask, hashes: ContentHashes, progress: ProgressReporter
) -> AnnotationReport:
    """Annotate one traversal, and write its layer unless frames failed."""
    traversal_id, source, version = task.layer.traversal_id, task.layer.source, task.layer.version
    report = AnnotationReport(f"{source}@{version}", trained_on=getattr(annotator, "trained_on", None))
    view = dataset.where(traversal=traversal_id)
    writer = task.layer.open()
    file = task.work / f"{traversal_id}.jsonl"
    found = _annotate_frames(view, annotator, file, hashes, report, progress)
    if len(found) < len(view.frames()) and not task.skip_failed:
        report.incomplete.append(traversal_id)
        return report
    table = box_table({stamp: one.boxes for stamp, one in found.items()})
    if report.trained_on is not None:
        unfamiliar = tuple(sorted(stamp for stamp, one in found.items() if one.unfamiliar))
        data = TrainingData(trained_on=report.trained_on, frames=len(found), unfamiliar_ns=unfamiliar)
        writer.document(NAME, data.encode())
        report.unfamiliar += len(unfamiliar)
    writer.finish(BOXES, table)
    report.written.append(traversal_id)
    report.boxes += table.num_rows
    file.unlink(missing_ok=True)
    return report


@dataclass(frozen=True)
class _AnnotatorSettings:
    """The dataset and the annotator that a worker opens once."""

    root: str
    layers: LayerChoice
    traversals: tuple[str, ...]
    choice: AnnotatorChoice
    fingerprint: str


def _annotate_on_workers(
    dataset: Dataset,
    fingerprint: str,
    choice: AnnotatorChoice,
    tasks: Sequence[_LayerTask],
    executor: ExecutorChoice,
    report: AnnotationReport,
    progress: ProgressReporter,
) -> None:
    root = str(Path(dataset.root).absolute())
    settings = _AnnotatorSettings(root, dataset.layers, tuple(dataset.traversals()), choice, fingerprint)
    placed = [
        replace(task, layer=replace(task.layer, layout=Layout(Path(root))), work=task.work.absolute()) for task in tasks
    ]
    with executor.open() as workers:
        for number, answer in workers.map(ParallelJob(_make_annotation, (settings,)), placed):
            name = tasks[number].layer.traversal_id
            if not isinstance(answer, Failure):
                report.add(answer)
            elif isinstance(answer.error, MirrorError):
                raise answer.error
            else:
                report.broken[name] = f"{answer.problem} ({answer.attempts} attempts)"
                report.incomplete.append(name)
            progress.advance(len(dataset.where(traversal=name).frames()))
    for name in ("written", "incomplete"):
        getattr(report, name).sort()
    report.failed.sort(key=lambda one: (one.traversal_id, one.frame_index))


def _make_annotation(settings: _AnnotatorSettings) -> Callable[[_LayerTask], AnnotationReport]:
    dataset = open_dataset(settings.root).with_layers(**asdict(settings.layers))
    dataset = dataset.where(traversal=list(settings.traversals))
    annotator, hashes = settings.choice.open(dataset), ContentHashes(dataset.store)
    if annotator.fingerprint != settings.fingerprint:
        raise DatasetError(
            f"annotator {settings.choice.name} is another one on a node", place="--executor",
            expected="the same weights, settings and files wherever it runs", remedy="bring the node up to date",
        )  # fmt: skip
    return lambda task: _annotate_traversal(dataset, annotator, task, hashes, NullProgress())


def _annotate_frames(
    view: Dataset,
    annotator: Annotator,
    file: Path,
    hashes: ContentHashes,
    report: AnnotationReport,
    progress: ProgressReporter,
) -> dict[int, _FrameResult]:
    """Find the boxes of all frames of one traversal.

    Returns:
        Results by time of the frame, without the frames that failed.
    """
    finished = FinishedWork(file, _FrameResult.decode)
    conditions = hashes.view(view)
    reads_images = getattr(annotator, "reads_images", True)
    results = {}
    for frame in view.frames():
        hash_frame = partial(hashes.frame, frame, conditions, images=reads_images)
        result = finished.find(str(frame.timestamp_ns), hash_frame)
        if result is not None:
            report.resumed += 1
        elif (detections := _annotate_frame(frame, annotator, report, progress)) is not None:
            result = _FrameResult(detections.to_rows(), detections.unfamiliar)
            # A full disk is no failure of the frame: it ends the run.
            finished.add(str(frame.timestamp_ns), hash_frame(), asdict(result), result)
            report.frames += 1
        if result is not None:
            results[frame.timestamp_ns] = result
        progress.advance(1)
    return results


def _annotate_frame(
    frame: Frame, annotator: Annotator, report: AnnotationReport, progress: ProgressReporter
) -> Detections | None:
    try:
        return annotator.annotate(frame)
    except MirrorError as error:
        report.failed.append(FailedFrame(frame.traversal_id, frame.frame_index, str(error)))
        progress.message(f"frame {frame.frame_index} of {frame.traversal_id}: {error}")
        return None


def box_table(frames: dict[int, list[dict[str, Any]]]) -> pa.Table:
    """Return the rows of a layer of boxes, in the table's order; boxes without a track id get a new id each.

    Args:
        frames: rows of `Detections.to_rows` by time.
    """
    rows = []
    for timestamp_ns, boxes in frames.items():
        for number, box in enumerate(boxes):
            track_id = box["track_id"] or f"{timestamp_ns}-{number:03d}"
            rows.append({"timestamp_ns": timestamp_ns, **box, "track_id": track_id})
    rows.sort(key=lambda row: tuple(row[key] for key in BOXES.sorted_by))
    return _to_table(rows)


def _to_table(rows: Sequence[dict[str, Any]]) -> pa.Table:
    schema = pa.schema([item for item in BOXES.schema if item.name not in ("source", "source_version")])
    return pa.Table.from_pylist(list(rows), schema=schema)
