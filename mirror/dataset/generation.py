"""Generations of a dataset: a reader keeps reading the state that it opened while a run replaces files.

The manifest of the index identifies a generation. Before a run changes a file or folder of a generation, `supersede`
moves it to `.superseded/<number>.<generation>/`, at the same relative path. A reader searches there first, in the layer
of its own generation and then in the later ones: the first match is the file of its generation. A reader holds a shared
lock on its manifest, so `release` can remove the layers that no reader needs.
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

FOLDER: Final = ".superseded"
UNLOCKABLE_AGE_S: Final = 24 * 3600
"""Without locks in the file system, readers are unknown: superseded files are then removed after one day."""

_INDEX: Final = f"index/{MANIFEST}"
_MOVED_WHOLE: Final = (("traversals",), ("drives",), (MAPS,))
_NONE: Final = "none"
_PATIENCE_S: Final = 10.0
_PAUSE_S: Final = 0.005
_moving: Final = threading.Lock()


class Generation:
    """A generation that a reader has opened and locked.

    Attributes:
        root: the dataset's folder.
        manifest: bytes of the index's manifest.
        sha256: hash of these bytes.
    """

    def __init__(self, root: Path, handle: int, manifest: bytes) -> None:
        self.root = root
        self.manifest = manifest
        self.sha256 = sha256_bytes(manifest)
        self._handle = handle
        weakref.finalize(self, os.close, handle)

    @classmethod
    def current(cls, root: Path) -> Generation:
        """Open the current generation of a dataset.

        Raises:
            FileNotFoundError: the dataset has no index.
        """
        end = time.monotonic() + _PATIENCE_S
        while True:
            generation = cls._open_locked(root, root / _INDEX)
            if generation is not None:
                return generation
            # The manifest is being replaced: try again.
            if time.monotonic() > end:
                raise FileNotFoundError(root / _INDEX)
            if not (root / FOLDER).exists() and not (root / _INDEX).exists():
                raise FileNotFoundError(root / _INDEX)
            time.sleep(_PAUSE_S)

    @classmethod
    def find(cls, root: Path, sha256: str) -> Generation | None:
        """Open a generation by its hash, whether current or superseded; None if it no longer exists."""
        for path in (root / _INDEX, *(layer / _INDEX for layer in _layers(root)), root / _INDEX):
            generation = cls._open_locked(root, path)
            if generation is not None and generation.sha256 == sha256:
                return generation
        return None

    @classmethod
    def _open_locked(cls, root: Path, path: Path) -> Generation | None:
        """Open and lock the generation of a manifest; None: the file is missing or has been replaced."""
        try:
            handle = os.open(require_inside(root, path.relative_to(root)), os.O_RDONLY)
        except (FileNotFoundError, NotADirectoryError):
            return None
        try:
            # Without locks in the file system, `UNLOCKABLE_AGE_S` decides.
            with suppress(OSError):
                fcntl.flock(handle, fcntl.LOCK_SH)
            if os.path.samestat(os.fstat(handle), os.stat(path)):  # noqa: PTH116 - beside fstat
                with os.fdopen(os.dup(handle), "rb") as file:
                    return cls(root, handle, file.read())
        except FileNotFoundError:
            pass
        os.close(handle)
        return None

    def is_current(self) -> bool:
        """Return whether no later generation has replaced this one."""
        try:
            return os.path.samestat(os.fstat(self._handle), (self.root / _INDEX).stat())
        except FileNotFoundError:
            return False

    def locate(self, path: str) -> Path | None:
        """Return the place to which a file of this generation was moved; None if it was not moved.

        Args:
            path: relative to the dataset's root.
        """
        unit = _unit(path)
        is_reached = False
        for layer in _layers(self.root):
            is_reached = is_reached or layer.name.endswith(f".{self.sha256[:16]}")
            if is_reached and (layer / unit).exists():
                return layer / path
        return None


def supersede(layout: Layout, path: Path) -> None:
    """Move a file, or the folder of a drive, traversal or map, to where readers of older generations find it.

    The caller holds the dataset's writer lock. A file or folder that was written after the current generation has no
    reader and is removed.

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
        if {path.relative_to(layer).as_posix() for path in layer.rglob("*") if not path.is_dir()} <= {_INDEX}:
            _remove(layout, layer)
            with suppress(OSError):
                (layout.root / FOLDER).rmdir()
    except OSError as error:
        raise unmovable_error(layout.root, error) from error


def release(layout: Layout) -> None:
    """Remove the superseded layers that no reader needs.

    The caller holds the writer lock, and the index is up to date.
    """
    current = _generation(layout)
    needed = False
    for layer in _layers(layout.root):
        # Files in a layer of the current generation were replaced by equal ones: no reader needs them, and readers that
        # open the dataset now must not find them.
        is_current = layer.name.endswith(f".{current}")
        needed = needed or (not is_current and _has_readers(layer))
        if is_current or not needed:
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


def _generation(layout: Layout) -> str:
    """The name of the current generation in the names of layers."""
    try:
        return sha256_bytes((layout.root / _INDEX).read_bytes())[:16]
    except FileNotFoundError:
        return _NONE


def _layer_of(layout: Layout, generation: str) -> Path | None:
    """The newest layer, if it belongs to a generation; else None."""
    last = _layers(layout.root)[-1:]
    return last[0] if last and last[0].name.endswith(f".{generation}") else None


def _current_layer(layout: Layout) -> Path:
    """The layer of the current generation. A new one gets the manifest, which readers lock."""
    generation = _generation(layout)
    layer = _layer_of(layout, generation)
    if layer is not None:
        return layer
    number = max((int(path.name.partition(".")[0]) for path in _layers(layout.root)), default=0) + 1
    unfinished = layout.root / FOLDER / f".{secrets.token_hex(6)}"
    (unfinished / "index").mkdir(parents=True)
    if (layout.root / _INDEX).exists():
        try:
            os.link(layout.root / _INDEX, unfinished / _INDEX)
        except OSError:
            # Without hard links the manifest is copied. Readers cannot lock the copy and must open the dataset again.
            shutil.copyfile(layout.root / _INDEX, unfinished / _INDEX)
    layer = layout.root / FOLDER / f"{number}.{generation}"
    unfinished.rename(layer)
    return layer


def _has_readers(layer: Path) -> bool:
    """Return whether a reader has locked the generation of a layer."""
    try:
        with (layer / _INDEX).open("rb") as file:
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
