"""A drive ingested anew: the old one is set aside until the new one is sealed, and comes back if it never is."""

from __future__ import annotations

import shutil
from pathlib import Path

from mirror.dataset.layout import Layout, read_manifest
from mirror.schema.files import read_table
from mirror.schema.tables import PASSES

_ASIDE = ".replaced."


def set_aside(layout: Layout, drive_id: str) -> None:
    """Move a complete drive and its traversals out of the way; nothing happens where there is none."""
    folder = layout.drive(drive_id)
    if read_manifest(folder) is None:
        return
    names = read_table(folder / "passes.parquet", PASSES, ["traversal_id"]).column("traversal_id").to_pylist()
    # The drive goes first: without it the traversals do not count, whatever happens next.
    for one in (folder, *(layout.traversal(name) for name in names if name is not None)):
        if one.is_dir():
            shutil.rmtree(_aside(one), ignore_errors=True)
            one.rename(_aside(one))


def settle(layout: Layout) -> None:
    """Finish every replacement: drop the old where the new drive is sealed, else bring the old back."""
    for aside in sorted((layout.root / "drives").glob(f"{_ASIDE}*")):
        drive_id = aside.name.removeprefix(_ASIDE)
        sealed = read_manifest(layout.drive(drive_id)) is not None
        for folder in sorted((layout.root / "traversals").glob(f"{_ASIDE}*.{drive_id}.*")):
            _drop(folder) if sealed else _bring_back(folder)
        # Last, so that an interruption finds the drive still aside and settles the rest.
        _drop(aside) if sealed else _bring_back(aside)


def _aside(folder: Path) -> Path:
    return folder.with_name(_ASIDE + folder.name)


def _drop(aside: Path) -> None:
    shutil.rmtree(aside)


def _bring_back(aside: Path) -> None:
    folder = aside.with_name(aside.name.removeprefix(_ASIDE))
    shutil.rmtree(folder, ignore_errors=True)
    aside.rename(folder)
