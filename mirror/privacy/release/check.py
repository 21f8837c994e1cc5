"""Checking a release: its rules, the integrity rules of datasets, detectors that search it again, and the originals."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from mirror.dataset.content_hashes import ContentHashes
from mirror.dataset.images.decoding import decode_rgb
from mirror.dataset.images.video_decoders import VideoDecoders
from mirror.dataset.layout import Layout, require_dataset
from mirror.dataset.redaction import REDACTION, newest_redaction
from mirror.dataset.store import Store
from mirror.errors import DatasetError, ExitCode, MirrorError
from mirror.executors.job import Failure
from mirror.integrity import Cost
from mirror.integrity import check as check_dataset
from mirror.privacy.detection import Detected, DetectionTask, decode_recorded, detection_pool, read_recorded
from mirror.privacy.detectors.registry import DetectorChoice
from mirror.privacy.log import LOG, read_log
from mirror.privacy.regions import covered_share, grown_box
from mirror.privacy.release.leaving import leaving_originals
from mirror.privacy.release.rules import RULES
from mirror.privacy.release.vault import VAULT, Vault, is_expired, read_private_logs
from mirror.privacy.release.view import ImageName, ReleaseView
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.files import read_json, read_table
from mirror.schema.tables import IMAGES

COVERED: Final = 0.9
"""The share of what detectors find again that logged regions must cover: they fire on redacted faces too."""
_REDETECTED, _ORIGINALS, _INTEGRITY, _RETENTION, _SOURCES = "REL012", "REL013", "REL014", "REL015", "REL016"
_LEAVING: Final = "REL017"


@dataclass(frozen=True)
class ReleaseFinding:
    """One place that breaks a rule.

    Attributes:
        rule_id: the rule.
        title: the fault that the rule finds.
        remedy: how to correct it.
        file: file or item of the release.
        message: what is wrong there.
    """

    rule_id: str
    title: str
    remedy: str
    file: str
    message: str


@dataclass(frozen=True)
class ReleaseCheck:
    """The result of a check.

    Attributes:
        findings: what breaks a rule.
        rules: number of rules that ran.
        images: number of images of the release.
        searched: number of images that detectors searched again.
        not_run: rules that could not run, with the reason.
    """

    findings: Sequence[ReleaseFinding]
    rules: int
    images: int
    searched: int
    not_run: Sequence[str]

    def exit_code(self) -> ExitCode:
        """Return the exit code of `mirror release check`."""
        if self.findings:
            return ExitCode.FINDINGS
        return ExitCode.COULD_NOT_RUN if self.not_run else ExitCode.DONE


def check_release(
    root: str | Path,
    *,
    detectors: Sequence[DetectorChoice] = (),
    originals: Path | None = None,
    vault: Path | None = None,
    models: Sequence[Path] = (),
    workers: int = 1,
    timeout_s: float = 120.0,
    progress: ProgressReporter | None = None,
) -> ReleaseCheck:
    """Check a release. Nothing is changed.

    Args:
        root: folder of the release.
        detectors: detectors that search the images again; each region that they find must be covered by logged ones.
        originals: the dataset that the release was built of; no file of the release may be one of its images, and each
            image must have been redacted from the bytes that are recorded there.
        vault: a vault, whose private logs are used in the same way.
        models: folders of models that are to be published with the release.
        workers: number of processes for the detectors.
        timeout_s: longest time that the detectors may take for one image.
        progress: receives the progress.

    Raises:
        DatasetError: the folder holds no release.
        SchemaError: a document is broken.
    """
    view = ReleaseView(Path(root), models)
    bar = NullProgress() if progress is None else progress
    findings: list[ReleaseFinding] = []
    not_run: list[str] = []
    bar.start("rules", len(RULES))
    for rule in RULES:
        try:
            for found in rule.check(view):
                findings.append(ReleaseFinding(rule.rule_id, rule.title, rule.remedy, found.file, found.message))
        except (MirrorError, OSError) as error:
            findings.append(
                ReleaseFinding(rule.rule_id, rule.title, rule.remedy, str(view.root), f"cannot be read: {error}")
            )
        bar.advance(1)
    rules = len(RULES) + 1
    findings += _broken(view)
    if originals is not None or vault is not None:
        rules += 1
        findings += _originals(view, originals, vault)
    if originals is not None:
        rules += 2
        findings += _other_sources(view, originals)
        findings += find_leaving(Layout(originals), [view.root, *view.models], bar)
    if vault is not None:
        rules += 1
        if is_expired(read_json(vault / VAULT, Vault)):
            title, remedy = (
                "A vault is kept longer than it says.",
                "delete it, or state a reason and another date in it",
            )
            findings.append(ReleaseFinding(_RETENTION, title, remedy, str(vault), "its date of retention has passed"))
    if detectors:
        rules += 1
        bar.start("images searched again", len(view.images))
        more, failed = _redetected(view, detectors, workers, timeout_s, bar)
        findings += more
        not_run += failed
    searched = len(view.images) if detectors else 0
    return ReleaseCheck(findings, rules, len(view.images), searched, not_run)


def _broken(view: ReleaseView) -> Iterator[ReleaseFinding]:
    report = check_dataset(view.root, cost=Cost.FILES)
    for rule, found in report.findings:
        if rule.severity == "error":
            yield ReleaseFinding(
                _INTEGRITY, "An integrity rule of datasets fails.", rule.remedy, found.file,
                f"{rule.rule_id} {rule.title} {found.message}",
            )  # fmt: skip


def _originals(view: ReleaseView, originals: Path | None, vault: Path | None) -> Iterator[ReleaseFinding]:
    """Files with the bytes, and images with the pixels, of a recorded image that has regions."""
    files, pixels = set(), set()
    if vault is not None:
        for record in read_private_logs(vault):
            if record.in_pixel_sha256:
                files.add(record.in_sha256)
                pixels.add(record.in_pixel_sha256)
    if originals is not None:
        for data_hash, pixel_hash in _hashes_of(originals):
            files.add(data_hash)
            pixels.add(pixel_hash)
    title, remedy = "A file of the release is an original.", "build the release again"
    for name in view.files:
        data = (view.root / name).read_bytes()
        if hashlib.sha256(data).hexdigest() in files:
            yield ReleaseFinding(_ORIGINALS, title, remedy, name, "the bytes of a recorded image")
            continue
        codec = {"jpg": "jpeg", "jpeg": "jpeg", "png": "png"}.get(name.rpartition(".")[2].lower())
        decoded = decode_rgb(data, codec) if codec is not None else None
        if decoded is not None and hashlib.sha256(decoded.tobytes()).hexdigest() in pixels:
            yield ReleaseFinding(_ORIGINALS, title, remedy, name, "the pixels of a recorded image")


def _hashes_of(root: Path) -> Iterator[tuple[str, str]]:
    """Hashes of the bytes and pixels of the recorded images that have regions."""
    layout = Layout(root)
    require_dataset(layout)
    store = Store(root)
    videos = VideoDecoders(store)
    for folder in sorted((root / "traversals").glob("*")):
        name = folder.name
        with_regions = {
            record.key[1:]
            for kind, source, version in layout.layers(name)
            if kind == REDACTION and (layout.layer(name, kind, source, version) / LOG).is_file()
            for record in read_log(layout.layer(name, kind, source, version) / LOG)
            if record.regions
        }
        for row in read_table(layout.recorded(name) / "images.parquet", IMAGES).to_pylist():
            if (row["camera"], row["timestamp_ns"]) in with_regions:
                recorded = "" if row["sha256"] is None else row["sha256"].hex()
                try:
                    data = read_recorded(store, row)
                    pixels = decode_recorded(store, videos, row, data)
                except DatasetError:
                    # Another rule finds that the recorded bytes have changed.
                    yield recorded, ""
                    continue
                yield hashlib.sha256(data).hexdigest(), hashlib.sha256(pixels.tobytes()).hexdigest()


def find_leaving(source: Layout, folders: list[Path], progress: ProgressReporter) -> list[ReleaseFinding]:
    """Find recorded images in a release and its published files, also in archives, tables and pages.

    Args:
        source: the dataset.
        folders: the release, then models that are published with it.
        progress: receives the progress.
    """
    title = "A file holds a recorded image that its redaction replaced."
    leaks = leaving_originals(source, folders, progress)
    return [
        ReleaseFinding(_LEAVING, title, "remove it, or build the release again", one.file, one.problem) for one in leaks
    ]


def _other_sources(view: ReleaseView, originals: Path) -> Iterator[ReleaseFinding]:
    """Images that were redacted from other bytes than those that the dataset has recorded now.

    No detector has searched the bytes that such an image should show.
    """
    title = "An image was redacted from other bytes than those that are recorded."
    remedy = "de-identify the dataset under another version, and build the release again"
    logged, recorded = _read_sources(originals)
    for record in view.records:
        sources = logged.get(record.out_sha256, [])
        # Several recorded images may have become these bytes: none of them may have changed.
        others = [(key, source) for key, source in sources if source is None or source != recorded(key)]
        if sources and not others:
            continue
        if not sources:
            problem = "no log of the newest redactions has an image with these bytes"
        elif others[0][1] is None:
            problem = "the log of the dataset does not state from which bytes it was redacted"
        else:
            problem = f"the recorded bytes of {'/'.join(map(str, others[0][0]))} are not those that were redacted"
        yield ReleaseFinding(_SOURCES, title, remedy, "/".join(map(str, record.key)), problem)


def _read_sources(
    root: Path,
) -> tuple[dict[str, list[tuple[ImageName, str | None]]], Callable[[ImageName], str | None]]:
    """The images of the newest redactions of a dataset and their source hashes, by the hash of the redacted bytes.

    Returns:
        That mapping, and a function that hashes the recorded bytes of an image; None: there are none.
    """
    layout, hashes = Layout(root), ContentHashes(Store(root))
    logged: dict[str, list[tuple[ImageName, str | None]]] = {}
    rows: dict[ImageName, Mapping[str, Any]] = {}
    for folder in sorted((root / "traversals").glob("*")):
        newest = newest_redaction(layout.layers(folder.name))
        if newest is not None and (log := layout.layer(folder.name, REDACTION, *newest) / LOG).is_file():
            for record in read_log(log):
                logged.setdefault(record.out_sha256, []).append((record.key, record.source_sha256))
        for row in read_table(layout.recorded(folder.name) / "images.parquet", IMAGES).to_pylist():
            rows[folder.name, row["camera"], row["timestamp_ns"]] = row

    def hash_recorded(key: ImageName) -> str | None:
        try:
            return hashes.image_bytes(rows[key]) if key in rows else None
        except DatasetError:
            return None

    return logged, hash_recorded


def _redetected(
    view: ReleaseView, detectors: Sequence[DetectorChoice], workers: int, timeout_s: float, bar: ProgressReporter
) -> tuple[list[ReleaseFinding], list[str]]:
    """Return what detectors find in the images of the release and logged regions do not cover."""
    # Missing weights are an error of the command, not of every image.
    for choice in detectors:
        choice.make()
    keys = sorted(view.images)
    # A changed image is another rule's finding; here its pixels count.
    tasks = [
        DetectionTask(key[1:], {**view.images[key], "sha256": None, "byte_length": _size(view, key)}) for key in keys
    ]
    findings, failed = [], []
    with detection_pool(view.root, detectors, workers=workers, timeout_s=timeout_s) as pool:
        answers = dict(_counted(pool.map(tasks), bar))
    for number, answer in sorted(answers.items()):
        key, row = keys[number], view.images[keys[number]]
        if isinstance(answer, Failure):
            failed.append(f"{'/'.join(map(str, key))}: {answer.status}: {answer.problem}")
            continue
        record = view.log.get(key)
        logged = () if record is None else record.regions
        grow = 0.0 if record is None else record.grow
        boxes = [grown_box(region, grow, row["width_px"], row["height_px"]) for region in logged]
        covering = [box for box in boxes if box is not None]
        for region in answer.regions:
            share = covered_share(region.box_px, covering)
            if share < COVERED:
                left, top, right, bottom = region.box_px
                findings.append(
                    ReleaseFinding(
                        _REDETECTED,
                        "A detector finds a face or plate that no logged region covers.",
                        "de-identify again under another version, and build again",
                        row["uri"],
                        f"a {region.kind} of score {region.score:.2f} from ({left:.0f}, {top:.0f}) to"
                        f" ({right:.0f}, {bottom:.0f}), {100.0 * share:.0f} % covered",
                    )
                )
    return findings, failed


def _counted(
    answers: Iterator[tuple[int, Detected | Failure]], bar: ProgressReporter
) -> Iterator[tuple[int, Detected | Failure]]:
    for answer in answers:
        bar.advance(1)
        yield answer


def _size(view: ReleaseView, key: tuple[str, str, int]) -> int:
    path = view.root / view.images[key]["uri"]
    if not path.is_file():
        raise DatasetError("the image is missing", file=path, remedy="build the release again")
    return path.stat().st_size
