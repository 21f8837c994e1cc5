"""Snapshots of the index: which there are, what the newest one consists of, and putting the next one.

A snapshot is put under the next free number, and only if nobody else has put it meanwhile; then it is made again on top
of theirs. So writers need no lock, and a reader sees one snapshot.
"""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import dataclass

from mirror.dataset.destination import Destination
from mirror.dataset.store import Store
from mirror.errors import DatasetError, SchemaError
from mirror.schema.commit import ConflictError
from mirror.schema.files import parse_json, sha256_bytes
from mirror.schema.snapshot import (
    SNAPSHOTS,
    SOURCES,
    IndexSegment,
    IndexSnapshot,
    SegmentSources,
    snapshot_number,
    snapshot_path,
)


@dataclass(frozen=True)
class IndexState:
    """A snapshot, and what its rows were derived from.

    Attributes:
        number: its number.
        snapshot: it.
        sources: hashes of the inputs of all rows that are read.
    """

    number: int
    snapshot: IndexSnapshot
    sources: SegmentSources


def list_snapshots(store: Store) -> list[int]:
    """Return the numbers of a dataset's snapshots, in order.

    Where a store does not list its files, as servers of HTTP do not, the numbers from 1 on are tried.
    """
    found = sorted(number for name in store.list_files(SNAPSHOTS) if (number := snapshot_number(name)) is not None)
    if found or store.folder is not None:
        return found
    while store.read_many([snapshot_path(len(found) + 1)]):
        found.append(len(found) + 1)
    return found


def read_snapshot(store: Store, number: int) -> IndexSnapshot:
    """Read a snapshot.

    Raises:
        DatasetError: it does not exist.
        SchemaError: it is broken.
    """
    path = snapshot_path(number)
    try:
        data = store.read(path) if store.generation is None else store.generation.snapshot
    except FileNotFoundError as error:
        raise DatasetError("missing", file=store.full_path(path), expected="a snapshot of the index") from error
    return parse_json(data, IndexSnapshot, store.full_path(path))


def read_state(store: Store) -> IndexState | None:
    """Read the newest snapshot and the sources of its segments; None: there is no snapshot.

    Raises:
        DatasetError: a file is missing or is not the one that the snapshot names.
        SchemaError: a file is broken.
    """
    numbers = list_snapshots(store)
    if not numbers:
        return None
    snapshot = read_snapshot(store, numbers[-1])
    paths = {segment.name: f"index/{segment.name}/{SOURCES}" for segment in snapshot.segments}
    found = store.read_many(list(paths.values()))
    drives, scenes, maps, derivation = {}, {}, {}, set()
    for segment in snapshot.segments:
        path = paths[segment.name]
        if path not in found or sha256_bytes(found[path]) != segment.sources:
            raise DatasetError(
                "missing" if path not in found else "has changed", file=store.full_path(path),
                expected=f"the file with SHA-256 {segment.sources}", remedy=f"run `mirror index {store.root}`",
            )  # fmt: skip
        own = parse_json(found[path], SegmentSources, store.full_path(path))
        drives.update({drive_id: own.drives[drive_id] for drive_id in segment.drives if drive_id in own.drives})
        scenes.update({scene_id: own.scenes[scene_id] for scene_id in segment.scenes if scene_id in own.scenes})
        maps.update(own.maps)
        derivation.add(own.derivation)
    # Rows by several rules are those of none.
    rule = derivation.pop() if len(derivation) == 1 else 0
    return IndexState(numbers[-1], snapshot, SegmentSources(derivation=rule, drives=drives, scenes=scenes, maps=maps))


def put_snapshot(
    destination: Destination,
    segment: IndexSegment | None,
    *,
    without_segments: Collection[str] = (),
    without_drives: Collection[str] = (),
    without_scenes: Collection[str] = (),
    loses_rows: bool = False,
) -> int:
    """Put the next snapshot: the newest one with a segment more, and without what the segment replaces.

    Args:
        destination: the dataset.
        segment: what is added; None: nothing.
        without_segments: names of segments that are replaced as a whole.
        without_drives: drives that the dataset no longer has.
        without_scenes: scenes that it no longer has.
        loses_rows: the files of rows of earlier snapshots are no longer there: those cannot be opened any more.

    Returns:
        The number of the snapshot; that of the newest one, if nothing changes.

    Raises:
        DatasetError: it cannot be written.
    """
    drives = {*without_drives, *(() if segment is None else segment.drives)}
    scenes = {*without_scenes, *(() if segment is None else segment.scenes)}
    store = destination.store
    while True:
        number, before = _newest(store)
        kept = [
            left
            for one in before.segments
            if one.name not in without_segments and (left := _without(one, drives, scenes)) is not None
        ]
        segments = (*kept, *(() if segment is None else (segment,)))
        if number and segments == before.segments:
            return number
        after = IndexSnapshot(oldest=number + 1 if loses_rows or not number else before.oldest, segments=segments)
        try:
            destination.commit_bytes(snapshot_path(number + 1), encode_snapshot(after))
        except ConflictError:
            # Another writer was first: its snapshot is the one to build on.
            continue
        return number + 1


def newest_segments(store: Store) -> frozenset[str]:
    """Return the names of the segments of the newest snapshot; empty if there is none, or if it is damaged."""
    return frozenset(segment.name for segment in _newest(store)[1].segments)


def encode_snapshot(snapshot: IndexSnapshot) -> bytes:
    """Encode a snapshot as the bytes of its file."""
    return (json.dumps(snapshot.model_dump(mode="json"), indent=1, ensure_ascii=False) + "\n").encode()


def _newest(store: Store) -> tuple[int, IndexSnapshot]:
    numbers = list_snapshots(store)
    if not numbers:
        return 0, IndexSnapshot()
    try:
        return numbers[-1], read_snapshot(store, numbers[-1])
    except SchemaError:
        # Damaged. What it named is derived again before anything is put on top of it.
        return numbers[-1], IndexSnapshot(oldest=numbers[-1] + 1)


def _without(segment: IndexSegment, drives: set[str], scenes: set[str]) -> IndexSegment | None:
    """A segment without some drives and rows of scenes; None: nothing is left of it."""
    kept = tuple(drive_id for drive_id in segment.drives if drive_id not in drives)
    kept_scenes = tuple(scene_id for scene_id in segment.scenes if scene_id not in scenes)
    if (kept, kept_scenes) == (segment.drives, segment.scenes):
        return segment
    if not kept and not kept_scenes:
        return None
    return segment.model_copy(update={"drives": kept, "scenes": kept_scenes, "is_whole": False})
