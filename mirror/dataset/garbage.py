"""Removal of what no reader of a dataset can reach any more, and that nobody changed for some time.

Runs never remove what another one may own; this does, on request. It holds the dataset's lease, which reaches other
machines, and its writer lock, which ends with its process, and waits for runs that are committing drives. What readers
have open on this machine stays, and so does whatever is younger than the age limit: a run on another machine may be
about to name it.
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mirror.dataset.destination import FolderDestination
from mirror.dataset.generation import has_readers
from mirror.dataset.index.segment import WORK
from mirror.dataset.index.snapshots import list_snapshots, read_snapshot, read_state
from mirror.dataset.layout import Layout, read_manifest, require_dataset
from mirror.dataset.lease import hold_lease
from mirror.dataset.lock import replacing, writer_lock
from mirror.dataset.owned_folder import abandoned_folders
from mirror.dataset.store import Store
from mirror.errors import UsageError
from mirror.schema.bundle import BUNDLE
from mirror.schema.files import remove_path
from mirror.schema.snapshot import snapshot_path

DEFAULT_AGE_S: Final = 7 * 24 * 3600
_SEGMENT: Final = re.compile(r"[0-9a-f]{16}")
_TRAVERSAL: Final = "traversal:"


@dataclass(frozen=True)
class GarbageReport:
    """Report of a removal: what was removed, or would be.

    Attributes:
        snapshots: numbers of snapshots.
        segments: names of segments of the index that no snapshot names.
        traversals: ids of traversals that no drive names.
        work_folders: folders of index builds whose process is dead.
        bytes: size of all files.
    """

    snapshots: tuple[int, ...]
    segments: tuple[str, ...]
    traversals: tuple[str, ...]
    work_folders: tuple[str, ...]
    bytes: int


def collect_garbage(
    root: Path, *, age_s: float = DEFAULT_AGE_S, dry_run: bool = False, wait: bool = False
) -> GarbageReport:
    """Remove old snapshots, segments that no snapshot names, and traversals that no drive names.

    The newest snapshot stays, and each that a reader of this machine has open.

    Args:
        root: the dataset's folder.
        age_s: seconds since the last change of what is removed.
        dry_run: report only.
        wait: wait for another run that writes the dataset.

    Raises:
        UsageError: the folder is a published dataset, whose files are sealed.
        DatasetError: there is no dataset, a snapshot or a drive's manifest is missing, another run writes the dataset
            or holds its lease, or it cannot be written.
        SchemaError: a snapshot or a drive's manifest is broken: what they name is not known then.
    """
    layout = Layout(root)
    require_dataset(layout)
    if (root / BUNDLE).is_file():
        raise UsageError("a published dataset has no history", file=root / BUNDLE, expected="the dataset it came from")
    with (
        hold_lease(FolderDestination(root), "gc", wait=wait) as lease,
        writer_lock(layout, wait=wait),
        replacing(layout),
    ):
        before = time.time() - age_s
        snapshots, segments = _old_index(layout, before)
        named = _named_traversals(layout)
        traversals = [
            folder
            for folder in _folders(layout.root / "traversals")
            if folder.name not in named and _is_old(folder, before)
        ]
        work = list(abandoned_folders(layout.index, WORK))
        snapshot_files = [layout.root / snapshot_path(number) for number in snapshots]
        doomed = [*snapshot_files, *segments, *traversals, *work]
        size = sum(_size(path) for path in doomed)
        # Snapshots go first: no snapshot names a segment that is gone.
        for path in () if dry_run else doomed:
            lease.require()
            remove_path(path)
    return GarbageReport(
        tuple(snapshots),
        tuple(path.name for path in segments),
        tuple(path.name for path in traversals),
        tuple(path.name for path in work),
        size,
    )


def _old_index(layout: Layout, before: float) -> tuple[list[int], list[Path]]:
    """Return the snapshots that may go, and the segments that no other snapshot names."""
    store = Store(layout.root)
    numbers = list_snapshots(store)
    old = [
        number
        for number in numbers[:-1]
        for path in [layout.root / snapshot_path(number)]
        if _is_old(path, before) and not has_readers(layout, number, path)
    ]
    named = {
        segment.name for number in numbers if number not in old for segment in read_snapshot(store, number).segments
    }
    segments = [
        folder
        for folder in _folders(layout.index)
        if _SEGMENT.fullmatch(folder.name) and folder.name not in named and _is_old(folder, before)
    ]
    return old, segments


def _named_traversals(layout: Layout) -> set[str]:
    """Return the ids of the traversals that a complete drive names, or a drive of the newest snapshot."""
    named: set[str] = set()
    for drive_id in layout.drive_ids():
        manifest = read_manifest(layout.drive(drive_id))
        keys = () if manifest is None else manifest.derived_from
        named.update(key.removeprefix(_TRAVERSAL) for key in keys if key.startswith(_TRAVERSAL))
    # The manifest of a drive may be lost: an ingest makes it again, and the images are not to be lost meanwhile.
    state = read_state(Store(layout.root))
    for source in () if state is None else state.sources.drives.values():
        named.update(source.traversals)
    return named


def _folders(parent: Path) -> Iterator[Path]:
    if parent.is_dir():
        yield from (path for path in sorted(parent.iterdir()) if path.is_dir() and not path.name.startswith("."))


def _files(path: Path) -> Iterator[Path]:
    if path.is_dir():
        yield from (Path(folder, name) for folder, _, names in os.walk(path) for name in names)
    else:
        yield path


def _is_old(path: Path, before: float) -> bool:
    return all(one.lstat().st_mtime <= before for one in (path, *_files(path)))


def _size(path: Path) -> int:
    return sum(one.lstat().st_size for one in _files(path))
