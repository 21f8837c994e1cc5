"""A whole ingest: judge all drives, write all accepted passes, seal each drive, derive the index.

What makes it safe to stop at any instant: a traversal exists once its manifest does, a drive once its own does, and
the index is derived from complete drives alone. A second run finds what is complete by its fingerprints and does the
rest. Drives and traversals run in parallel on threads: the work is in compiled kernels, the file system and hashing,
all of which release the interpreter.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from mirror.dataset.index import build_index
from mirror.dataset.layout import Layout, complete_manifest, is_intact
from mirror.dataset.lock import writer_lock
from mirror.errors import DatasetError, MirrorError, RecordingError, UsageError
from mirror.ingest.drive import refuse_other_rig, seal_drive, traversals_intact, verify_source
from mirror.ingest.judge import JudgedDrive, fingerprint, judge_drive
from mirror.ingest.replace import set_aside, settle
from mirror.ingest.request import IngestOptions, IngestReport, thresholds
from mirror.ingest.rois import merge_rois, read_rois, write_rois
from mirror.ingest.traversal import Written, selected_pictures, traversal_id, write_traversal
from mirror.ingest.trigger import Trigger
from mirror.progress import NullProgress, ProgressReporter
from mirror.recordings.boundary import reader_errors
from mirror.recordings.protocol import Recording
from mirror.recordings.registry import open_recording
from mirror.recordings.weather import weather_plugins
from mirror.schema.documents import (
    CleaningOptions,
    DatasetDocument,
    DriveDocument,
    Rig,
    Roi,
    Source,
    TriggerOptions,
    is_identifier,
)
from mirror.schema.files import read_json, unwritable, write_json
from mirror.schema.version import SCHEMA_VERSION

Result = TypeVar("Result")

_FATAL = (UsageError, DatasetError)
"""What is not one recording's fault, and would meet the next one too."""


@dataclass(frozen=True)
class _Opened:
    path: Path
    recording: Recording
    source: Source


class _Run:
    def __init__(self, layout: Layout, options: IngestOptions, progress: ProgressReporter) -> None:
        self.layout = layout
        self.options = options
        self.progress = progress
        self.report = IngestReport()

    def fail(self, path: Path, error: MirrorError) -> None:
        if self.options.fail_fast or isinstance(error, _FATAL):
            raise error
        self.report.failures.append((path, error))


def ingest(
    recordings: Sequence[Path],
    rois: Sequence[Roi],
    out: Path,
    options: IngestOptions | None = None,
    progress: ProgressReporter | None = None,
) -> IngestReport:
    """Ingest recordings into a dataset.

    Args:
        recordings: one path a drive.
        rois: scenes to cut out, added to those that the dataset has.
        out: the dataset's folder, made if need be.
        options: what and how.
        progress: told of every step.

    Returns:
        What was done. Recordings that cannot be ingested are in its ``failures`` and leave no trace.

    Raises:
        UsageError: no ROI, or ROIs or options that cannot be meant.
        DatasetError: the dataset is locked, has other thresholds, or cannot be written.
        MirrorError: with ``fail_fast``, whatever the first bad recording has.
    """
    run = _Run(Layout(out), options or IngestOptions(), progress or NullProgress())
    if run.options.workers < 1:
        raise UsageError(f"{run.options.workers} workers", expected="at least one")
    if run.options.weather_plugin is not None and run.options.weather_plugin not in weather_plugins():
        raise UsageError(
            f"no weather plug-in is named {run.options.weather_plugin!r}",
            expected=f"one of {', '.join(weather_plugins()) or '(none is installed)'}",
            remedy="install the package that declares it",
        )
    if run.options.dry_run:
        _judge_all(run, recordings, *_settings(run, rois))
        return run.report
    if not rois and not run.layout.document.exists():
        raise _no_roi()
    _refuse_recording_as_dataset(recordings, out)
    with writer_lock(run.layout, wait=run.options.wait):
        settle(run.layout)
        try:
            _ingest(run, recordings, rois)
        except OSError as error:
            # Files are written through functions that say so themselves; what is left are folders.
            raise unwritable(Path(error.filename or out), error) from error
        finally:
            settle(run.layout)
        if run.layout.document.exists():
            build_index(run.layout.root)
    return run.report


def _refuse_recording_as_dataset(recordings: Sequence[Path], out: Path) -> None:
    for path in recordings:
        if out.resolve().is_relative_to(path.resolve()):
            raise UsageError(
                "the dataset would lie inside a recording",
                file=out,
                expected="a folder outside of every recording: recordings are never changed",
                remedy="give another --out",
            )


def _no_roi() -> UsageError:
    return UsageError("no ROI given", expected="--rois FILE or --roi lon,lat", remedy="see `mirror rois propose`")


def _ingest(run: _Run, recordings: Sequence[Path], rois: Sequence[Roi]) -> None:
    document, all_rois = _settings(run, rois)
    configuration = _configuration(document, run.options)
    judged = _judge_all(run, recordings, document, all_rois)
    written = _write_all(run, judged, {roi.scene_id: roi for roi in all_rois}, configuration)
    if written:
        write_json(run.layout.document, document)
        write_rois(run.layout.rois, all_rois)
    for drive in written:
        try:
            seal_drive(run.layout, drive, [roi.scene_id for roi in all_rois], configuration, run.options.weather_plugin)
        except MirrorError as error:
            del run.report.drives[drive.info.drive_id]
            run.fail(drive.path, error)


def _settings(run: _Run, rois: Sequence[Roi]) -> tuple[DatasetDocument, list[Roi]]:
    """The dataset's document and ROIs, with what this run adds; refuses what contradicts them."""
    given_trigger, given_cleaning = dict(run.options.trigger), dict(run.options.cleaning)
    if not run.layout.document.exists():
        document = DatasetDocument(
            licence=run.options.licence,
            trigger=thresholds(TriggerOptions, given_trigger),
            cleaning=thresholds(CleaningOptions, given_cleaning),
        )
        present: list[Roi] = []
    else:
        document = read_json(run.layout.document, DatasetDocument)
        for given, own in ((given_trigger, document.trigger), (given_cleaning, document.cleaning)):
            for name, value in given.items():
                if getattr(own, name) != value:
                    raise DatasetError(
                        f"{name} {value} differs from the dataset's {getattr(own, name)}",
                        file=run.layout.document,
                        expected="one set of thresholds for all passes of a dataset",
                        remedy=f"leave {name} away, or ingest everything into a new folder",
                    )
        if run.options.licence not in (None, document.licence):
            raise DatasetError(
                f"licence {run.options.licence!r} differs from the dataset's {document.licence!r}",
                file=run.layout.document,
                remedy="leave --licence away, or ingest into a new folder",
            )
        present = read_rois(run.layout.rois) if run.layout.rois.exists() else []
    merged = merge_rois(present, rois, run.layout.rois)
    if not merged:
        raise _no_roi()
    return document, merged


def _configuration(document: DatasetDocument, options: IngestOptions) -> str:
    decisive = {
        "schema_version": SCHEMA_VERSION,
        "trigger": document.trigger.model_dump(mode="json"),
        "cleaning": document.cleaning.model_dump(mode="json"),
        "reader": options.reader,
        "reader_options": dict(options.reader_options),
        "hashing": options.write.hashing,
        "weather_plugin": options.weather_plugin,
    }
    return hashlib.sha256(json.dumps(decisive, sort_keys=True).encode()).hexdigest()


def _judge_all(
    run: _Run, recordings: Sequence[Path], document: DatasetDocument, rois: Sequence[Roi]
) -> list[JudgedDrive]:
    """Open, identify and judge every recording; those already complete are passed over."""
    trigger = Trigger(rois, document.trigger, document.cleaning)
    configuration = _configuration(document, run.options)
    scenes = {roi.scene_id for roi in rois}
    run.progress.start("reading poses", len(recordings))

    def open_one(path: Path) -> _Opened:
        with reader_errors(path):
            recording = open_recording(path, reader=run.options.reader, options=run.options.reader_options)
            drive_id = recording.info.drive_id
        for name, value in (("drive_id", drive_id), ("vehicle_id", recording.info.vehicle_id)):
            if not is_identifier(value):
                raise RecordingError(f"{name} {value!r} is not an id", file=path, expected="letters, digits, _ and -")
        reader = run.options.reader or type(recording).__module__.rpartition(".")[2]
        with reader_errors(path):
            return _Opened(path, recording, fingerprint(recording, reader, path.resolve().name))

    def judge_one(opened: _Opened) -> JudgedDrive:
        judged = judge_drive(opened.path, opened.recording, opened.source, trigger, rois, document.cleaning)
        run.progress.advance(1)
        return judged

    opened = _in_parallel(run, [(path, partial(open_one, path)) for path in recordings])
    todo = []
    owners: dict[str, Path] = {}
    for one in opened:
        drive_id = one.recording.info.drive_id
        if drive_id in owners:
            run.fail(
                one.path,
                RecordingError(
                    f"drive id {drive_id!r} is also that of {owners[drive_id]}",
                    file=one.path,
                    expected="one recording a drive id",
                    remedy="give one of them another id; ingest the files of one drive as one recording",
                ),
            )
            continue
        owners[drive_id] = one.path
        try:
            unchanged = _is_unchanged(run, one, configuration, scenes)
        except MirrorError as error:
            run.fail(one.path, error)
            continue
        if unchanged and not run.options.dry_run:
            run.report.unchanged.append(drive_id)
            run.progress.advance(1)
        else:
            todo.append(one)
    judged = _in_parallel(run, [(one.path, partial(judge_one, one)) for one in todo])
    for drive in judged:
        run.report.drives[drive.info.drive_id] = drive
    return judged


def _is_unchanged(run: _Run, opened: _Opened, configuration: str, scenes: set[str]) -> bool:
    """Whether the drive is complete in the dataset as its recording is now.

    Raises:
        RecordingError: the id belongs to another recording, or to this one before it changed.
    """
    folder = run.layout.drive(opened.recording.info.drive_id)
    if run.options.replace or not is_intact(folder):
        return False
    document = read_json(folder / "drive.json", DriveDocument)
    if not _same_source(run, document.drive_id, opened.source, configuration):
        if run.options.dry_run:
            return False
        changed = "its files have changed" if document.source.name == opened.source.name else "another recording has it"
        if document.source.fingerprint == opened.source.fingerprint:
            changed = "it was ingested with other options"
        raise RecordingError(
            f"drive {document.drive_id!r} is in the dataset already, and {changed}",
            file=opened.path,
            expected=f"the recording {document.source.name!r} as it was",
            remedy="give the recording another drive id, or add --replace to ingest it anew",
        )
    if run.options.verify:
        verify_source(run.layout, opened.recording, document.drive_id)
    return set(document.scenes) >= scenes and traversals_intact(run.layout, document.drive_id)


def _same_source(run: _Run, drive_id: str, source: Source, configuration: str) -> bool:
    """Whether a complete drive of the dataset was made of just this, with just these options; True if there is none."""
    manifest = complete_manifest(run.layout.drive(drive_id))
    if manifest is None:
        return True
    made_from = {"source": source.fingerprint, "configuration": configuration}
    return made_from.items() <= manifest.derived_from.items()


def _write_all(
    run: _Run, judged: Sequence[JudgedDrive], rois: Mapping[str, Roi], configuration: str
) -> list[JudgedDrive]:
    """Write all accepted passes of all drives; return the drives of which every one succeeded."""
    jobs: list[tuple[JudgedDrive, int]] = []
    complete: list[JudgedDrive] = []
    rigs: dict[str, Rig] = {}
    total = 0
    for drive in judged:
        try:
            with reader_errors(drive.path):
                refuse_other_rig(run.layout, drive, rigs)
            for number in drive.slices:
                pictures = selected_pictures(drive, number).values()
                total += sum(len(indices) for _, indices, _ in pictures)
        except MirrorError as error:
            run.fail(drive.path, error)
            del run.report.drives[drive.info.drive_id]
            continue
        if run.options.replace or not _same_source(run, drive.info.drive_id, drive.source, configuration):
            set_aside(run.layout, drive.info.drive_id)
        complete.append(drive)
        jobs += [(drive, number) for number in drive.slices]
    run.progress.start("writing pictures", total)
    # Few passes and many workers: the cameras of a pass are written side by side.
    threads = max(1, run.options.workers // max(1, len(jobs)))
    failed: set[str] = set()
    lock = threading.Lock()

    def write_one(drive: JudgedDrive, number: int) -> Written | None:
        if drive.info.drive_id in failed:
            return None
        try:
            return write_traversal(
                run.layout,
                drive,
                number,
                rois[drive.passes[number].scene_id],
                configuration,
                run.options.write,
                threads,
                run.progress.advance,
            )
        except MirrorError as error:
            with lock:
                first = drive.info.drive_id not in failed
                failed.add(drive.info.drive_id)
            if first or isinstance(error, _FATAL):
                raise
            return None

    written = _in_parallel(run, [(drive.path, partial(write_one, drive, number)) for drive, number in jobs])
    for drive in [drive for drive in complete if drive.info.drive_id in failed]:
        for number in drive.slices:
            name = traversal_id(drive.info.drive_id, drive.passes[number])
            if complete_manifest(run.layout.drive(drive.info.drive_id)) is None:
                shutil.rmtree(run.layout.traversal(name), ignore_errors=True)
        complete.remove(drive)
        del run.report.drives[drive.info.drive_id]
    run.report.traversals = sorted(
        (one for one in written if one is not None and one.traversal_id.split(".")[1] not in failed),
        key=lambda one: one.traversal_id,
    )
    return complete


def _in_parallel(run: _Run, jobs: Sequence[tuple[Path, Callable[[], Result]]]) -> list[Result]:
    """Results in the order of the jobs; those that fail are reported against their path."""
    results: list[Result] = []
    with ThreadPoolExecutor(max_workers=max(1, run.options.workers)) as pool:
        futures: list[tuple[Path, Future[Result]]] = [(path, pool.submit(job)) for path, job in jobs]
        try:
            for path, future in futures:
                try:
                    results.append(future.result())
                except MirrorError as error:
                    run.fail(path, error)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return results
