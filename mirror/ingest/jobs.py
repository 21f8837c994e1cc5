"""An ingest on workers: the plan is committed first, then each drive by one job, and a snapshot of the index last.

The plan has what all drives share: ``dataset.json``, the scenes, the rigs, and which recording has which drive id. A
job judges one recording, makes its drive in a folder of its own and commits it file by file, each name once; it returns
numbers. Of two attempts at a drive, however late one of them wakes up, both commit the same bytes.

A dataset in a bucket is written in the same way: the folder is then one of the machine of the job.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

from mirror.dataset.destination import BucketDestination, FolderDestination
from mirror.dataset.images.binary_mask import encode_mask
from mirror.dataset.layout import Layout, complete_manifest
from mirror.dataset.lock import adding
from mirror.dataset.owned_folder import abandoned_folders
from mirror.dataset.store import Store
from mirror.errors import MirrorError, RecordingError, UsageError
from mirror.executors.executor import Executor
from mirror.executors.job import Failure, ParallelJob, Result
from mirror.ingest.drive import (
    conflicting_rig_error,
    make_rig_document,
    mask_file_name,
    refuse_owned_id,
    seal_drive,
    uncalibrated_cameras,
)
from mirror.ingest.known_drives import KnownDrives
from mirror.ingest.prepare import prepare
from mirror.ingest.request import FATAL, DriveReport, IngestOptions, IngestReport
from mirror.ingest.rois import read_rois, write_rois
from mirror.ingest.settings import IngestSettings
from mirror.ingest.staging import FOLDER, Staging
from mirror.ingest.traversal import WriteReport, write_traversal
from mirror.ingest.trigger import RoiTrigger
from mirror.progress import ProgressReporter
from mirror.recordings.boundary import reader_errors
from mirror.recordings.registry import open_recording
from mirror.schema.documents import Rig
from mirror.schema.files import encode_json, read_json, write_json

JOB: Final = "job"
"""First part of the names of folders of jobs, which no other run takes over."""


@dataclass(frozen=True)
class DriveIdentity:
    """A recording as it names itself, before its poses are read.

    Attributes:
        drive_id: the drive.
        rig: its rig; None: it has none.
        masks: bytes of the rig's static masks, by file name.
        licence: licence of the data; None: it states none.
    """

    drive_id: str
    rig: Rig | None
    masks: dict[str, bytes]
    licence: str | None


@dataclass(frozen=True)
class DriveOutcome:
    """The numbers of a drive.

    Attributes:
        drive_id: the drive.
        report: of the drive; None: the dataset has it unchanged.
        traversals: of its traversals.
        images: number of their images.
    """

    drive_id: str
    report: DriveReport | None = None
    traversals: tuple[WriteReport, ...] = ()
    images: int = 0


@dataclass(frozen=True)
class DriveSettings:
    """The settings that all jobs of a run are given.

    Attributes:
        root: folder of the dataset; of one in a bucket, a folder of the machine that began the run.
        options: of the run.
        settings: of the run.
        bucket: the dataset, if it is in a bucket.
    """

    root: Path
    options: IngestOptions
    settings: IngestSettings
    bucket: BucketDestination | None = None

    @property
    def store(self) -> Store:
        """The dataset, for reading."""
        return Store(self.root) if self.bucket is None else self.bucket.store

    @contextmanager
    def layout(self) -> Iterator[Layout]:
        """Open the folder in which a job makes its drive, laid out like a dataset."""
        if self.bucket is None:
            yield Layout(self.root)
            return
        # What a killed worker leaves goes with the folder of the run, where that is on this machine.
        base = self.root if self.root.is_dir() else None
        with tempfile.TemporaryDirectory(prefix=f"{JOB}-", dir=base) as folder:
            yield Layout(Path(folder))

    @contextmanager
    def committing(self, layout: Layout) -> Iterator[None]:
        """Keep runs from replacing files of the dataset meanwhile; nothing in a bucket is replaced."""
        if self.bucket is not None:
            yield
            return
        with adding(layout):
            yield


class WorkersRun:
    """An ingest whose drives are made by the workers of an executor.

    Args:
        layout: the dataset.
        executor: where the jobs run.
        options: of the run.
        progress: receives the number of drives and images.
        settings: of the run.
        report: takes what the run comes to.
        bucket: the dataset, if it is in a bucket; the folder then has its document, its scenes and its rigs.

    Attributes:
        committed: ids of the drives that it committed.

    Raises:
        UsageError: an option needs an ingest in this process.
    """

    def __init__(
        self,
        layout: Layout,
        executor: Executor,
        options: IngestOptions,
        progress: ProgressReporter,
        settings: IngestSettings,
        report: IngestReport,
        bucket: BucketDestination | None = None,
    ) -> None:
        if options.replace:
            raise UsageError(
                "jobs add drives and replace nothing", place="--replace", expected="--executor serial with it",
                remedy="leave --executor out",
            )  # fmt: skip
        self.layout, self.settings, self.report = layout, settings, report
        self.committed: list[str] = []
        self._executor, self._options, self._progress = executor, options, progress
        self._bucket = bucket
        sent = DriveSettings(layout.root.absolute(), options, settings, bucket)
        # One job has both steps, so that its workers are started once.
        self._job: ParallelJob[tuple[_Step[Any], Path], Any] = ParallelJob(
            _make_steps, (sent,), timeout_s=options.timeout_s
        )

    def plan(self, recordings: Sequence[Path]) -> list[Path]:
        """Ask all recordings who they are, and commit what their drives share.

        Returns:
            The recordings that can be ingested.

        Raises:
            DatasetError: the plan of another run has other bytes.
        """
        self._progress.start("identifying recordings", len(recordings))
        identities: dict[Path, DriveIdentity] = {}
        for path, identity in self._results(_identify, recordings):
            identities[path] = identity
            self._progress.advance(1)
        owners: dict[str, Path] = {}
        rigs: dict[str, DriveIdentity] = {}
        planned = []
        for path in (path for path in recordings if path in identities):
            try:
                self._admit(path, identities[path], owners, rigs)
            except RecordingError as error:
                self._fail(path, error, Failure("failed", str(error)))
            else:
                planned.append(path)
        if planned and not self._options.dry_run:
            self._commit_plan([identities[path] for path in planned], rigs)
        return planned

    def write(self, recordings: Sequence[Path]) -> None:
        """Judge recordings, and commit their drives."""
        self._progress.start("ingesting (drives and images)", len(recordings))
        done: dict[Path, DriveOutcome] = {}
        for path, outcome in self._results(_ingest, recordings):
            done[path] = outcome
            self._progress.expect(outcome.images)
            self._progress.advance(1 + outcome.images)
        for path in (path for path in recordings if path in done):
            outcome = done[path]
            if outcome.report is None:
                self.report.unchanged.append(outcome.drive_id)
                continue
            self.report.drives[outcome.drive_id] = replace(outcome.report, path=path)
            self.report.traversals += outcome.traversals
            if not self._options.dry_run:
                self.committed.append(outcome.drive_id)
        order = {path: number for number, path in enumerate(recordings)}
        self.report.traversals.sort(key=lambda one: one.traversal_id)
        self.report.failures.sort(key=lambda one: order.get(one[0], -1))

    def _results(self, step: _Step[Result], recordings: Sequence[Path]) -> Iterator[tuple[Path, Result]]:
        for number, answer in self._executor.map(self._job, ((step, path.absolute()) for path in recordings)):
            path = recordings[number]
            if isinstance(answer, Failure):
                self._fail(path, _error(path, answer), answer)
                self._progress.advance(1)
            else:
                yield path, answer

    def _fail(self, path: Path, error: MirrorError, failure: Failure) -> None:
        if self._options.fail_fast or isinstance(error, FATAL):
            raise error
        self.report.fail(path, error, failure.status, failure.attempts)

    def _admit(
        self, path: Path, identity: DriveIdentity, owners: dict[str, Path], rigs: dict[str, DriveIdentity]
    ) -> None:
        """Require that a recording contradicts neither the dataset nor a recording before it; remember it.

        Raises:
            RecordingError: its drive id or its rig is that of another one.
        """
        refuse_owned_id(path, identity.drive_id, owners)
        if identity.rig is None:
            return
        file = self.layout.rig(identity.rig.rig_id)
        if identity.rig.rig_id in rigs:
            known = rigs[identity.rig.rig_id].rig
        else:
            known = read_json(file, Rig) if file.exists() else identity.rig
            rigs[identity.rig.rig_id] = replace(identity, rig=known)
        if known != identity.rig:
            raise conflicting_rig_error(path, identity.rig.rig_id)

    def _commit_plan(self, identities: Sequence[DriveIdentity], rigs: Mapping[str, DriveIdentity]) -> None:
        if self._bucket is None:
            self._write_documents(identities)
        place = self._bucket or FolderDestination(self.layout.root)
        for identity in rigs.values():
            if identity.rig is not None and not self.layout.rig(identity.rig.rig_id).exists():
                for name, data in identity.masks.items():
                    place.commit_bytes(f"rigs/{name}", data)
                place.commit_bytes(f"rigs/{identity.rig.rig_id}.json", encode_json(identity.rig))

    def _write_documents(self, identities: Sequence[DriveIdentity]) -> None:
        document = self.settings.document
        if not self.layout.document.exists():
            licences = {one.licence for one in identities}
            if document.licence is None and len(licences) == 1:
                document = document.model_copy(update={"licence": licences.pop()})
            write_json(self.layout.document, document)
        self.report.licence = document.licence
        if not self.layout.rois.exists() or tuple(read_rois(self.layout.rois)) != self.settings.rois:
            write_rois(self.layout.rois, self.settings.rois)


def remove_dead_folders(layout: Layout) -> None:
    """Remove the folders of jobs whose process is dead; nobody continues in them."""
    for left in abandoned_folders(layout.root / FOLDER, JOB):
        shutil.rmtree(left, ignore_errors=True)
    with suppress(OSError):
        (layout.root / FOLDER).rmdir()


_Step: TypeAlias = Callable[["_DriveMaker", Path], Result]
"""The work of a job on a recording."""


class _DriveMaker(NamedTuple):
    """The settings of a worker, with what it derives from them once for all recordings."""

    sent: DriveSettings
    trigger: RoiTrigger
    known: KnownDrives


def _make_steps(sent: DriveSettings) -> Callable[[tuple[_Step[Any], Path]], Any]:
    maker = _DriveMaker(sent, sent.settings.trigger(), KnownDrives.read(sent.store))

    def do(item: tuple[_Step[Any], Path]) -> Any:
        step, path = item
        return step(maker, path)

    return do


def _identify(maker: _DriveMaker, path: Path) -> DriveIdentity:
    options = maker.sent.options
    with reader_errors(path):
        recording = open_recording(path, reader=options.reader, options=options.reader_options)
        rig = recording.rig
        masks = (
            {}
            if rig is None
            else {
                mask_file_name(rig.rig_id, one.name): encode_mask(one.static_mask)
                for one in rig.cameras
                if one.static_mask is not None
            }
        )
        return DriveIdentity(recording.info.drive_id, make_rig_document(recording), masks, recording.info.licence)


def _ingest(maker: _DriveMaker, path: Path) -> DriveOutcome:
    """Judge a recording and commit its drive."""
    with maker.sent.layout() as layout:
        return _make_drive(maker, path, layout)


def _make_drive(maker: _DriveMaker, path: Path, layout: Layout) -> DriveOutcome:
    options, settings = maker.sent.options, maker.sent.settings
    prepared = prepare(path, layout, options, settings, maker.trigger, maker.known)
    drive = prepared.drive
    if drive is None:
        return DriveOutcome(prepared.drive_id)
    with reader_errors(path):
        uncalibrated = uncalibrated_cameras(drive.recording.rig)
    report = DriveReport(path, drive.info, drive.cleaning, drive.passes, uncalibrated)
    if options.dry_run:
        return DriveOutcome(prepared.drive_id, report)
    if complete_manifest(layout.drive(prepared.drive_id)) is not None:
        raise RecordingError(
            f"drive {prepared.drive_id!r} is in the dataset for other scenes, or damaged", file=path,
            expected="a drive that is not there yet: jobs replace nothing",
            remedy="ingest this recording without --executor, which makes the drive again",
        )  # fmt: skip
    rois = {roi.scene_id: roi for roi in settings.rois}
    staging = Staging(layout, name=JOB)
    try:
        written = []
        for number in drive.slices:
            roi = rois[drive.passes[number].scene_id]
            written.append(
                write_traversal(staging, drive, number, roi, settings.configuration, options.write, 1, lambda _: None)
            )
        seal_drive(staging, drive, sorted(settings.scenes), settings.configuration, options.weather_plugin)
        with maker.sent.committing(layout):
            staging.commit(maker.sent.bucket)
    finally:
        staging.close(done=True)
    return DriveOutcome(prepared.drive_id, report, tuple(written), prepared.images)


def _error(path: Path, failure: Failure) -> MirrorError:
    """Return the error of a recording, or one that says how the worker ended that was at it."""
    if isinstance(failure.error, MirrorError):
        return failure.error
    return RecordingError(
        f"{failure.problem} ({failure.attempts} attempts)", file=path, expected="a recording that its reader can read",
        remedy="correct the recording, or leave it out; --retry-failed tries it again, --timeout-s gives it more time",
    )  # fmt: skip
