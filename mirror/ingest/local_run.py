"""An ingest whose drives are made in this process, on threads: drive by drive judged and written into a staging folder.

The work is in compiled kernels, the file system and hashing, all of which release the interpreter. At most two drives a
worker are on their way at a time, and nothing that grows with a drive's poses is kept after it, so that memory does not
grow with the number of drives.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from mirror.dataset.layout import Layout
from mirror.dataset.store import Store
from mirror.errors import MirrorError
from mirror.ingest.drive import refuse_conflicting_rig, refuse_owned_id, seal_drive, uncalibrated_cameras
from mirror.ingest.known_drives import KnownDrives
from mirror.ingest.passes import DrivePasses
from mirror.ingest.prepare import PreparedDrive, prepare
from mirror.ingest.request import FATAL, DriveReport, IngestOptions, IngestReport
from mirror.ingest.settings import IngestSettings
from mirror.ingest.staging import Staging
from mirror.ingest.traversal import WriteReport, write_traversal
from mirror.progress import ProgressReporter
from mirror.recordings.boundary import reader_errors
from mirror.schema.documents import Rig

Result = TypeVar("Result")


class _StoppedError(BaseException):
    """Ends a job whose run has ended, past all that takes the errors of a recording."""


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


class LocalRun:
    """One pass over all recordings, in their order: which of two that contradict each other fails depends on it.

    Args:
        layout: the dataset.
        options: of the run.
        progress: receives the number of drives and images.
        settings: of the run.
        known: the drives that the dataset has; None: they are read.

    Attributes:
        report: what the run has come to.
    """

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
                raise min(errors, key=lambda error: not isinstance(error, FATAL))
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
        if self.options.fail_fast or isinstance(error, FATAL):
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
