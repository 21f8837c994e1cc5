"""The first half of a drive's way: opened, identified, held against the dataset, judged. No image is opened."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mirror.dataset.layout import Layout, complete_manifest, is_intact
from mirror.errors import RecordingError
from mirror.ingest.drive import are_traversals_intact, verify_source
from mirror.ingest.known_drives import KnownDrives
from mirror.ingest.passes import DrivePasses, find_drive_passes, fingerprint
from mirror.ingest.request import IngestOptions
from mirror.ingest.settings import IngestSettings
from mirror.ingest.traversal import select_images
from mirror.ingest.trigger import RoiTrigger
from mirror.recordings.boundary import reader_errors
from mirror.recordings.missing_images import name_missing_images, without_missing_images
from mirror.recordings.protocol import Recording
from mirror.recordings.registry import open_recording
from mirror.schema.documents import DriveDocument, RecordingSource, is_identifier
from mirror.schema.files import read_json


@dataclass(frozen=True)
class PreparedDrive:
    """A drive with its judged passes, ready to be written if its input changed.

    Attributes:
        drive_id: its id.
        drive: judged; None: the dataset has it, unchanged.
        replace: the dataset has another state of it.
        images: how many images its traversals will have.
    """

    drive_id: str
    drive: DrivePasses | None
    replace: bool = False
    images: int = 0


def prepare(
    path: Path,
    layout: Layout,
    options: IngestOptions,
    settings: IngestSettings,
    trigger: RoiTrigger,
    known: KnownDrives,
) -> PreparedDrive:
    """Open and judge a recording, unless it is complete in the dataset.

    Args:
        path: of the recording.
        layout: the dataset.
        options: of the run.
        settings: of the run.
        trigger: for its scenes.
        known: the drives that the dataset has.

    Raises:
        RecordingError: the recording cannot be used, or its id belongs to another one.
        UsageError: a ROI's longitude and latitude look exchanged.
    """
    with reader_errors(path):
        recording = open_recording(path, reader=options.reader, options=options.reader_options)
        drive_id = recording.info.drive_id
    for name, value in (("drive_id", drive_id), ("vehicle_id", recording.info.vehicle_id)):
        if not is_identifier(value):
            raise RecordingError(f"{name} {value!r} is not an id", file=path, expected="letters, digits, _ and -")
    reader = options.reader or type(recording).__module__.rpartition(".")[2]
    with reader_errors(path):
        if options.max_missing_images > 0.0:
            recording = without_missing_images(recording, options.max_missing_images)
        with _missing_images_named(recording):
            source = fingerprint(recording, reader, path.resolve().name)
    is_trusted = not (options.dry_run or options.replace or options.verify)
    if is_trusted and known.has_unchanged(drive_id, source.fingerprint, settings.configuration, settings.scenes):
        return PreparedDrive(drive_id, None)
    if known.is_final and drive_id in known.sources:
        raise RecordingError(
            f"drive {drive_id!r} is in the dataset already, from other files or with other options", file=path,
            expected="the recording as it was: a bucket is only added to",
            remedy="give the recording another drive id, or give another --out",
        )  # fmt: skip
    if _is_unchanged(path, recording, source, layout, options, settings) and not options.dry_run:
        return PreparedDrive(drive_id, None)
    drive = find_drive_passes(path, recording, source, trigger, settings.rois, settings.document.cleaning)
    images = 0
    if not options.dry_run:
        with reader_errors(path), _missing_images_named(recording):
            for number in drive.slices:
                images += sum(len(indices) for _, indices, _ in select_images(drive, number).values())
    replace = options.replace or not _same_source(layout, drive_id, source, settings.configuration)
    return PreparedDrive(drive_id, drive, replace, images)


@contextmanager
def _missing_images_named(recording: Recording) -> Iterator[None]:
    """Let an error of missing images say how many, and name the option that accepts the drive without them."""
    try:
        yield
    except RecordingError as error:
        raise name_missing_images(recording, error) from error


def _is_unchanged(
    path: Path,
    recording: Recording,
    source: RecordingSource,
    layout: Layout,
    options: IngestOptions,
    settings: IngestSettings,
) -> bool:
    """Return whether the drive is complete in the dataset as its recording is now.

    Raises:
        RecordingError: the id belongs to another recording, or to this one before it changed.
    """
    folder = layout.drive(recording.info.drive_id)
    if options.replace or not is_intact(folder):
        return False
    document = read_json(folder / "drive.json", DriveDocument)
    if not _same_source(layout, document.drive_id, source, settings.configuration):
        if options.dry_run:
            return False
        changed = "its files have changed" if document.source.name == source.name else "another recording has it"
        if document.source.fingerprint == source.fingerprint:
            changed = "it was ingested with other options"
        raise RecordingError(
            f"drive {document.drive_id!r} is in the dataset already, and {changed}",
            file=path,
            expected=f"the recording {document.source.name!r} as it was",
            remedy="give the recording another drive id, or add --replace to ingest it again",
        )
    if not settings.scenes.issubset(document.scenes) or not are_traversals_intact(layout, document.drive_id):
        return False
    if options.verify:
        with reader_errors(path):
            verify_source(layout, recording, document.drive_id)
    return True


def _same_source(layout: Layout, drive_id: str, source: RecordingSource, configuration: str) -> bool:
    """Return whether a complete drive of the dataset has just this input and these options; True if there is none."""
    manifest = complete_manifest(layout.drive(drive_id))
    if manifest is None:
        return True
    made_from = {"source": source.fingerprint, "configuration": configuration}
    return made_from.items() <= manifest.derived_from.items()
