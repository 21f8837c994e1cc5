"""A whole ingest: drive by drive judged and written, all committed at the end, and a snapshot of the index put last.

What makes it safe to stop at any instant: a run writes in a folder of its own (`Staging`), where a traversal exists
once its manifest does; drives are committed at the end, file by file, each name once and its manifest last, and the
index is derived from complete drives alone. A second run finds what is complete by its fingerprints and does the rest.

A run that only adds drives to scenes that the dataset has holds no lock: any number of them may run at a time. A run
that makes a dataset, adds scenes or maps, or replaces drives holds the writer lock.

Drives are made on threads of this process (`LocalRun`), or by the workers of an executor (`WorkersRun`).
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from mirror.dataset.destination import BucketDestination, bucket_at
from mirror.dataset.generation import FOLDER as SUPERSEDED
from mirror.dataset.generation import recover
from mirror.dataset.index import append_drives, build_index
from mirror.dataset.layout import Layout
from mirror.dataset.lock import adding, replacing, writer_lock
from mirror.errors import UsageError
from mirror.executors.choice import ExecutorChoice
from mirror.ingest.bucket import BucketStaging, append_committed, commit_plan, fetch_plan, refuse_options_of_folders
from mirror.ingest.dead_letters import list_dead_letters, read_dead_letters, write_dead_letters
from mirror.ingest.jobs import WorkersRun, remove_dead_folders
from mirror.ingest.known_drives import KnownDrives
from mirror.ingest.local_run import LocalRun
from mirror.ingest.maps import add_maps, judge_maps, read_given_maps
from mirror.ingest.request import IngestOptions, IngestReport
from mirror.ingest.rois import read_rois, write_rois
from mirror.ingest.settings import merge_settings, missing_roi_error
from mirror.ingest.staging import Staging
from mirror.progress import NullProgress, ProgressReporter
from mirror.recordings.weather import CLASSIFIERS
from mirror.schema.documents import Roi
from mirror.schema.files import unwritable_error, write_json
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.schema.links import refuse_links_out


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
        return _ingest_into_bucket(recordings, rois, bucket_at(str(out)), _checked(options), progress)
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
        run = LocalRun(layout, options, progress, merge_settings(layout, options, rois))
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
            run = LocalRun(layout, options, progress, merge_settings(layout, options, rois))
            if options.executor is None:
                _add(run, recordings)
            else:
                _add_by_jobs(run, recordings, options.executor)
            return run.report
        with writer_lock(layout, wait=options.wait):
            try:
                recover(layout)
                run = LocalRun(layout, options, progress, merge_settings(layout, options, rois))
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
    destination: BucketDestination,
    options: IngestOptions,
    progress: ProgressReporter,
) -> IngestReport:
    """Cut recordings into a dataset in a bucket; see `ingest_recordings`."""
    refuse_options_of_folders(options, destination.url)
    with tempfile.TemporaryDirectory(prefix="mirror-ingest-") as folder:
        scratch = Layout(Path(folder))
        fetch_plan(destination, scratch)
        if not rois and not scratch.document.exists():
            raise missing_roi_error()
        settings = merge_settings(scratch, options, rois)
        known = KnownDrives.read(destination.store) if scratch.document.exists() else KnownDrives()
        run = LocalRun(scratch, options, progress, settings, known)
        if options.dry_run:
            if options.executor is None:
                run.work(recordings)
            else:
                _work_by_jobs(run, recordings, options.executor, destination)
            return run.report
        commit_plan(destination, settings, scratch)
        if options.executor is not None:
            committed = _work_by_jobs(run, recordings, options.executor, destination)
            run.report.licence = settings.document.licence
            append_committed(destination, scratch, committed)
            return run.report
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


def _add(run: LocalRun, recordings: Sequence[Path]) -> None:
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


def _write(run: LocalRun, recordings: Sequence[Path]) -> None:
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


def _write_drives(run: LocalRun, recordings: Sequence[Path]) -> None:
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


def _work_by_jobs(
    run: LocalRun, recordings: Sequence[Path], choice: ExecutorChoice, bucket: BucketDestination | None = None
) -> list[str]:
    """Let jobs make and commit the drives, and return the ids of those that this run committed."""
    with choice.open() as executor:
        jobs = WorkersRun(run.layout, executor, run.options, run.progress, run.settings, run.report, bucket)
        try:
            jobs.write(jobs.plan(recordings))
        finally:
            executor.close()
            remove_dead_folders(run.layout)
    return jobs.committed


def _add_by_jobs(run: LocalRun, recordings: Sequence[Path], choice: ExecutorChoice) -> None:
    committed = _work_by_jobs(run, recordings, choice)
    with adding(run.layout):
        append_drives(run.layout, committed, run.report.unchanged)
