"""What is read before any table: the dataset's document, the manifest of its index, and whether the index is stale."""

from __future__ import annotations

from pathlib import Path

from mirror.dataset.generation import Generation
from mirror.dataset.index.inputs import read_inputs
from mirror.dataset.layout import MANIFEST, not_a_dataset_error
from mirror.dataset.store import Store
from mirror.errors import DatasetError, MirrorError, SchemaError
from mirror.schema.documents import DatasetDocument, Manifest
from mirror.schema.files import parse_json, sha256_bytes


def read_document(store: Store) -> DatasetDocument:
    """Read ``dataset.json``.

    Raises:
        DatasetError: there is none.
        SchemaError: it is invalid.
    """
    try:
        data = store.read("dataset.json")
    except (FileNotFoundError, NotADirectoryError) as error:
        exists = store.folder is None or Path(store.folder).exists()
        raise not_a_dataset_error(store.full_path(""), exists=exists) from error
    return parse_json(data, DatasetDocument, store.full_path("dataset.json"))


def read_index_manifest(store: Store) -> tuple[Manifest, str]:
    """Read the manifest of the index; also returns its SHA-256.

    Raises:
        DatasetError: the dataset has no index.
        SchemaError: the manifest is invalid.
    """
    path = f"index/{MANIFEST}"
    try:
        data = store.read(path) if store.generation is None else store.generation.manifest
    except FileNotFoundError as error:
        raise _no_index_error(store) from error
    return parse_json(data, Manifest, store.full_path(path)), sha256_bytes(data)


def hold_generation(store: Store) -> Store:
    """Return a local store at its current generation, or the unchanged remote store.

    Raises:
        DatasetError: the dataset has no index.
    """
    if store.folder is None:
        return store
    try:
        return Store(store.root, Generation.current(store.folder))
    except FileNotFoundError as error:
        raise _no_index_error(store) from error


def find_staleness(store: Store, manifest: Manifest) -> MirrorError | None:
    """Return the reason why an index is stale; None if it is current."""
    try:
        current = read_inputs(store).fingerprints
    except (DatasetError, SchemaError) as error:
        return error
    differing = sorted(key for key, value in current.items() if manifest.derived_from.get(key) != value)
    if dict(current) == manifest.derived_from:
        return None
    return DatasetError(
        f"the index is stale: {len(differing)} of its sources changed ({', '.join(differing[:3])} ...)",
        file=store.full_path("index"),
        expected="an index derived from the present files",
        remedy=f"run `mirror index {store.root}`",
    )


def _no_index_error(store: Store) -> DatasetError:
    return DatasetError(
        "the dataset has no index", file=store.full_path("index"), remedy=f"run `mirror index {store.root}`"
    )
