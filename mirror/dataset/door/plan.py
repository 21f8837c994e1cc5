"""Parts of a dataset that may or must not leave: by traversal, camera and time, in whatever file an image lies."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import PurePosixPath
from typing import Final, NamedTuple

from mirror.dataset.door.files import RECORDED, DatasetFiles, ImageFile, ImageKey, newest_of
from mirror.dataset.redaction import REDACTION
from mirror.errors import DatasetError

LEAVING_LAYERS: Final = frozenset({"poses", "calibrations", "boxes", "masks"})
"""Kinds of layers that leave whole. Of redactions the newest leaves; maps of depth and points show what images show."""


class Why(Enum):
    """The reason why an image must not leave; the values are words for messages."""

    WITHHELD = "a withheld image"
    UNREDACTED = "a recorded image without a redacted version"
    ORIGINAL = "the original of a redacted image"
    TAKEN_DOWN = "an image that was taken down"


class KeptFile(NamedTuple):
    """A file that must not leave.

    Attributes:
        file: the file, or the part of one.
        why: the reason.
    """

    file: ImageFile
    why: Why


@dataclass(frozen=True, eq=False)
class Departure:
    """The division of images into those that may leave the dataset and those that must stay.

    Attributes:
        files: the files that leave, relative to the dataset, with their SHA-256 where a table or manifest states it.
        shown: the file that shows each image that leaves.
        kept: files that must not leave.
        withheld: paths, as the index states them, of the images that do not leave.
        static_masks: masks of rigs, which leave written again as 0 and 255.
    """

    files: Mapping[str, str | None]
    shown: Mapping[ImageKey, ImageFile]
    kept: tuple[KeptFile, ...]
    withheld: tuple[str, ...]
    static_masks: frozenset[str]


def plan_departure(files: DatasetFiles, is_withheld: Callable[[ImageKey], bool]) -> Departure:
    """Divide the files that a dataset names into files that may leave and files that must stay.

    Recorded images of a traversal with a redaction layer never leave. Tables and masks leave whole; static masks of
    rigs, whose bytes no table states, are written again.

    Args:
        files: what the dataset names.
        is_withheld: whether an image must not leave, for reasons of the caller.

    Raises:
        DatasetError: one file shows an image that leaves and one that must not.
    """
    newest = {traversal_id: newest_of(files.layers, traversal_id) for traversal_id in files.layers}
    recorded = {one.key: one for one in files.images if one.layer == RECORDED}
    redacted = {one.key: one for one in files.images if one.layer == newest[one.key[0]]}
    shown: dict[ImageKey, ImageFile] = {}
    why: dict[ImageKey, Why] = {}
    withheld = set()
    for key, original in recorded.items():
        current = redacted.get(key, original)
        if key in files.taken_down:
            # The index does not show it: nobody looks for its file.
            why[key] = Why.TAKEN_DOWN
            continue
        if is_withheld(key):
            why[key] = Why.WITHHELD
        elif newest[key[0]] is not None and key not in redacted:
            why[key] = Why.UNREDACTED
        if key in why:
            withheld.add(current.name)
        else:
            shown[key] = current
    kept = [KeptFile(one, Why.TAKEN_DOWN) for one in _purged(files)]
    why |= dict.fromkeys(files.taken_down, Why.TAKEN_DOWN)
    for one in files.images:
        if one.key in why or one.key not in shown:
            kept.append(KeptFile(one, why.get(one.key, Why.WITHHELD)))
        elif one.layer == RECORDED and one != shown[one.key]:
            kept.append(KeptFile(one, Why.ORIGINAL))
    leaving: dict[str, str | None] = {name: sha256 for name, sha256 in files.documents.items() if _leaves(name, newest)}
    leaving |= dict.fromkeys(files.static_masks)
    leaving |= files.masks
    leaving |= _stated(shown.values())
    staying = {one.file.name: one for one in kept}
    for name in leaving:
        if name in staying:
            raise _shared_error(staying[name])
    return Departure(leaving, shown, tuple(kept), tuple(sorted(withheld)), frozenset(files.static_masks))


def _purged(files: DatasetFiles) -> Iterator[ImageFile]:
    """Images that were taken down, known by hashes alone: their bytes may be purged here, and be elsewhere still."""
    for key, hashes in files.taken_down.items():
        for sha256 in hashes:
            yield ImageFile(key, "taken down", "", 0, 0, "jpeg", None, sha256, (0, 0))


def _leaves(name: str, newest: Mapping[str, str | None]) -> bool:
    """Return whether a document leaves: all but those of layers that do not."""
    parts = PurePosixPath(name).parts
    if parts[0] != "traversals" or parts[2] != "layers":
        return True
    return parts[3] in LEAVING_LAYERS or (parts[3] == REDACTION and f"{parts[3]}/{parts[4]}" == newest[parts[1]])


def _stated(images: Iterable[ImageFile]) -> dict[str, str | None]:
    """The files of images with their SHA-256; None: not stated, or the file has several images beside each other."""
    found: dict[str, set[str | None]] = {}
    for one in images:
        found.setdefault(one.name, set()).add(one.sha256 if one.offset == 0 else None)
    return {name: next(iter(digests)) if len(digests) == 1 else None for name, digests in found.items()}


def require_own_files(departure: Departure) -> None:
    """Require that all images that tables name, leaving or staying, lie in the dataset's folder.

    The tables leave as they are, and the addresses of a fleet's own store are not for everybody.

    Raises:
        DatasetError: an image lies elsewhere.
    """
    for one in (*departure.shown.values(), *(kept.file for kept in departure.kept)):
        if "://" in one.name or one.name.startswith("/"):
            raise DatasetError(
                f"the image {one.name} lies outside of the dataset",
                place=_place(one),
                expected="images in the dataset's folder",
                remedy="ingest the recordings without references to images elsewhere; of a de-identified dataset,"
                " `mirror release build` writes tables without them",
            )


def _shared_error(kept: KeptFile) -> DatasetError:
    taken_down = kept.why is Why.TAKEN_DOWN
    return DatasetError(
        f"it would leave, and it shows {kept.why.value}",
        file=kept.file.name,
        place=_place(kept.file),
        expected="files that hold only images that leave, or only images that stay",
        remedy="`mirror dataset take-down` of the image with --purge-originals"
        if taken_down
        else "ingest the recordings as one file an image: --images jpeg",
    )


def _place(one: ImageFile) -> str:
    traversal_id, camera, timestamp_ns = one.key
    return f"traversal {traversal_id}, camera {camera}, timestamp_ns {timestamp_ns}"
