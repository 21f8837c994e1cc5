"""Adding layers to a dataset: its index is current before and after, also where a run was interrupted."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mirror.dataset.dataset import Dataset
from mirror.dataset.dataset import open as open_dataset
from mirror.dataset.index.build import build_index
from mirror.dataset.layout import Layout, require_dataset
from mirror.dataset.lock import writer_lock
from mirror.dataset.opening import find_staleness
from mirror.dataset.store import Store
from mirror.errors import DatasetError, SchemaError, UnwritableError


def open_to_write(path: str | os.PathLike[str]) -> Dataset:
    """Open a dataset to which layers are added.

    A run that was killed after it had written a layer leaves an index without it. So that the same command can
    continue, the index is derived again here; a dataset that is only read is opened with `mirror.open`, which names
    the command that does so.

    Args:
        path: the dataset's folder; a URL is opened as `mirror.open` does.

    Raises:
        DatasetError: the folder has no dataset, its files are missing or differ, or another run is writing it.
        SchemaError: a document is broken, or its schema version is one that this toolkit does not read.
    """
    store = Store(path)
    if store.folder is None:
        return open_dataset(path)
    layout = Layout(Path(path))
    require_dataset(layout)
    if is_to_be_indexed(store):
        with writer_lock(layout, wait=False):
            build_index(layout.root)
    return open_dataset(path)


def is_to_be_indexed(store: Store) -> bool:
    """Return whether the newest snapshot lacks present files, or is missing or damaged."""
    try:
        return find_staleness(store) is not None
    except (DatasetError, SchemaError):
        # Deriving the index mends it, or names what else is wrong.
        return True


@contextmanager
def naming_option(root: Path, option: str) -> Iterator[None]:
    """Add an option to errors about dataset files that the block cannot write, as the way to write elsewhere.

    Args:
        root: folder of the dataset.
        option: the option, with its value.

    Raises:
        UnwritableError: as the block raises it, with the option in its remedy.
    """
    try:
        yield
    except UnwritableError as error:
        if error.file is not None and Path(error.file).resolve().is_relative_to(root.resolve()):
            error.name_option(option)
        raise


@contextmanager
def writing_layers(layout: Layout, *, wait: bool = False) -> Iterator[None]:
    """Hold the dataset's writer lock while layers are written, and index the complete layers at the end.

    That holds also where the block ends with an error or Ctrl-C: the next command finds a valid index.

    Args:
        layout: the dataset.
        wait: True: wait for another writer to end; False: raise an error at once.

    Raises:
        DatasetError: another process holds the lock and ``wait`` is false, or the dataset cannot be written.
    """
    with writer_lock(layout, wait=wait):
        try:
            yield
        finally:
            build_index(layout.root)
