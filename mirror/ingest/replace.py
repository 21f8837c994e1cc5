"""A drive's folder replaced: the old one is set aside until the new one is sealed, and comes back if it never is."""

from __future__ import annotations

import shutil
from pathlib import Path

from mirror.dataset.layout import Layout, complete_manifest
from mirror.schema.files import TEMPORARY, unwritable

_ASIDE = ".replaced."
_SEALING = ".sealing."


def set_aside(layout: Layout, drive_id: str) -> None:
    """Move a complete drive and its traversals out of the way; nothing happens where there is none."""
    folder = layout.drive(drive_id)
    if complete_manifest(folder) is None:
        return
    # The drive goes first: without it the traversals do not count, whatever happens next.
    for one in (folder, *sorted((layout.root / "traversals").glob(f"[!.]*.{drive_id}.*"))):
        _move(one, _beside(one, _ASIDE))


def sealing_folder(layout: Layout, drive_id: str) -> Path:
    """An empty folder in which a drive is made ready, beside its own."""
    folder = _beside(layout.drive(drive_id), _SEALING)
    shutil.rmtree(folder, ignore_errors=True)
    return folder


def publish(layout: Layout, drive_id: str) -> None:
    """Put a drive that was made ready in the place of its folder; the old one stays aside until `settle`."""
    folder = layout.drive(drive_id)
    if complete_manifest(folder) is not None:
        _move(folder, _beside(folder, _ASIDE))
    _move(_beside(folder, _SEALING), folder)


def settle(layout: Layout) -> None:
    """Finish every replacement: drop the old where the new drive is sealed, else bring the old back.

    What a killed run left under temporary names goes too.

    Raises:
        DatasetError: the dataset's folders cannot be written.
    """
    drives, traversals = layout.root / "drives", layout.root / "traversals"
    try:
        for aside in sorted(drives.glob(f"{_ASIDE}*")):
            drive_id = aside.name.removeprefix(_ASIDE)
            sealed = complete_manifest(layout.drive(drive_id)) is not None
            for folder in sorted(traversals.glob(f"{_ASIDE}*.{drive_id}.*")):
                _drop(folder) if sealed else _bring_back(folder)
            # Last, so that an interruption finds the drive still aside and settles the rest.
            _drop(aside) if sealed else _bring_back(aside)
        for left in drives.glob(f"{_SEALING}*"):
            _drop(left)
        for folder in (layout.root, layout.root / "rigs", layout.root / "splits"):
            for left in folder.glob(f".*{TEMPORARY}"):
                left.unlink()
    except OSError as error:
        raise unwritable(layout.root, error) from error


def _beside(folder: Path, prefix: str) -> Path:
    return folder.with_name(prefix + folder.name)


def _move(folder: Path, target: Path) -> None:
    try:
        shutil.rmtree(target, ignore_errors=True)
        folder.rename(target)
    except OSError as error:
        raise unwritable(target, error) from error


def _drop(aside: Path) -> None:
    shutil.rmtree(aside)


def _bring_back(aside: Path) -> None:
    folder = aside.with_name(aside.name.removeprefix(_ASIDE))
    shutil.rmtree(folder, ignore_errors=True)
    aside.rename(folder)
