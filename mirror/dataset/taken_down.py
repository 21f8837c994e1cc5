"""The images that were taken down from a dataset: they have no rows in its index, and must not leave it."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TypeAlias

import pyarrow as pa
import pyarrow.compute as pc

from mirror.dataset.store import Store
from mirror.errors import DatasetError, UsageError
from mirror.schema.files import encode_json, parse_json
from mirror.schema.snapshot import SNAPSHOTS
from mirror.schema.take_downs import TAKE_DOWNS, TakeDowns

CameraStamp: TypeAlias = tuple[str, int]
"""Identifies an image of a traversal: camera and timestamp_ns."""


def read_take_downs(store: Store) -> TakeDowns:
    """Read the images that were taken down from a dataset.

    Raises:
        SchemaError: ``take_downs.json`` is broken.
    """
    found = store.read_many([TAKE_DOWNS])
    if TAKE_DOWNS not in found:
        return TakeDowns()
    return parse_json(found[TAKE_DOWNS], TakeDowns, store.full_path(TAKE_DOWNS))


def parse_image(text: str, place: str) -> tuple[str, str, int]:
    """Parse the name of an image: ``traversal/camera/timestamp_ns``.

    Args:
        text: the name.
        place: the option or line that has it, for messages.

    Raises:
        UsageError: it is none.
    """
    parts = text.strip().split("/")
    if len(parts) != 3 or parts[0].count(".") != 2 or not parts[2].isdecimal():
        raise UsageError(
            f"{text.strip()!r} names no image", place=place, expected="TRAVERSAL/CAMERA/TIMESTAMP_NS",
            remedy="`mirror sql DATASET 'select traversal_id, camera, timestamp_ns from images'` lists the images",
        )  # fmt: skip
    return parts[0], parts[1], int(parts[2])


def read_image_list(path: Path) -> set[tuple[str, str, int]]:
    """Read a text file with the name of an image a line; empty lines, and those that begin with #, are passed over.

    Raises:
        UsageError: it cannot be read, or a line names no image.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(
            f"cannot be read: {error}", file=path, place="--list", expected="a text file with an image a line",
            remedy="correct the path",
        ) from error  # fmt: skip
    numbered = ((number, line.strip()) for number, line in enumerate(lines, 1))
    return {parse_image(line, f"{path}, line {number}") for number, line in numbered if line and line[0] != "#"}


def group_by_traversal(take_downs: TakeDowns) -> dict[str, frozenset[CameraStamp]]:
    """Return the images that were taken down, by traversal."""
    found: dict[str, set[CameraStamp]] = {}
    for one in take_downs.images:
        found.setdefault(one.traversal_id, set()).add((one.camera, one.timestamp_ns))
    return {traversal_id: frozenset(keys) for traversal_id, keys in found.items()}


def encode_public_take_downs(take_downs: TakeDowns) -> bytes:
    """Encode ``take_downs.json`` as it is published: without reasons and hashes of originals.

    A published dataset has one snapshot, which shows none of the images.
    """
    images = tuple(one.model_copy(update={"reason": "", "sha256": (), "snapshot": 1}) for one in take_downs.images)
    return encode_json(take_downs.model_copy(update={"images": images}))


def drop_images(data: pa.Table, keys: Collection[CameraStamp]) -> pa.Table:
    """Remove the rows of some images from a table of images, masks or depth maps."""
    if not keys:
        return data
    cameras = data.column("camera").cast(pa.string()).to_pylist()
    stamps = data.column("timestamp_ns").to_pylist()
    return data.filter(pc.invert(pa.array([key in keys for key in zip(cameras, stamps)], pa.bool_())))


def require_all_rows(store: Store, number: int, drives: Collection[str]) -> None:
    """Refuse a snapshot whose rows name an image that was taken down since.

    Args:
        store: the dataset.
        number: number of the snapshot, which is not the newest one.
        drives: the drives whose rows it has.

    Raises:
        DatasetError: it has lost rows.
    """
    for one in read_take_downs(store).images:
        if one.drive_id in drives and (one.snapshot is None or number < one.snapshot):
            raise DatasetError(
                f"snapshot {number} has lost rows: {'/'.join(map(str, one.key))} was taken down"
                f" ({one.reason or 'no reason is stated'})", file=store.full_path(SNAPSHOTS),
                expected="a snapshot without the image" if one.snapshot is None else
                f"snapshot {one.snapshot} or a later one, or one from before drive {one.drive_id}",
                remedy="choose another number, or open the newest",
            )  # fmt: skip
