"""A copy of a dataset that may be written, for layers of a dataset that is only read."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from mirror.dataset.dataset import Dataset
from mirror.dataset.door.placing import place_file
from mirror.dataset.index.build import build_index
from mirror.dataset.layout import Layout, require_dataset
from mirror.dataset.lock import writer_lock
from mirror.dataset.writing import open_to_write
from mirror.errors import UsageError
from mirror.schema.files import write_bytes
from mirror.schema.folders import FolderKind, require_output_folder

_TABLES: Final = (".parquet", ".json")
_WITH_IMAGES: Final = ("recorded", "redaction")
_MARK: Final = ".copy-of"


def update_working_copy(root: Path, folder: Path, split: str, *, place: str) -> Dataset:
    """Copy the files of a dataset that one split reads, or bring a copy up to date.

    Layers that only the copy has stay.

    Images of the split's traversals are hard links where possible, and no other images are copied. The dataset is not
    changed: no lock and no index is written there.

    Args:
        root: folder of the dataset.
        folder: a new folder, or the copy that an earlier call made.
        split: name of the split.
        place: the option that names the folder, for messages.

    Returns:
        The copy.

    Raises:
        UsageError: the dataset is not a local folder, the folder has something else, or lies in the dataset.
        DatasetError: a file is missing, the folder cannot be written, or another run is writing it.
    """
    if "://" in str(root):
        raise UsageError(
            "a remote dataset", file=root, place=place, expected="a local folder",
            remedy="`mirror dataset fetch URL --out FOLDER` copies a published dataset",
        )  # fmt: skip
    require_dataset(Layout(root))
    if folder.resolve() == root.resolve():
        raise UsageError("the folder of the dataset itself", file=folder, place=place, expected="another folder")
    if require_output_folder(folder, FolderKind.DATASET, place=place) is not None:
        _require_copy_of(root, folder, place)
    with writer_lock(Layout(folder), wait=False):
        write_bytes(folder / _MARK, f"{root.resolve()}\n".encode())
        for name in _list_tables(root):
            place_file(root, name, folder)
        build_index(folder)
    copy = open_to_write(folder)
    for uri in sorted(set(copy.where(split=split).table("images", ["uri"]).column(0).to_pylist())):
        if "://" not in uri and not uri.startswith("/"):
            place_file(root, uri, folder)
    return copy


def _require_copy_of(root: Path, folder: Path, place: str) -> None:
    mark = folder / _MARK
    if not mark.is_file() or mark.read_text() != f"{root.resolve()}\n":
        raise UsageError(
            "another dataset: nothing was written", file=folder, place=place,
            expected=f"a new folder, or the copy of {root} that an earlier call made",
            remedy=f"name another folder with {place}",
        )  # fmt: skip


def _list_tables(root: Path) -> Iterator[str]:
    """Paths of all files but the index, images and what an interrupted writer left."""
    for at, folders, files in os.walk(root):
        below = Path(at).relative_to(root)
        folders[:] = sorted(name for name in folders if not name.startswith(".") and (below / name) != Path("index"))
        for name in sorted(files):
            has_images = below.parts[:1] == ("traversals",) and any(part in _WITH_IMAGES for part in below.parts[2:4])
            if not name.startswith(".") and (Path(name).suffix in _TABLES or not has_images):
                yield (below / name).as_posix()
