"""Generations of a dataset: a reader goes on reading what it opened while a run replaces it.

The index's manifest is a generation. Before a run changes a file or folder that a generation names, it moves it to
`.superseded/<number>.<generation>/`, at the same relative path (`supersede`). A reader of a generation looks there
first, in the layer of its own generation and then in those after it: what it finds is what its generation named. It
holds a shared lock on its manifest, so that `release` removes layers once no reader needs them.
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

from mirror.dataset.layout import MANIFEST, Layout, complete_manifest
from mirror.schema.files import TEMPORARY, sha256_bytes, unmovable_error

FOLDER: Final = ".superseded"
UNLOCKABLE_AGE_S: Final = 24 * 3600
"""Where the file system has no locks, nobody knows of readers: what was superseded is removed after a day."""

_INDEX: Final = f"index/{MANIFEST}"
_NONE: Final = "none"
_PATIENCE_S: Final = 10.0
_PAUSE_S: Final = 0.005
_moving: Final = threading.Lock()


class Generation:
    """A generation that a reader has opened and holds.

    Attributes:
        root: the dataset's folder.
        manifest: bytes of the index's manifest.
        sha256: of them.
    """

    def __init__(self, root: Path, handle: int, manifest: bytes) -> None:
        self.root = root
        self.manifest = manifest
        self.sha256 = sha256_bytes(manifest)
        self._handle = handle
        weakref.finalize(self, os.close, handle)

    @classmethod
    def current(cls, root: Path) -> Generation:
        """The generation that a dataset is at now.

        Raises:
            FileNotFoundError: the dataset has no index.
        """
        end = time.monotonic() + _PATIENCE_S
        while True:
            found = cls._held(root, root / _INDEX)
            if found is not None:
                return found
            # Between two generations, or on the way to being superseded.
            if time.monotonic() > end:
                raise FileNotFoundError(root / _INDEX)
            if not (root / FOLDER).exists() and not (root / _INDEX).exists():
                raise FileNotFoundError(root / _INDEX)
            time.sleep(_PAUSE_S)

    @classmethod
    def find(cls, root: Path, sha256: str) -> Generation | None:
        """A generation by its hash, the current or a superseded one; None: it is gone."""
        for path in (root / _INDEX, *(layer / _INDEX for layer in _layers(root)), root / _INDEX):
            found = cls._held(root, path)
            if found is not None and found.sha256 == sha256:
                return found
        return None

    @classmethod
    def _held(cls, root: Path, path: Path) -> Generation | None:
        """The generation of a manifest, locked; None: the file is not there, or another has taken its place."""
        try:
            handle = os.open(path, os.O_RDONLY)
        except (FileNotFoundError, NotADirectoryError):
            return None
        try:
            # A file system without locks: `UNLOCKABLE_AGE_S` stands in for them.
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
        """Whether no later generation has taken this one's place."""
        try:
            return os.path.samestat(os.fstat(self._handle), (self.root / _INDEX).stat())
        except FileNotFoundError:
            return False

    def locate(self, path: str) -> Path | None:
        """Where a file of this generation was moved to; None: it is where it was.

        Args:
            path: relative to the dataset's root.
        """
        unit = _unit(path)
        own = False
        for layer in _layers(self.root):
            own = own or layer.name.endswith(f".{self.sha256[:16]}")
            if own and (layer / unit).exists():
                return layer / path
        return None


def supersede(layout: Layout, path: Path) -> None:
    """Move a file, or the folder of a drive or traversal, out of the way; the caller holds the dataset's writer lock.

    What was put there since the current generation is in the way of nobody, and is removed.

    Args:
        layout: the dataset.
        path: below its root; nothing happens if it is not there.

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
    """Finish what an interrupted run was replacing: a drive that is not complete again comes back as it was.

    What a killed run left under the temporary names of files goes too. The caller holds the dataset's writer lock.

    Raises:
        DatasetError: the dataset's folders cannot be written.
    """
    try:
        for folder in (layout.root, layout.root / "rigs", layout.root / "splits"):
            for left in folder.glob(f".*{TEMPORARY}"):
                left.unlink()
        layer = _layer_of(layout, _generation(layout))
        if layer is None:
            return
        for drive in sorted((layer / "drives").glob("*")):
            if complete_manifest(layout.drive(drive.name)) is not None:
                continue
            for traversal in sorted((layer / "traversals").glob(f"*.{drive.name}.*")):
                _restore(layout, traversal, layout.traversal(traversal.name))
            # Last, so that an interruption finds the drive still aside and brings back the rest.
            _restore(layout, drive, layout.drive(drive.name))
        for traversal in sorted((layer / "traversals").glob("*")):
            if not layout.traversal(traversal.name).exists():
                _restore(layout, traversal, layout.traversal(traversal.name))
        if {one.relative_to(layer).as_posix() for one in layer.rglob("*") if not one.is_dir()} <= {_INDEX}:
            _remove(layout, layer)
            with suppress(OSError):
                (layout.root / FOLDER).rmdir()
    except OSError as error:
        raise unmovable_error(layout.root, error) from error


def release(layout: Layout) -> None:
    """Remove what was superseded and no reader needs; the caller holds the writer lock, and the index is up to date."""
    current = _generation(layout)
    needed = False
    for layer in _layers(layout.root):
        # What is in a layer of the current generation was replaced by the same: nobody needs it, and readers that open
        # the dataset now must not find it.
        same = layer.name.endswith(f".{current}")
        needed = needed or (not same and _has_readers(layer))
        if same or not needed:
            _remove(layout, layer)
    for left in (layout.root / FOLDER).glob(".*"):
        _remove(layout, left)
    with suppress(OSError):
        (layout.root / FOLDER).rmdir()


def _unit(path: str) -> PurePosixPath:
    """What is moved as a whole: the folder of a traversal or drive, else the file."""
    parts = PurePosixPath(path).parts
    return PurePosixPath(*parts[:2]) if parts[:1] in (("traversals",), ("drives",)) else PurePosixPath(path)


def _layers(root: Path) -> list[Path]:
    """Superseded layers, the oldest first."""
    try:
        names = os.listdir(root / FOLDER)  # noqa: PTH208 - names are all that is needed, and it is called often
    except (FileNotFoundError, NotADirectoryError):
        return []
    numbered = [(int(number), name) for name in names for number in [name.partition(".")[0]] if number.isdigit()]
    return [root / FOLDER / name for _, name in sorted(numbered)]


def _generation(layout: Layout) -> str:
    """What names the current generation's layer."""
    try:
        return sha256_bytes((layout.root / _INDEX).read_bytes())[:16]
    except FileNotFoundError:
        return _NONE


def _layer_of(layout: Layout, generation: str) -> Path | None:
    """The newest layer, if it is of a generation."""
    last = _layers(layout.root)[-1:]
    return last[0] if last and last[0].name.endswith(f".{generation}") else None


def _current_layer(layout: Layout) -> Path:
    """The layer of the current generation; made with its manifest, by which readers hold it."""
    generation = _generation(layout)
    layer = _layer_of(layout, generation)
    if layer is not None:
        return layer
    number = max((int(one.name.partition(".")[0]) for one in _layers(layout.root)), default=0) + 1
    begun = layout.root / FOLDER / f".{secrets.token_hex(6)}"
    (begun / "index").mkdir(parents=True)
    if (layout.root / _INDEX).exists():
        try:
            os.link(layout.root / _INDEX, begun / _INDEX)
        except OSError:
            # A file system without hard links; readers cannot hold what is copied, and open the dataset again.
            shutil.copyfile(layout.root / _INDEX, begun / _INDEX)
    layer = layout.root / FOLDER / f"{number}.{generation}"
    begun.rename(layer)
    return layer


def _has_readers(layer: Path) -> bool:
    """Whether a reader holds the generation of a layer."""
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


def _restore(layout: Layout, aside: Path, target: Path) -> None:
    if target.exists():
        _remove(layout, target)
    aside.rename(target)


def _remove(layout: Layout, path: Path) -> None:
    """Remove a file or folder: it is gone at once, and never half there."""
    (layout.root / FOLDER).mkdir(exist_ok=True)
    gone = layout.root / FOLDER / f".{secrets.token_hex(6)}"
    path.rename(gone)
    if gone.is_dir():
        shutil.rmtree(gone, ignore_errors=True)
    else:
        gone.unlink(missing_ok=True)
