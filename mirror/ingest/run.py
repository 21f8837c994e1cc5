"""A whole ingest: drive by drive judged and written, all committed at the end, and a snapshot of the index put last.

What makes it safe to stop at any instant: a run writes in a folder of its own (`Staging`), where a traversal exists
once its manifest does; drives are committed at the end, file by file, each name once and its manifest last, and the
index is derived from complete drives alone. A second run finds what is complete by its fingerprints and does the rest.

A run that only adds drives to scenes that the dataset has holds no lock: any number of them may run at a time. A run
that makes a dataset, adds scenes or maps, or replaces drives holds the writer lock.

Drives and traversals run in parallel on threads: the work is in compiled kernels, the file system and hashing, all of
which release the interpreter. At most two drives a worker are on their way at a time, and nothing that grows with a
drive's poses is kept after it, so that memory does not grow with the number of drives.
"""

from __future__ import annotations

import os
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from mirror.dataset.destination import BucketDestination, Destination, destination_at
from mirror.dataset.generation import FOLDER as SUPERSEDED
from mirror.dataset.generation import recover
from mirror.dataset.index import append_drives, build_index
from mirror.dataset.layout import Layout
from mirror.dataset.lock import adding, replacing, writer_lock
from mirror.dataset.store import Store
from mirror.errors import DatasetError, MirrorError, UsageError
from mirror.executors.choice import ExecutorChoice
from mirror.ingest.bucket import BucketStaging, commit_plan, fetch_plan, refuse_options_of_folders
from mirror.ingest.dead_letters import list_dead_letters, read_dead_letters, write_dead_letters
from mirror.ingest.drive import refuse_conflicting_rig, refuse_owned_id, seal_drive, uncalibrated_cameras
from mirror.ingest.jobs import WorkersRun, remove_dead_folders
from mirror.ingest.known_drives import KnownDrives
from mirror.ingest.maps import add_maps, judge_maps, read_given_maps
from mirror.ingest.passes import DrivePasses
from mirror.ingest.prepare import PreparedDrive, prepare
from mirror.ingest.request import DriveReport, IngestOptions, IngestReport
from mirror.ingest.rois import read_rois, write_rois
from mirror.ingest.settings import IngestSettings, merge_settings, missing_roi_error
from mirror.ingest.staging import Staging
from mirror.ingest.traversal import WriteReport, write_traversal
from mirror.progress import NullProgress, ProgressReporter
from mirror.recordings.boundary import reader_errors
from mirror.recordings.weather import CLASSIFIERS
from mirror.schema.documents import Rig, Roi
from mirror.schema.files import unwritable_error, write_json
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.schema.links import refuse_links_out

Result = TypeVar("Result")

_FATAL = (UsageError, DatasetError)
"""Errors that are not one recording's fault, and would meet the next one too."""


class _StoppedError(BaseException):
    """Ends a job whose run has ended, past all that takes the errors of a recording."""


def ingest_recordings(
    recordings: Sequence[Path],
    rois: Sequence[Roi],
    out: Path | str,
    options: IngestOptions | None = None,
    progress: ProgressReporter | None = None,
) -> IngestReport:
    """Cut the passes of recorded drives through regions of interest (ROIs) into a dataset.

    Each recording is one drive. Its poses are cleaned, and the ROI trigger finds its passes (docs/trigger.md). Each
    accepted pass becomes a traversal with its images, poses and calibrations; the drive's ledger lists accepted and
    refused passes with their figures. The dataset changes only at the end: every complete drive is committed to it,
    then a snapshot of its index is put. Running the same call again after an interruption does what is missing. Drives
    that the dataset has unchanged are skipped.

    Args:
        recordings: one path per drive, in any format that a recording reader recognises.
        rois: scenes to cut out: circles with a centre (degrees, or metres in a local frame) and a radius in metres.
            They are added to those of an existing dataset, which may make this list empty.
        out: the dataset's folder, which is made if it does not exist; or ``s3://BUCKET/PATH``.
        options: reader, thresholds, workers and how files are written; None: the defaults.
        progress: receives the number of drives and images done; None: nothing is reported.

    Returns:
        The drives, passes and traversals of this run. A recording that cannot be ingested is listed in ``failures``
        with its error and adds nothing to the dataset but a row of ``failures/``, which ``retry_failed`` reads.

    Raises:
        UsageError: there is no ROI, a ROI or an option is invalid, a road map is of another scene, the folder holds
            something other than a dataset, or the URL is that of a store that is not written.
        DatasetError: another process writes the dataset and this run does more than add drives, its thresholds differ,
            another process committed other bytes under the same name, or it cannot be written.
        SchemaError: a road map is broken.
        MirrorError: the error of the first bad recording, with ``fail_fast``; the dataset is unchanged then.

    Example::

        import mirror
        from mirror.ingest.rois import read_rois

        report = mirror.ingest_recordings([Path("drive_1")], read_rois(Path("rois.geojson")), Path("dataset"))
        print(len(report.traversals), "traversals,", len(report.failures), "recordings failed")
    """
    options, progress = options or IngestOptions(), progress or NullProgress()
    if "://" in str(out) or "::" in str(out):
        return _ingest_into_bucket(recordings, rois, destination_at(out), _checked(options), progress)
    out = Path(out)
    failed = {file: {one.recording for one in read_dead_letters([file])} for file in list_dead_letters(out)}
    given = {str(path.absolute()) for path in recordings}
    again = sorted(set().union(*failed.values()) - given) if options.retry_failed else []
    recordings = [*recordings, *map(Path, again)]
    retried = [file for file, names in failed.items() if names <= given.union(again)]
    report = _ingest_into_folder(recordings, rois, out, _checked(options), progress)
    if not options.dry_run and Layout(out).document.exists():
        write_dead_letters(out, report.dead_letters, retried)
    return report


def _checked(options: IngestOptions) -> IngestOptions:
    if options.workers < 1:
        raise UsageError(f"{options.workers} workers", expected="at least one")
    if options.weather_plugin is not None:
        CLASSIFIERS.find(options.weather_plugin)
    return options


def _ingest_into_folder(
    recordings: Sequence[Path], rois: Sequence[Roi], out: Path, options: IngestOptions, progress: ProgressReporter
) -> IngestReport:
    """Cut recordings into a dataset in a folder; see `ingest_recordings`."""
    layout = Layout(out)
    if options.dry_run:
        run = _Run(layout, options, progress, merge_settings(layout, options, rois))
        judge_maps(layout, read_given_maps(options.maps, run.settings.rois), replace=options.replace)
        if options.executor is None:
            run.work(recordings)
        else:
            _work_by_jobs(run, recordings, options.executor)
        return run.report
    _refuse_recording_as_dataset(recordings, out)
    require_output_folder(out, FolderKind.DATASET)
    if not rois and not layout.document.exists():
        raise missing_roi_error()
    try:
        if _only_adds(layout, options, rois):
            refuse_links_out(layout.root)
            run = _Run(layout, options, progress, merge_settings(layout, options, rois))
            if options.executor is None:
                _add(run, recordings)
            else:
                _add_by_jobs(run, recordings, options.executor)
            return run.report
        with writer_lock(layout, wait=options.wait):
            try:
                recover(layout)
                run = _Run(layout, options, progress, merge_settings(layout, options, rois))
                _write(run, recordings)
            finally:
                recover(layout)
                # Ctrl-C and errors, too, leave an index of the drives that are complete.
                if layout.document.exists():
                    build_index(layout.root)
    except OSError as error:
        # Files are written through functions that say so themselves; what is left are folders.
        raise unwritable_error(Path(error.filename or out), error) from error
    return run.report


def _ingest_into_bucket(
    recordings: Sequence[Path],
    rois: Sequence[Roi],
    destination: Destination,
    options: IngestOptions,
    progress: ProgressReporter,
) -> IngestReport:
    """Cut recordings into a dataset in a bucket; see `ingest_recordings`."""
    if not isinstance(destination, BucketDestination):
        raise UsageError("not a bucket", file=destination.store.root, expected="s3://BUCKET/PATH")
    refuse_options_of_folders(options, destination.url)
    with tempfile.TemporaryDirectory(prefix="mirror-ingest-") as folder:
        scratch = Layout(Path(folder))
        fetch_plan(destination, scratch)
        if not rois and not scratch.document.exists():
            raise missing_roi_error()
        settings = merge_settings(scratch, options, rois)
        known = KnownDrives.read(destination.store) if scratch.document.exists() else KnownDrives()
        run = _Run(scratch, options, progress, settings, known)
        if options.dry_run:
            run.work(recordings)
            return run.report
        commit_plan(destination, settings, scratch)
        staging = BucketStaging(scratch, destination)
        run.work(recordings, staging)
        run.report.licence = settings.document.licence
        staging.append()
    return run.report


def _only_adds(layout: Layout, options: IngestOptions, rois: Sequence[Roi]) -> bool:
    """Return whether a run can only add drives, to scenes that the dataset has."""
    if options.replace or options.maps or not layout.document.exists() or not layout.rois.exists():
        return False
    if (layout.root / SUPERSEDED).exists() or not layout.snapshots.is_dir():
        # A run that replaced files was interrupted, or what it replaced is to be removed once nobody reads it.
        return False
    return merge_settings(layout, options, rois).rois == tuple(read_rois(layout.rois))


def _add(run: _Run, recordings: Sequence[Path]) -> None:
    """Add drives, without a lock; where what is there was damaged, it is replaced, with the lock."""
    staging = Staging(run.layout)
    done = False
    try:
        run.work(recordings, staging)
        if run.report.drives:
            run.report.licence = run.settings.document.licence
        with adding(run.layout):
            damaged = staging.find_present()
            if not damaged:
                append_drives(run.layout, staging.commit(), run.report.unchanged)
        if damaged:
            with writer_lock(run.layout, wait=run.options.wait):
                recover(run.layout)
                _publish(run.layout, staging)
                build_index(run.layout.root)
        done = True
    finally:
        staging.close(done=done)


def _publish(layout: Layout, staging: Staging) -> None:
    with replacing(layout):
        staging.publish()


def _refuse_recording_as_dataset(recordings: Sequence[Path], out: Path) -> None:
    for path in recordings:
        # Unlike `Path.resolve`, `realpath` accepts a circle of links: opening the recording reports it.
        if Path(os.path.realpath(out)).is_relative_to(os.path.realpath(path)):
            raise UsageError(
                "the dataset would lie inside a recording",
                file=out,
                expected="a folder outside of every recording: recordings are never changed",
                remedy="give another --out",
            )


def _write(run: _Run, recordings: Sequence[Path]) -> None:
    maps = read_given_maps(run.options.maps, run.settings.rois)
    outcomes = judge_maps(run.layout, maps, replace=run.options.replace)
    if run.options.executor is None:
        _write_drives(run, recordings)
    else:
        _work_by_jobs(run, recordings, run.options.executor)
    if maps and run.layout.document.exists():
        # A scene that only a map was given for is a scene of the dataset too.
        write_rois(run.layout.rois, run.settings.rois)
        add_maps(run.layout, maps, outcomes)
        run.report.maps.update(outcomes)


def _write_drives(run: _Run, recordings: Sequence[Path]) -> None:
    staging = Staging(run.layout)
    done = False
    try:
        run.work(recordings, staging)
        if run.report.drives:
            document = run.settings.document
            if not run.layout.document.exists() and document.licence is None:
                document = document.model_copy(update={"licence": run.report.common_licence})
            run.report.licence = document.licence
            write_json(run.layout.document, document)
            write_rois(run.layout.rois, run.settings.rois)
            _publish(run.layout, staging)
        done = True
    finally:
        staging.close(done=done)


def _work_by_jobs(run: _Run, recordings: Sequence[Path], choice: ExecutorChoice) -> list[str]:
    """Let jobs make and commit the drives, and return the ids of those that this run committed."""
    with choice.open() as executor:
        jobs = WorkersRun(run.layout, executor, run.options, run.progress, run.settings, run.report)
        try:
            jobs.write(jobs.plan(recordings))
        finally:
            executor.close()
            remove_dead_folders(run.layout)
    return jobs.committed


def _add_by_jobs(run: _Run, recordings: Sequence[Path], choice: ExecutorChoice) -> None:
    committed = _work_by_jobs(run, recordings, choice)
    with adding(run.layout):
        append_drives(run.layout, committed, run.report.unchanged)


@dataclass
class _Writing:
    """A drive whose traversals are being written.

    Attributes:
        drive: it.
        jobs: one a traversal.
        failed: set by the first job that fails: the others need not begin.
    """

    drive: DrivePasses
    jobs: list[Future[WriteReport | None]] = field(default_factory=list)
    failed: threading.Event = field(default_factory=threading.Event)


class _Run:
    """One pass over all recordings, in their order: which of two that contradict each other fails depends on it."""

    def __init__(
        self,
        layout: Layout,
        options: IngestOptions,
        progress: ProgressReporter,
        settings: IngestSettings,
        known: KnownDrives | None = None,
    ) -> None:
        self.layout = layout
        self.options = options
        self.progress = progress
        self.settings = settings
        self.report = IngestReport()
        self._known = KnownDrives.read(Store(layout.root)) if known is None else known
        self._rois = {roi.scene_id: roi for roi in settings.rois}
        self._trigger = settings.trigger()
        self._owners: dict[str, Path] = {}
        self._rigs: dict[str, Rig] = {}
        self._stopped = threading.Event()

    def work(self, recordings: Sequence[Path], staging: Staging | None = None) -> None:
        """Judge all recordings, and write what is accepted.

        Args:
            recordings: one path a drive.
            staging: takes what is complete; None: nothing is written.
        """
        self.progress.start("ingesting (drives and images)" if staging else "reading poses", len(recordings))
        # Few passes and many workers: the cameras of a pass are written side by side.
        side_by_side = min(len(recordings), self.options.workers)
        writing: deque[_Writing] = deque()
        with ThreadPoolExecutor(self.options.workers) as pool:
            try:
                for path, future in _ahead(pool, self._prepare, recordings, self.options.workers):
                    prepared = self._taken(path, future, staging)
                    if prepared is not None and prepared.drive is not None and staging is not None:
                        writing.append(self._begin(pool, prepared.drive, prepared.replace, staging, side_by_side))
                        if len(writing) > self.options.workers:
                            self._finish(writing.popleft(), staging)
                        continue
                    if prepared is not None and prepared.drive is not None:
                        self._report(prepared.drive)
                    self.progress.advance(1)
                while staging is not None and writing:
                    self._finish(writing.popleft(), staging)
            except BaseException:
                self._stopped.set()
                pool.shutdown(cancel_futures=True)
                raise
        self.report.traversals.sort(key=lambda one: one.traversal_id)

    def _prepare(self, path: Path) -> PreparedDrive:
        return prepare(path, self.layout, self.options, self.settings, self._trigger, self._known)

    def _taken(self, path: Path, future: Future[PreparedDrive], staging: Staging | None) -> PreparedDrive | None:
        """A drive that can be written; None: it failed."""
        try:
            prepared = future.result()
            refuse_owned_id(path, prepared.drive_id, self._owners)
            if prepared.drive is not None and staging is not None:
                with reader_errors(path):
                    refuse_conflicting_rig(self.layout, prepared.drive, self._rigs)
        except MirrorError as error:
            self._fail(path, error)
            return None
        if prepared.drive is None:
            self.report.unchanged.append(prepared.drive_id)
        self.progress.expect(prepared.images)
        return prepared

    def _begin(
        self, pool: ThreadPoolExecutor, drive: DrivePasses, replace: bool, staging: Staging, side_by_side: int
    ) -> _Writing:
        one = _Writing(drive)
        threads = max(1, self.options.workers // max(1, len(drive.slices) * side_by_side))

        def write(number: int) -> WriteReport | None:
            if one.failed.is_set():
                return None
            try:
                return write_traversal(
                    staging,
                    drive,
                    number,
                    self._rois[drive.passes[number].scene_id],
                    self.settings.configuration,
                    self.options.write,
                    threads,
                    self._advance,
                    replace=replace,
                )
            except BaseException:
                one.failed.set()
                raise

        one.jobs += [pool.submit(write, number) for number in drive.slices]
        return one

    def _advance(self, steps: int) -> None:
        """Count images that are written; ends the job where the run has ended."""
        if self._stopped.is_set():
            raise _StoppedError
        self.progress.advance(steps)

    def _finish(self, one: _Writing, staging: Staging) -> None:
        """Seal a drive once all its traversals are written; of one that failed nothing is left."""
        drive, info = one.drive, one.drive.info
        wait(one.jobs)
        try:
            errors = [error for job in one.jobs if (error := job.exception()) is not None]
            if errors:
                # What ends the run comes before what ends the drive.
                raise min(errors, key=lambda error: not isinstance(error, _FATAL))
            written = [job.result() for job in one.jobs]
            seal_drive(
                staging, drive, sorted(self.settings.scenes), self.settings.configuration, self.options.weather_plugin
            )
            staging.take(info.drive_id)
        except MirrorError as error:
            staging.forget(info.drive_id)
            self._fail(drive.path, error)
        else:
            self.report.traversals += [job for job in written if job is not None]
            self._report(drive)
        self.progress.advance(1)

    def _report(self, drive: DrivePasses) -> None:
        with reader_errors(drive.path):
            uncalibrated = uncalibrated_cameras(drive.recording.rig)
        self.report.drives[drive.info.drive_id] = DriveReport(
            drive.path, drive.info, drive.cleaning, drive.passes, uncalibrated
        )

    def _fail(self, path: Path, error: MirrorError) -> None:
        if self.options.fail_fast or isinstance(error, _FATAL):
            raise error
        self.report.fail(path, error)


def _ahead(
    pool: ThreadPoolExecutor, call: Callable[[Path], Result], paths: Iterable[Path], count: int
) -> Iterator[tuple[Path, Future[Result]]]:
    """Calls in the order of the paths, of which no more than ``count`` have begun and are not yet taken."""
    begun: deque[tuple[Path, Future[Result]]] = deque()
    for path in paths:
        begun.append((path, pool.submit(call, path)))
        if len(begun) > count:
            yield begun.popleft()
    while begun:
        yield begun.popleft()
