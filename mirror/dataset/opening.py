"""Reads the dataset's document and a snapshot of its index before any table, and tells whether that is stale."""

from __future__ import annotations

from pathlib import Path

from mirror.dataset.generation import Generation
from mirror.dataset.index.build import describe_changes, find_changes
from mirror.dataset.index.inputs import read_inputs
from mirror.dataset.index.snapshots import list_snapshots, read_snapshot, read_state
from mirror.dataset.layout import not_a_dataset_error
from mirror.dataset.store import Store
from mirror.dataset.taken_down import require_all_rows
from mirror.errors import DatasetError, MirrorError, SchemaError
from mirror.schema.documents import DatasetDocument
from mirror.schema.files import parse_json
from mirror.schema.hashing import hash_document
from mirror.schema.snapshot import SNAPSHOTS, IndexSnapshot


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


def open_snapshot(store: Store, at: int | None = None) -> tuple[Store, int, IndexSnapshot, str]:
    """Open a snapshot of the index.

    Args:
        store: the dataset.
        at: number of the snapshot; None: the newest one.

    Returns:
        The store as of that snapshot, the snapshot's number, the snapshot, and the hash of what it holds: equal for
        equal datasets whose index is compact.

    Raises:
        DatasetError: the dataset has no index or no such snapshot, or files of its rows have been replaced
            since, or an image of its rows was taken down.
        SchemaError: the snapshot is invalid.
    """
    numbers = list_snapshots(store)
    if not numbers:
        raise _no_index_error(store)
    held, number = store, numbers[-1] if at is None else at
    if store.folder is not None:
        # The newest one may be another one by now.
        generation = Generation.current(store.folder) if at is None else Generation.find(store.folder, at)
        held, number = Store(store.root, generation), number if generation is None else generation.number
    if number not in numbers and (at is not None or held.generation is None):
        raise DatasetError(
            f"there is no snapshot {number}", file=store.full_path(SNAPSHOTS),
            expected=f"a number from {numbers[0]} to {numbers[-1]}", remedy="choose another number, or open the newest",
        )  # fmt: skip
    if number < numbers[-1]:
        oldest = read_snapshot(store, numbers[-1]).oldest
        if number < oldest:
            raise DatasetError(
                f"files of snapshot {number} have been replaced or removed since", file=store.full_path(SNAPSHOTS),
                expected=f"a number from {oldest} to {numbers[-1]}", remedy="choose another number, or open the newest",
            )  # fmt: skip
    snapshot = read_snapshot(held, number)
    if number < numbers[-1]:
        require_all_rows(store, number, snapshot.drives)
    return held, number, snapshot, hash_snapshot(snapshot)


def hash_snapshot(snapshot: IndexSnapshot) -> str:
    """Return a hash of what a snapshot holds: of one whole segment, that of its manifest."""
    if len(snapshot.segments) == 1 and snapshot.segments[0].is_whole:
        return snapshot.segments[0].manifest
    return hash_document([segment.model_dump(mode="json") for segment in snapshot.segments])


def find_staleness(store: Store) -> MirrorError | None:
    """Return the reason why the newest snapshot is stale; None if it is current.

    Raises:
        DatasetError: a file of the index is missing or has changed.
        SchemaError: a file of the index is invalid.
    """
    state = read_state(store)
    if state is None:
        return _no_index_error(store)
    try:
        inputs = read_inputs(store)
    except (DatasetError, SchemaError) as error:
        return error
    changed = describe_changes(find_changes(state.sources, inputs))
    if not changed:
        return None
    return DatasetError(
        f"the index is stale: {len(changed)} of its sources changed ({', '.join(changed[:3])} ...)",
        file=store.full_path("index"),
        expected="an index derived from the present files",
        remedy=f"run `mirror index {store.root}`",
    )


def _no_index_error(store: Store) -> DatasetError:
    return DatasetError(
        "the dataset has no index", file=store.full_path("index"), remedy=f"run `mirror index {store.root}`"
    )
