"""Stationary objects of several traversals of a scene: those at one place share one position and one size."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from mirror.annotation.tracking.options import group_of
from mirror.annotation.tracking.tracker import ObjectTrack

_POSE_SIGMA_M: Final = 0.1
_FARTHEST_M: Final = 0.6
_SIGMAS: Final = 3.0
_SIZE_RATIO: Final = 1.2


def merge_stationary(tracks: Mapping[str, Sequence[ObjectTrack]]) -> dict[str, list[ObjectTrack]]:
    """Give stationary objects that agree between traversals their common position, heading axis and size.

    Objects agree if they are of one group, at most 0.6 m and three standard deviations apart (with 0.1 m for the poses
    of a drive), and of sizes within 20 %. A group of them has at most one object of each traversal. Objects that move
    are not changed. Another vehicle that parks at exactly the same place later is not distinguished.

    Args:
        tracks: tracks in the world frame of one scene, by traversal.
    """
    result = {name: list(items) for name, items in tracks.items()}
    entries = [
        (name, place, item) for name, items in result.items() for place, item in enumerate(items) if item.stationary
    ]
    # The most certain objects come first, and attract the others.
    entries.sort(key=lambda entry: entry[2].sigma_m)
    groups: list[list[int]] = []
    for number, (name, _, item) in enumerate(entries):
        fitting = [
            (float(np.linalg.norm(_place(item) - _place(entries[group[0]][2]))), group)
            for group in groups
            if all(entries[other][0] != name for other in group) and _agree(item, entries[group[0]][2])
        ]
        if fitting:
            min(fitting, key=lambda pair: pair[0])[1].append(number)
        else:
            groups.append([number])
    for group in groups:
        if len(group) > 1:
            _merge([entries[number] for number in group], result)
    return result


def _place(item: ObjectTrack) -> np.ndarray:
    return np.asarray(item.centre_m[0, :2])


def _agree(one: ObjectTrack, other: ObjectTrack) -> bool:
    away = float(np.linalg.norm(_place(one) - _place(other)))
    sigma = float(np.sqrt(one.sigma_m**2 + other.sigma_m**2 + 2.0 * _POSE_SIGMA_M**2))
    ratio = one.size_m / other.size_m
    return (
        group_of(one.category) == group_of(other.category)
        and away <= min(_FARTHEST_M, _SIGMAS * sigma)
        and bool((np.maximum(ratio, 1.0 / ratio) <= _SIZE_RATIO).all())
    )


def _merge(entries: Sequence[tuple[str, int, ObjectTrack]], result: dict[str, list[ObjectTrack]]) -> None:
    items = [item for _, _, item in entries]
    weight = np.array([1.0 / (item.sigma_m**2 + _POSE_SIGMA_M**2) for item in items])
    weight /= weight.sum()
    place = weight @ np.array([_place(item) for item in items])
    size = weight @ np.array([item.size_m for item in items])
    yaw = np.array([item.yaw_rad[0] for item in items])
    axis = 0.5 * np.arctan2(weight @ np.sin(2.0 * yaw), weight @ np.cos(2.0 * yaw))
    votes: dict[bool, float] = defaultdict(float)
    for share, angle in zip(weight, yaw):
        votes[bool(np.cos(angle - axis) >= 0.0)] += float(share)
    heading = float(axis) if votes[True] >= votes[False] else float(axis) + np.pi
    for name, row, item in entries:
        centre = item.centre_m.copy()
        centre[:, :2] = place
        result[name][row] = replace(item, centre_m=centre, size_m=size, yaw_rad=np.full(len(item.frames), heading))
