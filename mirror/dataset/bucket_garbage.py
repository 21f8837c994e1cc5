"""Removal of what no reader of a dataset in a bucket can reach any more, by a list of its objects and their age.

It holds the dataset's lease. Runs that add drives hold none, and no reader of a bucket is known: the age limit is for
them. What is removed next is held against what is named at that moment.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Mapping
from typing import Final

from mirror.dataset.destination import BucketDestination
from mirror.dataset.garbage import DEFAULT_AGE_S, GarbageReport
from mirror.dataset.index.snapshots import list_snapshots, read_snapshot, read_state
from mirror.dataset.layout import MANIFEST
from mirror.dataset.lease import Lease, hold_lease
from mirror.dataset.store import Store, StoredFile
from mirror.errors import UsageError
from mirror.schema.bundle import BUNDLE
from mirror.schema.documents import DatasetDocument, Manifest
from mirror.schema.files import parse_json
from mirror.schema.snapshot import snapshot_path

_SEGMENT: Final = re.compile(r"index/([0-9a-f]{16})/.+")
_IN_TRAVERSAL: Final = re.compile(r"traversals/([^/]+)/.+")
_TRAVERSAL: Final = "traversal:"


def collect_bucket_garbage(
    destination: BucketDestination, *, age_s: float = DEFAULT_AGE_S, dry_run: bool = False, wait: bool = False
) -> GarbageReport:
    """Remove old snapshots, segments that no snapshot names, and traversals that no drive names.

    The newest snapshot stays.

    Args:
        destination: the dataset.
        age_s: seconds since the last change of what is removed, by the clock of the server.
        dry_run: report only.
        wait: wait for another run that holds the lease.

    Raises:
        UsageError: it is a published dataset, whose files are sealed.
        DatasetError: there is no dataset, a snapshot or a drive's manifest is missing, another run holds the lease, or
            the bucket cannot be written.
        SchemaError: a snapshot or a drive's manifest is broken: what they name is not known then.
    """
    store = destination.store
    store.json("dataset.json", DatasetDocument)
    with hold_lease(destination, "gc", wait=wait) as lease:
        listed = store.list_tree("")
        if BUNDLE in listed:
            raise UsageError(
                "a published dataset has no history", file=store.full_path(BUNDLE), expected="the dataset it came from"
            )
        before = time.time() - age_s

        def is_old(names: Iterable[str]) -> bool:
            # Of what a server gives no time for, the age is not known.
            times = [listed[name].modified_s for name in names]
            return all(one is not None and one <= before for one in times)

        numbers = [number for number in list_snapshots(store)[:-1] if is_old([snapshot_path(number)])]
        removal = _Removal(destination, lease, listed, dry_run=dry_run)
        # Snapshots go first: no snapshot names a segment that is gone.
        removal.remove(snapshot_path(number) for number in numbers)
        named = _named_segments(store, frozenset(numbers))
        segments = {
            name: files for name, files in _by_folder(_SEGMENT, listed).items() if name not in named and is_old(files)
        }
        removal.remove(name for files in segments.values() for name in files)
        drives = _named_traversals(store)
        traversals = {
            name: files
            for name, files in _by_folder(_IN_TRAVERSAL, listed).items()
            if name not in drives and is_old(files)
        }
        removal.remove(name for files in traversals.values() for name in files)
    return GarbageReport(tuple(numbers), tuple(segments), tuple(traversals), (), removal.bytes)


class _Removal:
    """Removes objects, and counts their bytes."""

    def __init__(
        self, destination: BucketDestination, lease: Lease, listed: Mapping[str, StoredFile], *, dry_run: bool
    ) -> None:
        self._destination, self._lease, self._listed, self._dry_run = destination, lease, listed, dry_run
        self.bytes = 0

    def remove(self, names: Iterable[str]) -> None:
        # Without its manifest, what is left of a folder that is removed in part counts as missing.
        ordered = sorted(names, key=lambda name: (not name.endswith(MANIFEST), name))
        self.bytes += sum(self._listed[name].bytes for name in ordered)
        if ordered and not self._dry_run:
            self._lease.require()
            self._destination.remove(ordered)


def _by_folder(pattern: re.Pattern[str], listed: Iterable[str]) -> dict[str, list[str]]:
    """The files of folders, by the name of the folder."""
    found: dict[str, list[str]] = {}
    for name in listed:
        if (match := pattern.fullmatch(name)) is not None:
            found.setdefault(match[1], []).append(name)
    return found


def _named_segments(store: Store, without: frozenset[int]) -> frozenset[str]:
    """The segments of all snapshots but those that go."""
    numbers = [number for number in list_snapshots(store) if number not in without]
    return frozenset(segment.name for number in numbers for segment in read_snapshot(store, number).segments)


def _named_traversals(store: Store) -> frozenset[str]:
    """The traversals that a complete drive names, or a drive of the newest snapshot."""
    paths = [f"drives/{name}/{MANIFEST}" for name in store.list_folders("drives")]
    manifests = [parse_json(data, Manifest, store.full_path(path)) for path, data in store.read_many(paths).items()]
    keys = [key for manifest in manifests for key in manifest.derived_from if key.startswith(_TRAVERSAL)]
    state = read_state(store)
    indexed = () if state is None else state.sources.drives.values()
    return frozenset([key.removeprefix(_TRAVERSAL) for key in keys]).union(*(one.traversals for one in indexed))
