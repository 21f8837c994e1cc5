"""The rules of `mirror release check`: each finds one kind of fault that would publish what must not be published."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

from mirror.dataset.images.binary_mask import is_binary
from mirror.dataset.images.metadata import list_metadata
from mirror.errors import MirrorError
from mirror.methods.model_document import DOCUMENT as MODEL
from mirror.methods.model_document import Reconstruction, read_reconstruction
from mirror.privacy.detectors.recall import ANY
from mirror.privacy.release.document import DATASHEET, DOCUMENT, LICENCE
from mirror.privacy.release.sample import DEFAULT_SAMPLE, choose_sample
from mirror.privacy.release.texts import NO_REIDENTIFICATION
from mirror.privacy.release.tree import FROM_IMAGES
from mirror.privacy.release.view import ReleaseView

_CONTAINERS: Final = frozenset(
    (".mp4", ".mov", ".mkv", ".avi", ".webm", ".h264", ".h265", ".hevc", ".ts", ".bag", ".mcap")
)
_RASTERS: Final = frozenset(
    (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp", ".heic", ".gif", ".exr", ".npy", ".npz")
)
_PATHS: Final = re.compile(r"(?:/home/|/Users/|/mnt/|/data/|/srv/|file://|s3://|gs://|[A-Za-z]:\\\\)[^\"'\s]*")
_VIN: Final = re.compile(r"\b(?=[A-HJ-NPR-Z0-9]*\d)(?=[A-HJ-NPR-Z0-9]*[A-HJ-NPR-Z])[A-HJ-NPR-Z0-9]{17}\b")
_EMPTY_HASH: Final = "0" * 64


@dataclass(frozen=True)
class Found:
    """One place that breaks a rule.

    Attributes:
        file: relative to the release.
        message: what is wrong there.
    """

    file: str
    message: str


@dataclass(frozen=True)
class ReleaseRule:
    """One rule for releases.

    Attributes:
        rule_id: its id.
        title: the fault that it finds.
        remedy: how to correct it.
        check: finds the faults.
    """

    rule_id: str
    title: str
    remedy: str
    check: Callable[[ReleaseView], Iterator[Found]]


def _unnamed_files(view: ReleaseView) -> Iterator[Found]:
    for name in view.files:
        if name in view.named_files:
            continue
        suffix = PurePosixPath(name).suffix.lower()
        what = "a video container" if suffix in _CONTAINERS else "an image" if suffix in _RASTERS else "a file"
        yield Found(name, f"{what} that no table or manifest of the release names")


def _other_bytes(view: ReleaseView) -> Iterator[Found]:
    for key in sorted(set(view.images) | set(view.log)):
        row, record = view.images.get(key), view.log.get(key)
        place = "/".join(map(str, key))
        if row is None or record is None:
            yield Found(place, "in the log only" if row is None else "an image without a line in the log")
            continue
        path = view.root / row["uri"]
        digest = hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else None
        if digest is None:
            yield Found(row["uri"], "the image is missing")
        elif digest != record.out_sha256 or row["sha256"] != bytes.fromhex(digest):
            yield Found(row["uri"], "other bytes than the redaction wrote: it may be an original")


def _metadata(view: ReleaseView) -> Iterator[Found]:
    for name in view.files:
        path = view.root / name
        if path.suffix.lower() not in (".jpg", ".jpeg", ".png"):
            continue
        try:
            held = list_metadata(path.read_bytes(), path)
        except MirrorError as error:
            yield Found(name, error.problem)
            continue
        if held:
            yield Found(name, f"it holds {', '.join(held)}")


def _privacy_state(view: ReleaseView) -> Iterator[Found]:
    for (traversal_id, camera, timestamp_ns), row in sorted(view.images.items()):
        file = f"traversals/{traversal_id}/recorded/images.parquet"
        place = f"camera {camera}, timestamp_ns {timestamp_ns}"
        if row["privacy"] != "redacted":
            yield Found(file, f"{place}: privacy is {row['privacy']}")
        if row["codec"] == "video":
            yield Found(file, f"{place}: a frame of a video container")
        if "://" in row["uri"] or row["uri"].startswith("/") or ".." in PurePosixPath(row["uri"]).parts:
            yield Found(file, f"{place}: its bytes lie outside of the release: {row['uri']}")


def _hashes_of_originals(view: ReleaseView) -> Iterator[Found]:
    for name in view.traversals:
        folder = view.layout.traversal(name) / "layers" / "redaction"
        if folder.exists():
            yield Found(
                folder.relative_to(view.root).as_posix(), "a redaction layer: hashes of originals follow from it"
            )
    for record in view.records:
        if record.source_sha256 is not None:
            yield Found("redaction_log.jsonl", f"{'/'.join(map(str, record.key))}: a hash of the original")
    for drive, _ in view.drives:
        if drive.source.fingerprint != _EMPTY_HASH or drive.source.files or drive.source.bytes:
            yield Found(f"drives/{drive.drive_id}/drive.json", "it names files, size or fingerprint of the recording")
    for path in sorted(view.root.rglob("manifest.json")):
        text = path.read_text()
        if '"source":' in text and path.is_relative_to(view.root / "traversals"):
            yield Found(path.relative_to(view.root).as_posix(), "derived_from has a fingerprint of the recording")


def _stale_layers(view: ReleaseView) -> Iterator[Found]:
    for name, layer, manifest in view.layers():
        if layer.partition("/")[0] not in FROM_IMAGES:
            continue
        if manifest.derived_from.get("recorded") != view.content(name):
            yield Found(
                f"traversals/{name}/layers/{layer}",
                "not derived from the images of this release: it may show originals",
            )


def _models(view: ReleaseView) -> Iterator[Found]:
    contents = {view.content(name) for name in view.traversals}
    folders = [*(path.parent for path in sorted(view.root.rglob(MODEL))), *view.models]
    for folder in folders:
        model: Reconstruction = read_reconstruction(Path(folder))
        others = sorted(name for name, sha256 in model.trained.items() if sha256 not in contents)
        if others or not model.trained:
            listed = others[0] if others else "nothing"
            yield Found(str(folder), f"a model that was not trained on the images of this release: {listed}")


def _identifying_text(view: ReleaseView) -> Iterator[Found]:
    for name in view.files:
        path = view.root / name
        if path.suffix not in (".json", ".jsonl", ".geojson", ".md", ".txt") and path.stat().st_size > 0:
            continue
        text = path.read_text(errors="replace")
        for pattern, what in ((_PATHS, "a path"), (_VIN, "a vehicle identification number")):
            match = pattern.search(text)
            if match is not None:
                yield Found(name, f"{what}: {match[0][:80]}")


def _review(view: ReleaseView) -> Iterator[Found]:
    sample = choose_sample(view.records, view.release.sample)
    stated = (view.release.plate_region or "").upper().split(", ")
    if ANY in stated and len(sample) < (least := min(DEFAULT_SAMPLE, len(view.records))):
        yield Found(
            DOCUMENT, f"number plates of any region, and a sample of {len(sample)} images for review; at least {least}"
        )
    waiting = [record for record in sample if record.review is None]
    if waiting:
        yield Found(
            "redaction_log.jsonl",
            f"{len(waiting)} of the {len(sample)} images of the sample were not reviewed, such as"
            f" {'/'.join(map(str, waiting[0].key))}",
        )
    for record in view.records:
        if record.review is not None and record.review.verdict == "miss":
            yield Found("/".join(map(str, record.key)), "a reviewer saw a face or plate that is not redacted")


def _texts(view: ReleaseView) -> Iterator[Found]:
    for name in (DATASHEET, LICENCE):
        path = view.root / name
        if not path.is_file():
            yield Found(name, "missing")
        elif view.release.contact not in path.read_text():
            yield Found(name, "it does not name the contact for removal")
    path = view.root / LICENCE
    if path.is_file() and NO_REIDENTIFICATION not in path.read_text():
        yield Found(LICENCE, "it does not forbid to identify persons and vehicles")


def _photos_as_masks(view: ReleaseView) -> Iterator[Found]:
    for name in sorted(view.masks):
        path = view.root / name
        if path.is_file() and not is_binary(path.read_bytes()):
            yield Found(name, "a mask with other pixels than 0 and 255: it may be a photo")


def _withdrawn(view: ReleaseView) -> Iterator[Found]:
    present = {*view.traversals, *("/".join(map(str, key)) for key in view.images)}
    present |= {"/".join(map(str, record.key)) for record in view.records}
    for one in view.release.tombstones:
        if one.item in present:
            yield Found(one.item, f"withdrawn in version {one.version}, and here again")


RULES: Final = (
    ReleaseRule(
        "REL001", "A file that the release does not name.", "remove it, or build the release again", _unnamed_files
    ),
    ReleaseRule(
        "REL002",
        "An image differs from the one in the log, or one of them is missing.",
        "build the release again",
        _other_bytes,
    ),
    ReleaseRule(
        "REL003", "An image file holds more than pixels.", "build the release again: images were changed", _metadata
    ),
    ReleaseRule(
        "REL004",
        "An image is not redacted, or its bytes lie in a video or elsewhere.",
        "de-identify the dataset and build again",
        _privacy_state,
    ),
    ReleaseRule("REL005", "A hash or fingerprint of originals.", "build the release again", _hashes_of_originals),
    ReleaseRule(
        "REL006",
        "A layer that was derived from other images.",
        "derive it from the release, or remove it",
        _stale_layers,
    ),
    ReleaseRule("REL007", "A model that was trained on other images.", "train it on the release", _models),
    ReleaseRule(
        "REL008",
        "A text that identifies a place, machine or vehicle.",
        "remove it from the dataset and build again",
        _identifying_text,
    ),
    ReleaseRule(
        "REL009",
        "The sample for human review is incomplete, too small for number plates of any region, or has a miss.",
        "`mirror release review DATASET`, and build without a smaller --sample; after a miss, de-identify again under"
        " another version",
        _review,
    ),
    ReleaseRule("REL010", "The datasheet or licence is missing or incomplete.", "build the release again", _texts),
    ReleaseRule("REL011", "Something that was withdrawn.", "withdraw it again", _withdrawn),
    ReleaseRule("REL018", "A mask that holds more than an outline.", "build the release again", _photos_as_masks),
)
"""Rules that need neither detectors nor originals; `mirror.privacy.release.check` has those that do."""
