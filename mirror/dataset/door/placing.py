"""Placing a file of a dataset where it leaves, and the state of the dataset that it came from."""

from __future__ import annotations

import hashlib
import os
import shutil
from pathlib import Path
from typing import Final

from mirror.dataset.layout import MANIFEST, Layout
from mirror.errors import DatasetError
from mirror.schema.files import TEMPORARY, sha256_bytes, unwritable_error
from mirror.schema.links import require_inside
from mirror.schema.take_downs import TAKE_DOWNS

_LINKED: Final = (".jpg", ".jpeg", ".png")
"""Endings of files that are never opened for writing, so that a hard link suffices."""


def place_file(source_root: Path, name: str, target_root: Path) -> None:
    """Place a file below another root; an existing target is kept only if it has the bytes of the source.

    Args:
        source_root: the dataset.
        name: path of the file, relative to both roots.
        target_root: where it is placed.

    Raises:
        DatasetError: the source is missing, the target cannot be written, or a link leads out of one of the roots.
    """
    source, target = require_inside(source_root, name), require_inside(target_root, name)
    if is_same_file(source, target):
        return
    temporary = target.with_name(f".{target.name}.{os.getpid()}{TEMPORARY}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary.unlink(missing_ok=True)
        try:
            if source.suffix not in _LINKED:
                raise OSError
            os.link(source, temporary)
        except FileNotFoundError:
            raise
        except OSError:
            shutil.copyfile(source, temporary)
        temporary.replace(target)
    except FileNotFoundError as error:
        raise DatasetError(
            "missing", file=source, expected="a file of the dataset", remedy="`mirror check` lists all that is missing"
        ) from error
    except OSError as error:
        raise unwritable_error(target, error) from error
    finally:
        # Renaming a link to another link of the same file leaves both.
        temporary.unlink(missing_ok=True)


def is_same_file(source: Path, target: Path) -> bool:
    """Return whether a target exists and has the bytes of its source: as the same file, or by equal hashes."""
    try:
        if target.is_symlink() or not target.is_file() or target.stat().st_size != source.stat().st_size:
            return False
        return target.samefile(source) or hash_file(target) == hash_file(source)
    except FileNotFoundError:
        return False


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal; the file is read in parts, as videos are large.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def dataset_state(layout: Layout) -> dict[str, str]:
    """Return the SHA-256 of every document and manifest of a dataset, except its index, by path."""
    paths = [layout.document, layout.rois, layout.root / TAKE_DOWNS]
    for pattern in (
        f"drives/*/{MANIFEST}",
        f"traversals/*/recorded/{MANIFEST}",
        f"traversals/*/layers/*/*/{MANIFEST}",
        f"maps/*/{MANIFEST}",
        "rigs/*.json",
        "splits/*.json",
    ):
        paths += layout.root.glob(pattern)
    found = {}
    for path in sorted(paths):
        relative = path.relative_to(layout.root).as_posix()
        if not any(part.startswith(".") for part in path.relative_to(layout.root).parts) and path.is_file():
            found[relative] = sha256_bytes(path.read_bytes())
    return found


def require_unchanged(layout: Layout, before: dict[str, str]) -> None:
    """Require that a dataset's documents and manifests have not changed.

    Args:
        layout: the dataset.
        before: an earlier `dataset_state`.

    Raises:
        DatasetError: the dataset has changed since.
    """
    now = dataset_state(layout)
    changed = sorted(name for name in {*before, *now} if before.get(name) != now.get(name))
    if changed:
        raise DatasetError(
            f"it changed while it was read ({len(changed)} files): nothing was sealed",
            file=layout.root / changed[0],
            expected="a dataset that no other run writes",
            remedy="run the same command again when the other run has ended",
        )
