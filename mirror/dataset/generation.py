"""Generations of a dataset: a reader keeps reading the snapshot that it opened while a run replaces files.

The files of the index never change. Drives, traversals and maps do where a run replaces them: before that, `supersede`
moves them to `.superseded/<number>.<snapshot>/`, at the same relative path, where `snapshot` is the newest one whose
rows name them. A reader searches there first, in the layers of its own snapshot and of later ones: the first match is
the file of its snapshot. A reader holds a shared lock on its snapshot, so `release` can remove the layers that no
reader needs.
"""

from __future__ import annotations

import fcntl
import os
import secrets
import shutil
import threading
import time
import weakref
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Final

from mirror.dataset.layout import MANIFEST, MAPS, Layout, complete_manifest
from mirror.schema.files import TEMPORARY, sha256_bytes, unmovable_error
from mirror.schema.links import require_inside
from mirror.schema.snapshot import SNAPSHOTS, snapshot_number, snapshot_path

FOLDER: Final = ".superseded"
UNLOCKABLE_AGE_S: Final = 24 * 3600
"""Without locks in the file system, readers are unknown: superseded files are then removed after one day."""

_OLD_INDEX: Final = f"index/{MANIFEST}"
"""The manifest of the index of datasets of earlier versions."""
_MOVED_WHOLE: Final = (("traversals",), ("drives",), (MAPS,))
_NONE: Final = "none"
_moving: Final = threading.Lock()


class Generation:
    """A snapshot that a reader has opened and locked.

    Attributes:
        root: the dataset's folder.
        number: number of the snapshot.
        snapshot: bytes of its document.
    """

    def __init__(self, root: Path, number: int, handle: int, snapshot: bytes) -> None:
        self.root = root
        self.number = number
        self.snapshot = snapshot
        self._handle = handle
        weakref.finalize(self, os.close, handle)

    @classmethod
    def current(cls, root: Path) -> Generation:
        """Open the newest snapshot of a dataset.

        Raises:
            FileNotFoundError: the dataset has no index.
        """
        while True:
            numbers = _numbers(root)
            if not numbers:
                raise FileNotFoundError(root / SNAPSHOTS)
            generation = cls.find(root, numbers[-1])
            # None: it was removed at this moment, so that there is a newer one.
            if generation is not None:
                return generation

    @classmethod
    def find(cls, root: Path, number: int) -> Generation | None:
        """Open and lock a snapshot; None if there is none of this number."""
        path = require_inside(root, snapshot_path(number))
        try:
            handle = os.open(path, os.O_RDONLY)
        except (FileNotFoundError, NotADirectoryError):
            return None
        try:
            # Without locks in the file system, `UNLOCKABLE_AGE_S` decides.
            with suppress(OSError):
                fcntl.flock(handle, fcntl.LOCK_SH)
            if os.path.samestat(os.fstat(handle), os.stat(path)):  # noqa: PTH116 - beside fstat
                with os.fdopen(os.dup(handle), "rb") as file:
                    return cls(root, number, handle, file.read())
        except FileNotFoundError:
            pass
        os.close(handle)
        return None

    def locate(self, path: str) -> Path | None:
        """Return the place to which a file of this generation was moved; None if it was not moved.

        Args:
            path: relative to the dataset's root.
        """
        unit = _unit(path)
        if unit.parts[:1] == ("index",):
            return None
        for layer in _layers(self.root):
            # The layers of earlier versions are named after hashes, and end before the first snapshot.
            name = layer.name.partition(".")[2]
            if name.isdigit() and int(name) >= self.number and (layer / unit).exists():
                return layer / path
        return None


def supersede(layout: Layout, path: Path) -> None:
    """Move a file, or the folder of a drive, traversal or map, to where readers of older generations find it.

    The caller holds the dataset's writer lock and the lock of replacements. A file or folder that was written after the
    current generation has no reader and is removed.

    Args:
        layout: the dataset.
        path: a path below its root; nothing happens if it does not exist.

    Raises:
        DatasetError: it cannot be moved.
    """
    with _moving:
        try:
            if not path.exists():
                return
            kept = _current_layer(layout) / path.relative_to(layout.root)
            if kept.exists():
                _remove(layout, path)
                return
            kept.parent.mkdir(parents=True, exist_ok=True)
            path.rename(kept)
        except OSError as error:
            raise unmovable_error(path, error) from error


def recover(layout: Layout) -> None:
    """Repair the dataset after an interrupted run: restore the drives and maps that the run replaced only in part.

    Temporary files of a killed run are removed. The caller holds the dataset's writer lock.

    Raises:
        DatasetError: the dataset's folders cannot be written.
    """
    try:
        for folder in (layout.root, layout.root / "rigs", layout.root / "splits"):
            for temporary in folder.glob(f".*{TEMPORARY}"):
                temporary.unlink()
        for temporary in layout.snapshots.glob(f".*{TEMPORARY}"):
            # Others may be putting a snapshot now.
            if time.time() - temporary.stat().st_mtime > UNLOCKABLE_AGE_S:
                temporary.unlink(missing_ok=True)
        layer = _layer_of(layout, _generation(layout))
        if layer is None:
            return
        for drive in sorted((layer / "drives").glob("*")):
            if complete_manifest(layout.drive(drive.name)) is not None:
                continue
            for traversal in sorted((layer / "traversals").glob(f"*.{drive.name}.*")):
                _restore(layout, traversal, layout.traversal(traversal.name))
            # The drive comes last: after an interruption, the next run still finds it here and restores the rest.
            _restore(layout, drive, layout.drive(drive.name))
        for folder in sorted((*(layer / "traversals").glob("*"), *(layer / MAPS).glob("*"))):
            if not (layout.root / folder.relative_to(layer)).exists():
                _restore(layout, folder, layout.root / folder.relative_to(layer))
        if {path.relative_to(layer).as_posix() for path in layer.rglob("*") if not path.is_dir()} <= {_OLD_INDEX}:
            _remove(layout, layer)
            with suppress(OSError):
                (layout.root / FOLDER).rmdir()
    except OSError as error:
        raise unmovable_error(layout.root, error) from error


def release(layout: Layout) -> None:
    """Remove the superseded layers that no reader needs.

    The caller holds the writer lock, and the index is up to date.
    """
    layers = _layers(layout.root)
    if not layers and not (layout.root / FOLDER).exists():
        return
    numbers = _numbers(layout.root)
    current = _generation(layout)
    for layer in layers:
        # Files in a layer of the current generation were replaced by equal ones: no reader needs them, and readers that
        # open the dataset now must not find them.
        name = layer.name.partition(".")[2]
        if (
            name == current
            or not name.isdigit()
            or not any(has_readers(layout, number, layer) for number in numbers if number <= int(name))
        ):
            _remove(layout, layer)
    for unfinished in (layout.root / FOLDER).glob(".*"):
        _remove(layout, unfinished)
    with suppress(OSError):
        (layout.root / FOLDER).rmdir()


def _unit(path: str) -> PurePosixPath:
    """The path that is moved as a whole: the folder of a traversal, a drive or a map, else the file."""
    parts = PurePosixPath(path).parts
    return PurePosixPath(*parts[:2]) if parts[:1] in _MOVED_WHOLE else PurePosixPath(path)


def _layers(root: Path) -> list[Path]:
    """Superseded layers, the oldest first."""
    try:
        names = os.listdir(root / FOLDER)  # noqa: PTH208 - names are all that is needed, and it is called often
    except (FileNotFoundError, NotADirectoryError):
        return []
    numbered = [(int(number), name) for name in names for number in [name.partition(".")[0]] if number.isdigit()]
    return [root / FOLDER / name for _, name in sorted(numbered)]


def _numbers(root: Path) -> list[int]:
    """Numbers of the snapshots, in order."""
    try:
        names = os.listdir(require_inside(root, SNAPSHOTS))  # noqa: PTH208 - names are all that is needed
    except (FileNotFoundError, NotADirectoryError):
        return []
    return sorted(number for name in names if (number := snapshot_number(name)) is not None)


def _generation(layout: Layout) -> str:
    """The name of the current generation in the names of layers."""
    numbers = _numbers(layout.root)
    if numbers:
        return str(numbers[-1])
    try:
        # A dataset of an earlier version, which is about to be migrated.
        return sha256_bytes((layout.root / _OLD_INDEX).read_bytes())[:16]
    except FileNotFoundError:
        return _NONE


def _layer_of(layout: Layout, generation: str) -> Path | None:
    """The newest layer, if it belongs to a generation; else None."""
    last = _layers(layout.root)[-1:]
    return last[0] if last and last[0].name.endswith(f".{generation}") else None


def _current_layer(layout: Layout) -> Path:
    """The layer of the current generation."""
    generation = _generation(layout)
    layer = _layer_of(layout, generation)
    if layer is not None:
        return layer
    number = max((int(path.name.partition(".")[0]) for path in _layers(layout.root)), default=0) + 1
    layer = layout.root / FOLDER / f"{number}.{generation}"
    layer.mkdir(parents=True)
    return layer


def has_readers(layout: Layout, number: int, layer: Path) -> bool:
    """Return whether a reader has locked a snapshot; without locks, whether a file changed within the last day."""
    try:
        with (layout.root / snapshot_path(number)).open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except BlockingIOError:
        return True
    except OSError:
        return time.time() - layer.stat().st_mtime < UNLOCKABLE_AGE_S
    return False


def _restore(layout: Layout, superseded: Path, target: Path) -> None:
    """Move a superseded folder back to its place."""
    if target.exists():
        _remove(layout, target)
    superseded.rename(target)


def _remove(layout: Layout, path: Path) -> None:
    """Remove a file or folder. A rename makes it disappear at once, so no reader finds it in part."""
    (layout.root / FOLDER).mkdir(exist_ok=True)
    removed = layout.root / FOLDER / f".{secrets.token_hex(6)}"
    path.rename(removed)
    if removed.is_dir():
        shutil.rmtree(removed, ignore_errors=True)
    else:
        removed.unlink(missing_ok=True)
