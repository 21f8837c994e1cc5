"""Building a release: a new dataset with redacted images only, with log, datasheet and licence."""

from __future__ import annotations

import hashlib
import secrets
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np

from mirror.dataset import open as open_dataset
from mirror.dataset.dataset import Dataset
from mirror.dataset.door.placing import dataset_state, require_unchanged
from mirror.dataset.images.binary_mask import rewrite_mask
from mirror.dataset.images.video_decoders import VideoDecoders
from mirror.dataset.index import build_index
from mirror.dataset.layout import Layout, complete_manifest, require_dataset
from mirror.dataset.lock import writer_lock
from mirror.dataset.owned_folder import OwnedFolder, abandoned_folders
from mirror.dataset.splits.split import hash_manifests
from mirror.dataset.store import Store
from mirror.dataset.unfinished_work import DEIDENTIFICATION
from mirror.errors import DatasetError, UsageError
from mirror.privacy.detection import decode_recorded, read_recorded
from mirror.privacy.log import ImageRecord, encode_log
from mirror.privacy.release.check import ReleaseFinding, check_release, find_leaving
from mirror.privacy.release.document import DATASHEET, DOCUMENT, LICENCE, LOG, TIMES, Release
from mirror.privacy.release.renaming import rename_drive
from mirror.privacy.release.sample import DEFAULT_SAMPLE, REVIEWS, choose_sample, read_reviews, with_reviews
from mirror.privacy.release.texts import datasheet, licence_text
from mirror.privacy.release.tree import TreeReport, read_drives, read_plate_regions, write_drive
from mirror.privacy.release.vault import OriginalRecord, Vault, open_vault, write_private_log
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.documents import DatasetDocument, DriveDocument, Rig, SplitDocument
from mirror.schema.files import read_json, read_table, unmovable_error, write_bytes, write_json
from mirror.schema.folders import require_output_folder
from mirror.schema.tables import EGO_POSES

_RANDOM_KEY: Final = 32


@dataclass(frozen=True)
class ReleaseOptions:
    """Options of a release: its name, licence, contact, clocks and vault.

    Attributes:
        name: name of the release.
        licence: licence of the data.
        contact: where persons ask for the removal of an image.
        sample: number of images that persons must have reviewed; 0: a review is not asked for.
        clock: grain of the clock, a key of `TIMES`.
        trim_ends_s: traversals nearer in time than this to an end of their drive are left out.
        keep_ids: keep the ids of drives and vehicles.
        vault: folder for what links the release to the originals; None: that is not kept, and no later release has the
            same pseudonyms.
        retain_days: days after which a new vault is to be deleted; None: not stated.
        plate_region: region of the number plates, for the datasheet; None: that which the log of the de-identification
            records, if it does.
    """

    name: str
    licence: str
    contact: str
    sample: int = DEFAULT_SAMPLE
    clock: Literal["exact", "hour", "day", "week"] = "exact"
    trim_ends_s: float = 0.0
    keep_ids: bool = False
    vault: Path | None = None
    retain_days: int | None = None
    plate_region: str | None = None


@dataclass(frozen=True)
class BuildReport:
    """The result of building a release.

    Attributes:
        release: its document.
        images: number of images.
        traversals: number of traversals.
        left_out: layers that were derived from other images than the redacted ones.
        findings: why it was refused; empty: it was written.
    """

    release: Release
    images: int
    traversals: int
    left_out: Sequence[str]
    findings: Sequence[ReleaseFinding]


def build_release(
    root: str | Path,
    out: Path,
    options: ReleaseOptions,
    *,
    progress: ProgressReporter | None = None,
    wait: bool = False,
) -> BuildReport:
    """Build a release of a de-identified dataset, which appears at its place once all checks have passed.

    Detectors are not run again here: `check_release` does that.

    Args:
        root: the dataset.
        out: folder of the release; absent or empty.
        options: name, licence, contact, review, times and ids.
        progress: receives the progress.
        wait: wait for another run that writes the dataset.

    Raises:
        DatasetError: images have no redacted version, files are missing or changed, or the dataset changed meanwhile.
        UsageError: an option is not valid or contradicts the de-identification, or a folder is taken or lies in another
            dataset.
    """
    layout = Layout(Path(root))
    require_dataset(layout)
    _require_options(options)
    require_output_folder(out)
    bar = NullProgress() if progress is None else progress
    vault = None
    if options.vault is not None:
        vault = open_vault(options.vault, (layout.root, out), options.retain_days)
    for abandoned in abandoned_folders(out.absolute().parent, f".{out.name}"):
        shutil.rmtree(abandoned, ignore_errors=True)
    work = OwnedFolder(out.absolute().parent, f".{out.name}")
    try:
        with writer_lock(layout, wait=wait):
            before = dataset_state(layout)
            release, parts = _write(layout, Layout(work.path), options, vault, bar)
        build_index(work.path)
        report = TreeReport()
        for part in parts:
            report.records += part.records
            report.recorded += part.recorded
            report.left_out += part.left_out
            report.traversals |= part.traversals
        findings = [*check_release(work.path, progress=bar).findings, *find_leaving(layout, [work.path], bar)]
        require_unchanged(layout, before)
        if not findings:
            if vault is not None and options.vault is not None:
                write_private_log(options.vault, f"{options.name}.v{release.version}", _originals(layout, report))
            if out.exists():
                out.rmdir()
            try:
                work.path.rename(out)
            except OSError as error:
                raise unmovable_error(out, error) from error
            work.release()
        return BuildReport(release, len(report.records), len(report.traversals), report.left_out, findings)
    finally:
        work.remove()


def _require_options(options: ReleaseOptions) -> None:
    if options.clock not in TIMES:
        raise UsageError(f"clock {options.clock!r}", expected=f"one of {', '.join(TIMES)}")
    for name, value in (("name", options.name), ("licence", options.licence), ("contact", options.contact)):
        if not value.strip():
            raise UsageError(f"the {name} is empty", place=f"--{name}", expected="a text")
    if "/" in options.name or options.name.startswith("."):
        raise UsageError(
            f"the name {options.name!r} cannot name a file",
            place="--name",
            expected="no slash, and no point at its beginning",
        )
    if not options.trim_ends_s >= 0.0 or options.sample < 0:
        raise UsageError(
            f"trim_ends_s={options.trim_ends_s}, sample={options.sample}", expected="numbers that are not negative"
        )


def _write(
    source: Layout, target: Layout, options: ReleaseOptions, vault: Vault | None, bar: ProgressReporter
) -> tuple[Release, list[TreeReport]]:
    options = replace(options, plate_region=_plate_region(source, options.plate_region))
    document = read_json(source.document, DatasetDocument)
    write_json(target.document, document.model_copy(update={"licence": options.licence}))
    write_bytes(target.rois, source.rois.read_bytes())
    key = None if options.keep_ids else bytes.fromhex(vault.key) if vault is not None else _fresh_key()
    dataset = _opened(source)
    bar.start("images released", dataset.count("images"))
    parts, trimmed, rigs = [], 0, set()
    for drive, traversals in read_drives(source):
        kept = [name for name in traversals if not _is_near_end(source, drive, name, options.trim_ends_s)]
        trimmed += len(traversals) - len(kept)
        if not kept:
            continue
        renaming = rename_drive(drive, key, TIMES[options.clock])
        parts.append(write_drive(source, target, drive, kept, renaming, bar.advance))
        rigs |= {drive.rig_id} - {None}
    if not parts:
        raise DatasetError(
            "no traversal is left", file=source.root, remedy="trim less of the ends of drives: --trim-ends-s"
        )
    for rig_id in sorted(name for name in rigs if name is not None):
        _copy_rig(source, target, rig_id)
    traversals_by_id = {old: new for part in parts for old, new in part.traversals.items()}
    manifests = {name: value for part in parts for name, value in part.manifests.items()}
    for path in sorted((source.root / "splits").glob("*.json")):
        split = read_json(path, SplitDocument)
        write_json(target.split(split.name), _renamed_split(split, traversals_by_id, manifests))
    release = _write_documents(source, target, options, parts, trimmed)
    return release, parts


def _plate_region(layout: Layout, stated: str | None) -> str | None:
    """The region of the number plates that the user states or, if all of them do, that the logs record."""
    found = read_plate_regions(layout, (name for _, traversals in read_drives(layout) for name in traversals))
    known = sorted(region for region in found if region is not None)
    if stated is None:
        return ", ".join(known) if known and None not in found else None
    if others := [region for region in known if region != stated.upper()]:
        raise UsageError(
            f"{stated}, but the images were de-identified for number plates of {', '.join(others)}",
            file=layout.root, place="--plate-region", expected="the region that was given to `mirror deidentify`",
            remedy="leave the option out, or de-identify the images again for this region under another --version",
        )  # fmt: skip
    return stated


def _write_documents(
    source: Layout, target: Layout, options: ReleaseOptions, parts: Sequence[TreeReport], trimmed: int
) -> Release:
    reviews = read_reviews(source.root / DEIDENTIFICATION / REVIEWS)
    records = with_reviews([record for part in parts for record in part.records], reviews)
    sampled = choose_sample(records, options.sample)
    reviewed = [record for record in sampled if record.review is not None]
    release = Release(
        name=options.name,
        contact=options.contact,
        sample=min(options.sample, len(records)),
        reviewed_regions=sum(len(record.regions) for record in reviewed),
        missed=sum(record.review is not None and record.review.verdict == "miss" for record in reviewed),
        withheld=sum(part.withheld for part in parts),
        clock=options.clock,
        trim_ends_s=options.trim_ends_s,
        trimmed=trimmed,
        pseudonyms="kept" if options.keep_ids else "renewed",
        plate_region=options.plate_region,
        road_maps_left_out=_count_road_maps(source),
    )
    write_documents(target, release, records, options.licence)
    return release


def write_documents(target: Layout, release: Release, records: Sequence[ImageRecord], licence: str) -> None:
    """Write the log, the datasheet, the licence and ``release.json`` of a release."""
    traversals = {record.traversal_id for record in records}
    write_bytes(target.root / LOG, encode_log(records))
    write_bytes(target.root / DATASHEET, datasheet(release, records, len(traversals)).encode())
    write_bytes(target.root / LICENCE, licence_text(release, licence).encode())
    write_json(target.root / DOCUMENT, release)


def _count_road_maps(layout: Layout) -> int:
    """Number of recorded road maps of a dataset.

    A release has none of them: their licence is that of their source, and in China their publication needs a permit.
    """
    return sum(complete_manifest(layout.road_map(name)) is not None for name in _opened(layout).scenes())


def _renamed_split(split: SplitDocument, traversals: Mapping[str, str], manifests: Mapping[str, str]) -> SplitDocument:
    """A split with the ids and hashes of the release; traversals that it lacks have no role."""
    own = {traversals[old]: role for old, role in split.assignments.items() if old in traversals}
    hashes = {name: manifests[name] for name in own}
    changes = {
        "assignments": dict(sorted(own.items())),
        "manifests": dict(sorted(hashes.items())),
        "dataset_hash": hash_manifests(hashes),
        "left_out": {traversals.get(key, key): why for key, why in split.left_out.items()},
        "added": tuple(traversals[old] for old in split.added if old in traversals),
    }
    return split.model_copy(update=changes)


def _is_near_end(layout: Layout, drive: DriveDocument, traversal_id: str, seconds: float) -> bool:
    """Return whether a traversal begins or ends within some seconds of an end of its drive."""
    if not seconds:
        return False
    stamps = read_table(layout.recorded(traversal_id) / "ego_poses.parquet", EGO_POSES, ["timestamp_ns"])
    times = np.asarray(stamps.column(0).to_numpy(), np.int64)
    margin = int(seconds * 1e9)
    return bool(len(times) and (times[0] < drive.start_ns + margin or times[-1] > drive.end_ns - margin))


def _copy_rig(source: Layout, target: Layout, rig_id: str) -> None:
    rig = read_json(source.rig(rig_id), Rig)
    # The source's names of cameras may name the fleet.
    cameras = tuple(camera.model_copy(update={"source_name": camera.name}) for camera in rig.cameras)
    write_json(target.rig(rig_id), rig.model_copy(update={"cameras": cameras}))
    for camera in rig.cameras:
        if camera.static_mask is not None:
            path = source.rig(rig_id).parent / camera.static_mask
            write_bytes(target.rig(rig_id).parent / camera.static_mask, rewrite_mask(path.read_bytes(), path))


def _originals(layout: Layout, report: TreeReport) -> list[OriginalRecord]:
    """The private log: what each released image was made of."""
    store = Store(layout.root)
    videos = VideoDecoders(store)
    found = []
    for record, (old, row) in zip(report.records, report.recorded):
        data = read_recorded(store, row)
        pixels = (
            hashlib.sha256(decode_recorded(store, videos, row, data).tobytes()).hexdigest() if record.regions else ""
        )
        found.append(
            OriginalRecord(
                released="/".join(map(str, record.key)),
                recorded=f"{old}/{row['camera']}/{row['timestamp_ns']}",
                out_sha256=record.out_sha256,
                in_sha256=hashlib.sha256(data).hexdigest(),
                in_pixel_sha256=pixels,
            )
        )
    return found


def _opened(layout: Layout) -> Dataset:
    build_index(layout.root)
    return open_dataset(str(layout.root))


def _fresh_key() -> bytes:
    return secrets.token_bytes(_RANDOM_KEY)
