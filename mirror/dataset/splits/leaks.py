"""Ties between traversals. If tied traversals have different roles, the split leaks."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np

from mirror.arrays import Int64, UInt8
from mirror.dataset.splits.candidates import SHA256_BYTES, Candidate, Candidates
from mirror.geometry.geodesy import surface_distance_m
from mirror.schema.documents import Roi

TieKind = Literal["drive", "bytes", "time", "scene", "area"]


@dataclass(frozen=True)
class Tie:
    """Traversals that must have the same role.

    Attributes:
        kind: ``drive``, ``bytes`` (the same image), ``time`` (one vehicle at the same time), ``scene`` or ``area``
            (overlapping scenes).
        members: ids of the traversals, sorted.
        reason: a clause that says what they share.
    """

    kind: TieKind
    members: tuple[str, ...]
    reason: str


@dataclass(frozen=True)
class SplitLeak:
    """Two tied traversals with different roles.

    Attributes:
        tie: what ties them.
        first: id of the first traversal.
        first_role: its role.
        second: id of the second traversal.
        second_role: its role.
    """

    tie: Tie
    first: str
    first_role: str
    second: str
    second_role: str

    def __str__(self) -> str:
        return f"{self.first} ({self.first_role}) and {self.second} ({self.second_role}) {self.tie.reason}"


def find_ties(candidates: Candidates, *, by_scene: bool) -> list[Tie]:
    """Find all ties between traversals.

    Args:
        candidates: the traversals.
        by_scene: also tie the traversals of one scene, and those of scenes with overlapping circles.
    """
    traversals = list(candidates.traversals.values())
    found = [*_same_drive(traversals), *_same_bytes(candidates), *_same_time(traversals)]
    if by_scene:
        found += [*_same_scene(traversals), *_same_area(traversals, candidates.scenes)]
    return found


def find_leaks(ties: Iterable[Tie], roles: Mapping[str, str]) -> list[SplitLeak]:
    """Find the ties between different roles: for each tie, one leak for each pair of roles.

    Traversals that are ``unused`` or unassigned have no role.

    Args:
        ties: the ties.
        roles: the role of each traversal by id.
    """
    result = []
    for tie in ties:
        example: dict[str, str] = {}
        for member in tie.members:
            role = roles.get(member, "unused")
            if role != "unused":
                example.setdefault(role, member)
        for first, second in combinations(example, 2):
            result.append(SplitLeak(tie, example[first], first, example[second], second))
    return result


def overlapping_scenes(scenes: Iterable[Roi]) -> Iterator[tuple[Roi, Roi, float]]:
    """Yield pairs of scenes with overlapping circles, and the distance of their centres in metres."""
    by_frame = defaultdict(list)
    for roi in scenes:
        by_frame[roi.frame].append(roi)
    for frame, own in by_frame.items():
        names = ("longitude_deg", "latitude_deg") if frame is None else ("x_m", "y_m")
        first, second = (np.array([getattr(roi, name) for roi in own], np.float64) for name in names)
        radius = np.array([roi.radius_m for roi in own])
        for index in range(len(own) - 1):
            others = slice(index + 1, None)
            if frame is None:
                distance = surface_distance_m(first[others], second[others], first[index], second[index])
            else:
                distance = np.hypot(first[others] - first[index], second[others] - second[index])
            for hit in np.flatnonzero(distance < radius[others] + radius[index]):
                yield own[index], own[index + 1 + hit], float(distance[hit])


def _same_drive(traversals: Sequence[Candidate]) -> Iterator[Tie]:
    for drive_id, members in _grouped(traversals, lambda item: item.drive_id):
        yield Tie("drive", members, f"are of one drive, {drive_id}")


def _same_scene(traversals: Sequence[Candidate]) -> Iterator[Tie]:
    for scene_id, members in _grouped(traversals, lambda item: item.scene_id):
        yield Tie("scene", members, f"are of one scene, {scene_id}")


def _same_area(traversals: Sequence[Candidate], scenes: Mapping[str, Roi]) -> Iterator[Tie]:
    members: dict[str, list[str]] = defaultdict(list)
    for item in traversals:
        members[item.scene_id].append(item.traversal_id)
    for first, second, distance in overlapping_scenes(scenes[key] for key in members):
        yield Tie(
            "area",
            tuple(sorted(members[first.scene_id] + members[second.scene_id])),
            f"are of overlapping scenes: {first.scene_id} and {second.scene_id} are {distance:.1f} m apart,"
            f" their radii {first.radius_m:g} m and {second.radius_m:g} m",
        )


def _same_time(traversals: Sequence[Candidate]) -> Iterator[Tie]:
    """Tie traversals of different drives of one vehicle at the same time: they recorded the same drive twice."""
    by_vehicle = defaultdict(list)
    for item in traversals:
        by_vehicle[item.vehicle_id].append(item)
    for vehicle_id, own in by_vehicle.items():
        current: list[Candidate] = []
        for item in sorted(own, key=lambda item: (item.entry_ns, item.traversal_id)):
            current = [other for other in current if other.exit_ns > item.entry_ns]
            for other in current:
                if other.drive_id != item.drive_id:
                    seconds = (min(other.exit_ns, item.exit_ns) - item.entry_ns) * 1e-9
                    yield Tie(
                        "time",
                        tuple(sorted((other.traversal_id, item.traversal_id))),
                        f"are of one vehicle, {vehicle_id}, at the same time for {seconds:.1f} s",
                    )
            current.append(item)


def _same_bytes(candidates: Candidates) -> Iterator[Tie]:
    names = list(candidates.image_hashes)
    parts = list(candidates.image_hashes.values())
    hashes = np.concatenate([*parts, np.empty((0, SHA256_BYTES), np.uint8)])
    owner = np.repeat(np.arange(len(names)), [len(part) for part in parts])
    shared: dict[tuple[int, ...], list[bytes]] = defaultdict(list)
    for digest, owners in _repeated(hashes, owner):
        shared[owners].append(digest)
    for owners, digests in shared.items():
        count = "1 image" if len(digests) == 1 else f"{len(digests)} images"
        reason = f"have the same bytes in {count}, such as SHA-256 {min(digests).hex()}"
        yield Tie("bytes", tuple(names[index] for index in owners), reason)


def _repeated(hashes: UInt8, owner: Int64) -> Iterator[tuple[bytes, tuple[int, ...]]]:
    """Yield the hashes with more than one owner, and their owners."""
    # Nearly all hashes differ in their first eight bytes; only those that agree there are compared completely.
    keys = np.ascontiguousarray(hashes[:, :8]).view(np.uint64)[:, 0]
    order = np.argsort(keys, kind="stable")
    same = keys[order][1:] == keys[order][:-1]
    suspects = np.zeros(len(keys), np.bool_)
    suspects[:-1] |= same
    suspects[1:] |= same
    owners: dict[bytes, set[int]] = defaultdict(set)
    for row in order[suspects].tolist():
        owners[hashes[row].tobytes()].add(int(owner[row]))
    for digest, numbers in owners.items():
        if len(numbers) > 1:
            yield digest, tuple(sorted(numbers))


def _grouped(traversals: Sequence[Candidate], key: Callable[[Candidate], str]) -> Iterator[tuple[str, tuple[str, ...]]]:
    groups = defaultdict(list)
    for item in traversals:
        groups[key(item)].append(item.traversal_id)
    for value, members in groups.items():
        if len(members) > 1:
            yield value, tuple(sorted(members))
