"""Checks of the files of layers (masks and depth maps): existence, size, hash, and the recorded image."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

import numpy as np

from mirror.errors import MirrorError
from mirror.integrity.finding import Finding
from mirror.integrity.images import leaves_dataset, stored_size
from mirror.integrity.rows import TableRows
from mirror.integrity.scene_view import SceneView


def missing_files(view: SceneView, rows: TableRows) -> Iterator[Finding]:
    """Find rows with a missing file, or with a file of another size."""
    length = rows.integers("byte_length")
    size = np.array([_size(view, uri) for uri in rows.data.column("uri").to_pylist()], np.int64)
    yield from rows.findings(
        size != length,
        lambda row: (
            f"{rows.text('uri', row)} "
            + ("is missing" if size[row] < 0 else f"has {size[row]} bytes; expected {length[row]}")
        ),
    )


def changed_files(view: SceneView, rows: TableRows) -> Iterator[Finding]:
    """Find rows with a file of the right size but another hash."""
    other = np.zeros(len(rows), np.bool_)
    length, sha256 = rows.integers("byte_length"), rows.data.column("sha256").to_pylist()
    for row, uri in enumerate(rows.data.column("uri").to_pylist()):
        if _size(view, uri) == length[row]:
            data = view.dataset.image_store.read_range(uri, 0, int(length[row]))
            other[row] = hashlib.sha256(data).digest() != sha256[row]
    yield from rows.findings(other, lambda row: f"{rows.text('uri', row)} has another SHA-256 than its row says")


def rows_without_image(view: SceneView, rows: TableRows) -> Iterator[Finding]:
    """Find rows for an image that was never recorded."""
    images = view.images
    codes, names = images.text_codes("camera")
    code_of = {name: code for code, name in enumerate(names)}
    own_codes, own_names = rows.text_codes("camera")
    camera = np.array([code_of.get(name, -1) for name in own_names], np.int64)[own_codes]
    stamps, taken = rows.integers("timestamp_ns"), images.integers("timestamp_ns")
    rows_of_images = {number: part for _, number, part in images.slices()}
    lost = np.zeros(len(rows), np.bool_)
    for _, number, part in rows.slices():
        own = rows_of_images.get(number, slice(0, 0))
        known = set(zip(codes[own].tolist(), taken[own].tolist()))
        lost[part] = [key not in known for key in zip(camera[part].tolist(), stamps[part].tolist())]
    yield from rows.findings(lost, lambda row: "no image of this camera and instant")


def _size(view: SceneView, uri: str) -> int:
    """Size of a file of a layer in bytes; -1: it is missing, or not in the dataset."""
    if leaves_dataset(uri) or "://" in uri:
        return -1
    try:
        return stored_size(view.dataset.image_store, uri, view.dataset.sizes)[0]
    except (OSError, MirrorError):
        return -1
