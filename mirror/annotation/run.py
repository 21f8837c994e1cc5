"""Annotates the frames of a dataset and writes a layer of boxes for each traversal."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from mirror.annotation.journal import Journal
from mirror.annotation.protocol import Annotator
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.index.build import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout, read_manifest
from mirror.dataset.lock import writer_lock
from mirror.errors import DatasetError, MirrorError
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.tables import BOXES

_WORK: Final = ".annotate"


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


@dataclass
class AnnotationReport:
    """What a run did.

    Attributes:
        layer: ``source@version``.
        written: traversals whose layer was written.
        kept: traversals that had the layer already.
        incomplete: traversals without a layer, because frames failed.
        frames: frames annotated in this run.
        resumed: frames taken from an earlier run that was interrupted.
        boxes: boxes in the layers written.
        failed: frames without a result.
    """

    layer: str
    written: list[str] = field(default_factory=list)
    kept: list[str] = field(default_factory=list)
    incomplete: list[str] = field(default_factory=list)
    frames: int = 0
    resumed: int = 0
    boxes: int = 0
    failed: list[FailedFrame] = field(default_factory=list)


def annotate(
    dataset: Dataset,
    annotator: Annotator,
    *,
    source: str | None = None,
    version: str | None = None,
    skip_failed: bool = False,
    progress: ProgressReporter | None = None,
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

    Raises:
        UsageError: the dataset is not local, or the source or version cannot name a layer.
        DatasetError: a layer of this name was made by another annotator, another process writes the dataset, or a
            result cannot be written, such as on a full disk; the same call continues with the results before it.
    """
    progress = progress or NullProgress()
    source, version = source or annotator.name, version or annotator.version
    report = AnnotationReport(f"{source}@{version}")
    layout = dataset.layout
    fingerprint = hashlib.sha256(annotator.fingerprint.encode()).hexdigest()
    work = layout.root / _WORK / f"{report.layer}.{fingerprint[:16]}"
    with writer_lock(layout, wait=False):
        pending = []
        for traversal_id in dataset.traversals():
            if _has_layer(layout, traversal_id, source, version, fingerprint):
                report.kept.append(traversal_id)
            else:
                pending.append(traversal_id)
        progress.start("frames", sum(len(dataset.where(traversal=name).frames()) for name in pending))
        try:
            for traversal_id in pending:
                view = dataset.where(traversal=traversal_id)
                writer = LayerWriter(layout, traversal_id, BOXES.name, source, version)
                rows = _annotate_traversal(view, annotator, work / f"{traversal_id}.jsonl", report, progress)
                if rows is None and not skip_failed:
                    report.incomplete.append(traversal_id)
                    continue
                table = box_table(rows if rows is not None else _finished(work / f"{traversal_id}.jsonl"))
                writer.finish(BOXES, table, {"annotator": fingerprint})
                report.written.append(traversal_id)
                report.boxes += table.num_rows
                (work / f"{traversal_id}.jsonl").unlink(missing_ok=True)
        finally:
            if report.written:
                build_index(layout.root)
            if not report.failed and work.exists() and not any(work.iterdir()):
                shutil.rmtree(work, ignore_errors=True)
    return report


def _annotate_traversal(
    view: Dataset, annotator: Annotator, path: Path, report: AnnotationReport, progress: ProgressReporter
) -> dict[int, list[dict[str, Any]]] | None:
    """The rows of all frames by time; None: a frame failed."""
    journal = Journal(path)
    complete = True
    for frame in view.frames():
        if frame.timestamp_ns in journal.rows:
            report.resumed += 1
        else:
            complete = _annotate_frame(frame, annotator, journal, report, progress) and complete
        progress.advance(1)
    return journal.rows if complete else None


def _annotate_frame(
    frame: Frame, annotator: Annotator, journal: Journal, report: AnnotationReport, progress: ProgressReporter
) -> bool:
    try:
        detections = annotator.annotate(frame)
    except MirrorError as error:
        report.failed.append(FailedFrame(frame.traversal_id, frame.frame_index, str(error)))
        progress.message(f"frame {frame.frame_index} of {frame.traversal_id}: {error}")
        return False
    # A full disk is no failure of the frame: it ends the run.
    journal.add(detections)
    report.frames += 1
    return True


def _finished(path: Path) -> dict[int, list[dict[str, Any]]]:
    return Journal(path).rows


def box_table(frames: dict[int, list[dict[str, Any]]]) -> pa.Table:
    """The rows of a layer of boxes, in the table's order; boxes without a track id get one of their own.

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


def _has_layer(layout: Layout, traversal_id: str, source: str, version: str, fingerprint: str) -> bool:
    folder = layout.layer(traversal_id, BOXES.name, source, version)
    manifest = read_manifest(folder)
    if manifest is None:
        return False
    if manifest.derived_from.get("annotator") != fingerprint:
        raise DatasetError(
            "the layer was made by another annotator, by other settings, or by a person; no layer is replaced",
            file=folder,
            expected="the same annotator, weights and settings",
            remedy="give the new layer another version: --version NAME",
        )
    return True
