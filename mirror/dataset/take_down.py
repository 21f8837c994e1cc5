"""Taking images down: their rows leave the index, and the bytes that show them leave every file of the dataset.

The list of what was taken down, ``take_downs.json``, is written first. All else follows from it, so that the same call
finishes what an interrupted one left: the next snapshot has no row of the images, and then their bytes go, from all
redaction layers and, on request, from the recording. An image that is a file of its own is removed; one in an archive
is replaced by zeros, in a new file of the same name, so that every table, hash and place of the others stays true.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from mirror.dataset.destination import FolderDestination
from mirror.dataset.door.files import RELEASE_DOCUMENTS, ImageKey
from mirror.dataset.generation import FOLDER as SUPERSEDED
from mirror.dataset.images.shards import blank_images
from mirror.dataset.index.build import build_index
from mirror.dataset.index.snapshots import list_snapshots, read_snapshot
from mirror.dataset.layout import Layout, require_dataset
from mirror.dataset.lease import hold_lease
from mirror.dataset.lock import replacing, writer_lock
from mirror.dataset.redaction import REDACTION
from mirror.dataset.store import Store
from mirror.dataset.taken_down import CameraStamp, group_by_traversal, read_take_downs
from mirror.errors import DatasetError, UsageError
from mirror.schema.bundle import BUNDLE
from mirror.schema.files import encode_json, read_table, remove_path, remove_temporaries, write_bytes
from mirror.schema.links import require_inside
from mirror.schema.tables import IMAGES
from mirror.schema.take_downs import TAKE_DOWNS, TakeDowns, TakenDownImage

_RECORDED: Final = "recorded"


@dataclass(frozen=True)
class TakeDownReport:
    """The result of a take-down, or what it would be.

    Attributes:
        images: number of images that were named.
        new: number of those that were not taken down before.
        purged: files that were removed, and archives in which images are zeros now, relative to the dataset.
        originals: recorded files that still have the images, relative to the dataset, or URLs elsewhere.
        snapshots: numbers of the snapshots that lost rows.
    """

    images: int
    new: int
    purged: tuple[str, ...]
    originals: tuple[str, ...]
    snapshots: tuple[int, ...]


class ImagePlace(NamedTuple):
    """The place of the bytes of an image.

    Attributes:
        key: the image.
        uri: the file.
        offset: first byte.
        length: number of bytes.
        codec: jpeg, png or video.
        sha256: SHA-256 of the bytes, as the table states it; None: not stated.
        is_recorded: whether it is the recording's; else it is a redaction layer's.
    """

    key: ImageKey
    uri: str
    offset: int
    length: int
    codec: str
    sha256: bytes | None
    is_recorded: bool


def take_down(
    root: Path,
    images: Collection[ImageKey],
    *,
    reason: str = "",
    purge_originals: bool = False,
    dry_run: bool = False,
    wait: bool = False,
) -> TakeDownReport:
    """Take images down: no reader gets them any more, and no file of a redaction layer has their bytes.

    Args:
        root: the dataset's folder.
        images: traversal, camera and timestamp_ns of each.
        reason: why; readers of snapshots that lost rows get it.
        purge_originals: the recorded bytes go too.
        dry_run: report only.
        wait: wait for another run that writes the dataset or holds its lease.

    Raises:
        UsageError: no image is named, one is not in the dataset, or the folder is a published dataset
            or a release.
        DatasetError: there is no dataset, another run writes it or holds its lease, a recorded image to be purged is a
            frame of a video that shows others too, or a file cannot be read or written.
        SchemaError: a document or table is broken.
    """
    layout = Layout(root)
    require_dataset(layout)
    if (root / BUNDLE).is_file():
        raise UsageError(
            "a published dataset: name the dataset that it was published from", file=root / BUNDLE,
            expected="a dataset that `mirror ingest` wrote", remedy="give the published one with --publication",
        )  # fmt: skip
    if (root / RELEASE_DOCUMENTS[0]).is_file():
        raise UsageError(
            "a release", file=root, expected="a dataset that `mirror ingest` wrote",
            remedy="`mirror release withdraw` writes its next version",
        )  # fmt: skip
    if not images:
        raise UsageError(
            "no image is named", expected="at least one image",
            remedy="name them with --image TRAVERSAL/CAMERA/TIMESTAMP_NS or --list FILE",
        )  # fmt: skip
    if dry_run:
        return _plan(layout, images, reason, purge_originals)
    with (
        hold_lease(FolderDestination(root), "take-down", wait=wait) as lease,
        writer_lock(layout, wait=wait),
        replacing(layout),
    ):
        return _take_down(layout, images, reason, purge_originals, lease.require)


def _plan(layout: Layout, images: Collection[ImageKey], reason: str, purge_originals: bool) -> TakeDownReport:
    before = read_take_downs(Store(layout.root))
    after, places = _list(layout, before, images, reason, purge_originals)
    purged = {place.uri for place in places if purge_originals or not place.is_recorded}
    return _report(layout, after, before, images, places, sorted(purged), purge_originals)


def _take_down(
    layout: Layout, images: Collection[ImageKey], reason: str, purge_originals: bool, require_lease: Callable[[], None]
) -> TakeDownReport:
    before = read_take_downs(Store(layout.root))
    after, places = _list(layout, before, images, reason, purge_originals)
    _write(layout, after)
    require_lease()
    # Readers of the newest snapshot never meet an image without bytes: its rows go first.
    build_index(layout.root)
    newest = list_snapshots(Store(layout.root))[-1]
    after = TakeDowns(
        images=tuple(one if one.snapshot else one.model_copy(update={"snapshot": newest}) for one in after.images)
    )
    _write(layout, after)
    gone = group_by_traversal(after)
    purged: list[str] = []
    for place in (layout, *_superseded(layout)):
        purged += purge_images(place, gone, originals=purge_originals, before_each=require_lease)
    return _report(layout, after, before, images, places, purged, purge_originals)


def purge_images(
    layout: Layout,
    gone: Mapping[str, frozenset[CameraStamp]],
    *,
    originals: bool,
    before_each: Callable[[], None] = lambda: None,
) -> list[str]:
    """Remove the bytes of images from all redaction layers, and from the recording on request.

    Args:
        layout: a dataset, a published one, or what readers of earlier snapshots have open.
        gone: the images, by traversal.
        originals: the recorded bytes go too.
        before_each: called before each file is changed.

    Returns:
        The changed and removed files, relative to the layout's root.

    Raises:
        DatasetError: a file cannot be read or written, or leads out of the folder.
    """
    changed = []
    for traversal_id, keys in sorted(gone.items()):
        for folder in _tables(layout, traversal_id, originals=originals):
            # An interrupted call may have left an unfinished archive, which has the images still.
            remove_temporaries(folder)
            by_file: dict[str, list[dict[str, Any]]] = {}
            for row in read_table(folder / "images.parquet", IMAGES).to_pylist():
                by_file.setdefault(row["uri"], []).append(row)
            for uri, rows in by_file.items():
                own = [row for row in rows if (row["camera"], row["timestamp_ns"]) in keys]
                path = None if _is_elsewhere(uri) else require_inside(layout.root, uri)
                if not own or path is None or not path.is_file():
                    continue
                before_each()
                if len(own) == len(rows):
                    remove_path(path)
                    changed.append(uri)
                elif own[0]["codec"] != "video" and blank_images(
                    path, [(row["byte_offset"], row["byte_length"]) for row in own]
                ):
                    changed.append(uri)
    return changed


def _list(
    layout: Layout, before: TakeDowns, images: Collection[ImageKey], reason: str, purge_originals: bool
) -> tuple[TakeDowns, list[ImagePlace]]:
    """List all that is taken down afterwards, and the places of the images that are named.

    Raises:
        UsageError: an image is not in the dataset.
        DatasetError: an original to be purged is a frame of a video that shows other images too.
    """
    known = {one.key: one for one in before.images}
    places: list[ImagePlace] = []
    for traversal_id in sorted({key[0] for key in images}):
        places += list_places(layout, traversal_id, {key for key in images if key[0] == traversal_id})
    found = {place.key for place in places if place.is_recorded}
    for key in sorted(images):
        if key not in found and key not in known:
            raise UsageError(
                f"there is no image {'/'.join(map(str, key))}", file=layout.root,
                expected="traversal/camera/timestamp_ns of a recorded image",
                remedy="`mirror sql DATASET 'select traversal_id, camera, timestamp_ns from images'` lists them",
            )  # fmt: skip
    store = Store(layout.root)
    for key in images:
        if key not in known:
            own = (place for place in places if place.key == key)
            hashes = tuple(sorted({digest for place in own if (digest := _hash(store, place)) is not None}))
            known[key] = TakenDownImage(
                traversal_id=key[0], camera=key[1], timestamp_ns=key[2], reason=reason, sha256=hashes
            )
    after = TakeDowns(images=tuple(known[key] for key in sorted(known)))
    if purge_originals:
        _require_whole_videos(layout, places, after)
    return after, places


def list_places(layout: Layout, traversal_id: str, keys: Collection[ImageKey]) -> Iterator[ImagePlace]:
    """Yield the places of some images of a traversal, in its redaction layers and its recording.

    Raises:
        SchemaError: a table is broken.
    """
    for folder in _tables(layout, traversal_id, originals=True):
        for row in read_table(folder / "images.parquet", IMAGES).to_pylist():
            key = (traversal_id, row["camera"], row["timestamp_ns"])
            if key in keys:
                place = row["uri"], row["byte_offset"], row["byte_length"], row["codec"], row["sha256"]
                yield ImagePlace(key, *place, folder.name == _RECORDED)


def _tables(layout: Layout, traversal_id: str, *, originals: bool) -> Iterator[Path]:
    """Yield the folders of a traversal that have a table of images: its redaction layers, and the recording."""
    folders = [
        layout.layer(traversal_id, kind, source, version)
        for kind, source, version in layout.layers(traversal_id)
        if kind == REDACTION
    ]
    for folder in [*folders, *([layout.recorded(traversal_id)] if originals else [])]:
        if (folder / "images.parquet").is_file():
            yield folder


def _require_whole_videos(layout: Layout, places: Sequence[ImagePlace], after: TakeDowns) -> None:
    gone = group_by_traversal(after)
    for place in places:
        if place.codec != "video" or not place.is_recorded or _is_elsewhere(place.uri):
            continue
        traversal_id = place.key[0]
        rows = read_table(layout.recorded(traversal_id) / "images.parquet", IMAGES, ["camera", "timestamp_ns", "uri"])
        for row in rows.to_pylist():
            if row["uri"] == place.uri and (row["camera"], row["timestamp_ns"]) not in gone[traversal_id]:
                raise DatasetError(
                    "the original is a frame of a video, of which no frame can be removed alone",
                    file=layout.root / place.uri, place="/".join(map(str, place.key)),
                    expected="an image in a file of its own or in an archive, or all frames of the video",
                    remedy="take all of its frames down, or leave --purge-originals out",
                )  # fmt: skip


def _hash(store: Store, place: ImagePlace) -> str | None:
    """The SHA-256 of an image's bytes, as its table states it or as they are; None: of a whole video, or not there."""
    if place.codec == "video":
        return None
    if place.sha256 is not None:
        return place.sha256.hex()
    try:
        data = store.read_range(place.uri, place.offset, place.length)
    except OSError:
        return None
    return hashlib.sha256(data).hexdigest() if any(data) else None


def _superseded(layout: Layout) -> list[Layout]:
    """Return what earlier runs replaced, and readers may have open still."""
    return [Layout(folder) for folder in sorted((layout.root / SUPERSEDED).glob("*.*")) if folder.is_dir()]


def _write(layout: Layout, document: TakeDowns) -> None:
    path, data = layout.root / TAKE_DOWNS, encode_json(document)
    if not path.is_file() or path.read_bytes() != data:
        write_bytes(path, data)


def _is_elsewhere(uri: str) -> bool:
    return "://" in uri or uri.startswith("/")


def _report(
    layout: Layout,
    after: TakeDowns,
    before: TakeDowns,
    images: Collection[ImageKey],
    places: Sequence[ImagePlace],
    purged: Sequence[str],
    purge_originals: bool,
) -> TakeDownReport:
    store = Store(layout.root)
    staying = {
        place.uri
        for place in places
        if place.is_recorded and (not purge_originals or _is_elsewhere(place.uri)) and _is_there(store, place)
    }
    own = {key: one for one in after.images if (key := one.key) in images}
    lost = []
    for number in list_snapshots(store):
        drives = read_snapshot(store, number).drives
        if any(one.drive_id in drives and (one.snapshot is None or number < one.snapshot) for one in own.values()):
            lost.append(number)
    new = len(set(own) - {one.key for one in before.images})
    return TakeDownReport(len(own), new, tuple(dict.fromkeys(purged)), tuple(sorted(staying)), tuple(lost))


def _is_there(store: Store, place: ImagePlace) -> bool:
    try:
        return _is_elsewhere(place.uri) or any(store.read_range(place.uri, place.offset, place.length))
    except OSError:
        return False
