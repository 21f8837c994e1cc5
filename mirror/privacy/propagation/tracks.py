"""Regions along tracks: what detectors found in some images of a camera is removed in those between and beside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.privacy.regions import KINDS, Region, covered_share

_REACH: Final = 1.5
"""A region continues a track if its centre is at most this many times its size from where it is expected."""
_RATIO: Final = 1.6
_GROWTH: Final = 1.25
_COVERED: Final = 0.8


@dataclass(eq=False)
class _Track:
    images: list[int] = field(default_factory=list)
    boxes: list[Float64] = field(default_factory=list)
    regions: list[Region] = field(default_factory=list)

    def add(self, image: int, region: Region) -> None:
        self.images.append(image)
        self.boxes.append(np.array(region.box_px))
        self.regions.append(region)

    def expected(self, image: int, times_s: Float64) -> Float64:
        """The box (4,) at an image, with the velocity of the two nearest detections."""
        if len(self.images) == 1:
            return self.boxes[0]
        near = -1 if image > self.images[-1] else 0
        one, other = (self.images[near], self.images[near - 1 if near else 1])
        box, before = (self.boxes[near], self.boxes[near - 1 if near else 1])
        share = (times_s[image] - times_s[one]) / (times_s[one] - times_s[other])
        moved = 0.5 * ((box[:2] + box[2:]) - (before[:2] + before[2:])) * share
        return box + np.concatenate([moved, moved])


def follow_tracks(
    images: Sequence[Sequence[Region]],
    timestamps_ns: Sequence[int],
    size_px: tuple[int, int],
    *,
    gap: int = 3,
    extend: int = 1,
) -> list[list[Region]]:
    """Find the regions that tracks add to the images of one camera.

    Detections of one kind are linked from image to image. Where a track misses images, its box is interpolated; before
    its first and behind its last detection it is continued with constant velocity. Both are enlarged by a quarter. A
    single detection makes no track.

    Args:
        images: regions of each image, in order of time.
        timestamps_ns: (len(images),) timestamps, strictly increasing.
        size_px: width and height of the raster.
        gap: largest number of images in a row that a track may miss.
        extend: number of images before and behind a track.

    Returns:
        The added regions of each image, with origin `track`.
    """
    start = timestamps_ns[0] if timestamps_ns else 0
    times: Float64 = np.array([1e-9 * (stamp - start) for stamp in timestamps_ns], np.float64)
    added: list[list[Region]] = [[] for _ in images]
    for kind in KINDS:
        for track in _link([[one for one in image if one.kind == kind] for image in images], times, gap):
            for image, region in _fill(track, times, len(images), extend):
                box = _within(np.array(region.box_px), size_px)
                others = [other.box_px for other in images[image] if other.kind == kind]
                if box is not None and covered_share(box.tolist(), others) < _COVERED:
                    added[image].append(region.moved_to(box.tolist(), "track"))
    return added


def _link(images: Sequence[Sequence[Region]], times: Float64, gap: int) -> list[_Track]:
    tracks: list[_Track] = []
    for number, regions in enumerate(images):
        active = [track for track in tracks if number - track.images[-1] <= gap + 1]
        pairs = []
        for row, region in enumerate(regions):
            for column, track in enumerate(active):
                distance = _distance(np.array(region.box_px), track.expected(number, times))
                # Without a velocity, it may have moved as far in every image that was missed.
                elapsed = number - track.images[-1] if len(track.images) == 1 else 1
                if distance <= _REACH * elapsed:
                    pairs.append((distance, row, column))
        rows: set[int] = set()
        columns: set[int] = set()
        for _, row, column in sorted(pairs):
            if row not in rows and column not in columns:
                rows.add(row)
                columns.add(column)
                active[column].add(number, regions[row])
        for row, region in enumerate(regions):
            if row not in rows:
                tracks.append(_Track())
                tracks[-1].add(number, region)
    return [track for track in tracks if len(track.images) > 1]


def _distance(box: Float64, other: Float64) -> float:
    """Distance of the centres in units of the mean size; infinite where the sizes differ too much."""
    size, other_size = box[2:] - box[:2], other[2:] - other[:2]
    ratio = float(np.sqrt((size / other_size).prod()))
    if not 1.0 / _RATIO <= ratio <= _RATIO:
        return np.inf
    apart = 0.5 * (box[:2] + box[2:] - other[:2] - other[2:])
    return float(np.hypot(*apart) / (0.25 * (size + other_size).sum()))


def _fill(track: _Track, times: Float64, count: int, extend: int) -> list[tuple[int, Region]]:
    found = []
    for (one, box), (other, box_after), region in zip(
        zip(track.images, track.boxes), zip(track.images[1:], track.boxes[1:]), track.regions
    ):
        for image in range(one + 1, other):
            share = (times[image] - times[one]) / (times[other] - times[one])
            found.append((image, _grown(region, (1.0 - share) * box + share * box_after)))
    for step in range(1, extend + 1):
        for image, region in ((track.images[0] - step, track.regions[0]), (track.images[-1] + step, track.regions[-1])):
            if 0 <= image < count:
                found.append((image, _grown(region, track.expected(image, times))))
    return found


def _grown(region: Region, box: Float64) -> Region:
    middle, half = 0.5 * (box[:2] + box[2:]), 0.5 * _GROWTH * (box[2:] - box[:2])
    return region.moved_to(np.concatenate([middle - half, middle + half]).tolist(), "track")


def _within(box: Float64, size_px: tuple[int, int]) -> Float64 | None:
    """The part of a box in the raster; None: there is none."""
    clipped = np.clip(box, 0.0, np.array([*size_px, *size_px], np.float64))
    return clipped if (clipped[2:] - clipped[:2] >= 1.0).all() else None
