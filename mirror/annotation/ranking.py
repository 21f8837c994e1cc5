"""Ranks frames for review: those first where two layers of boxes disagree, or where tracks break."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.annotation.box_layer import choose_box_layer, read_box_layer
from mirror.annotation.detections import Detections
from mirror.annotation.tracking.options import group_of
from mirror.dataset.dataset import Dataset

_GATE_M: Final = 2.0
_LEAST_FRAMES: Final = 3


@dataclass(frozen=True)
class FrameRank:
    """The reasons to review a frame, as numbers.

    Attributes:
        traversal_id: its traversal.
        timestamp_ns: time of its boxes.
        boxes: number of boxes.
        unmatched: boxes of either layer without a box of the other one within 2 m; 0 without a second layer.
        breaks: tracks that begin or end here, away from the ends of the traversal, within 25 m of the vehicle.
        unsure: sum of 1 - score of the boxes that have a score.
        shift: largest distance in an image between the middle of a box and that of its partner in the other layer, as a
            share of the image's width; 0 without a second layer.
    """

    traversal_id: str
    timestamp_ns: int
    boxes: int
    unmatched: int
    breaks: int
    unsure: float
    shift: float = 0.0

    @property
    def order(self) -> tuple[float, int, str, int]:
        """Sort key that puts the worst frame first: disagreement and breaks, then doubt; 0.1 of shift equals a box."""
        badness = self.unmatched + self.breaks + 0.1 * self.unsure + 10.0 * self.shift
        return (-badness, -self.boxes, self.traversal_id, self.timestamp_ns)


def rank_frames(dataset: Dataset, layer: str | None = None, against: str | None = None) -> list[FrameRank]:
    """Rank the frames of a view, the worst first.

    Args:
        dataset: a dataset or a view.
        layer: layer of boxes, ``source@version``; None: the only one.
        against: a second layer, of another annotator or of a person; None: none.

    Raises:
        UsageError: a layer does not exist, or there are several and none is named.
    """
    chosen = read_box_layer(dataset, choose_box_layer(dataset, layer))
    others: Mapping[str, Sequence[Detections]] = {} if against is None else read_box_layer(dataset, against)
    ranks = []
    for traversal_id, frames in chosen.items():
        by_time = {frame.timestamp_ns: frame for frame in others.get(traversal_id, ())}
        breaks = _breaks(frames)
        for number, frame in enumerate(frames):
            other = by_time.get(frame.timestamp_ns)
            pairs = [] if other is None else match_boxes(frame, other)
            unmatched = 0 if other is None else len(frame) + len(other) - 2 * len(pairs)
            shift = 0.0 if other is None else _largest_shift(dataset, traversal_id, frame, other, pairs)
            unsure = float(np.nansum(1.0 - frame.score))
            ranks.append(
                FrameRank(
                    traversal_id,
                    frame.timestamp_ns,
                    len(frame),
                    unmatched,
                    breaks[number],
                    round(unsure, 3),
                    round(shift, 4),
                )
            )
    return sorted(ranks, key=lambda rank: rank.order)


def count_unmatched(one: Detections, other: Detections) -> int:
    """Count the boxes of two sets without a partner of their group in the other set within 2 m."""
    return len(one) + len(other) - 2 * len(match_boxes(one, other))


def match_boxes(one: Detections, other: Detections) -> list[tuple[int, int]]:
    """Return the pairs of rows of two sets, nearest first: boxes of one group with middles within 2 m."""
    pairs = sorted(
        (float(np.linalg.norm(one.ego_SE3_box.translation[a, :2] - other.ego_SE3_box.translation[b, :2])), a, b)
        for a in range(len(one))
        for b in range(len(other))
        if group_of(one.category[a]) == group_of(other.category[b])
    )
    first: set[int] = set()
    second: set[int] = set()
    matched = []
    for away, a, b in pairs:
        if away <= _GATE_M and a not in first and b not in second:
            first.add(a)
            second.add(b)
            matched.append((a, b))
    return matched


def _largest_shift(
    dataset: Dataset, traversal_id: str, one: Detections, other: Detections, pairs: Sequence[tuple[int, int]]
) -> float:
    """The largest distance in an image between the middles of partners, as a share of the image's width."""
    stamp = one.timestamp_ns
    if not pairs:
        return 0.0
    for frame in dataset.where(traversal=traversal_id, time=(stamp, stamp + 1)).frames()[:1]:
        rows, others = (np.array(side) for side in zip(*pairs))
        largest = 0.0
        for image in frame.images.values():
            camera_SE3_ego = image.world_SE3_camera.inverse() @ frame.world_SE3_ego
            seen = image.camera_model.project((camera_SE3_ego @ one.ego_SE3_box[rows]).translation)
            there = image.camera_model.project((camera_SE3_ego @ other.ego_SE3_box[others]).translation)
            inside = (seen.uv_px >= 0.0).all(axis=1) & (seen.uv_px <= (image.width_px, image.height_px)).all(axis=1)
            both = seen.valid & there.valid & inside
            if both.any():
                away = np.linalg.norm(seen.uv_px[both] - there.uv_px[both], axis=1)
                largest = max(largest, float(away.max()) / image.width_px)
        return largest
    return 0.0


def _breaks(frames: Sequence[Detections]) -> list[int]:
    """The number of tracks of at least three boxes that begin or end in each frame, near the vehicle."""
    places: dict[str, list[tuple[int, float]]] = {}
    for number, frame in enumerate(frames):
        away = np.linalg.norm(frame.ego_SE3_box.translation[:, :2], axis=1)
        for row, name in enumerate(frame.track_id):
            places.setdefault(name, []).append((number, float(away[row])))
    counts = [0] * len(frames)
    for visits in places.values():
        if len(visits) >= _LEAST_FRAMES:
            for number, away in (visits[0], visits[-1]):
                counts[number] += 0 < number < len(frames) - 1 and away < 25.0
    return counts
