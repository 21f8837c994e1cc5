"""From scores of pictures to figures: means in the protocol's order, their intervals, and the same by part."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.evaluation.result import Figure, Level, finite_or_none
from mirror.metrics.images.aggregate import summarise
from mirror.metrics.images.bootstrap import Interval, frame_blocks, mean_interval
from mirror.metrics.score import Score
from mirror.protocols.document import Protocol
from mirror.protocols.views.view import RenderView

Better = Literal["higher", "lower", "none"]

_PARTS: Final[Mapping[Level, Callable[[RenderView], str]]] = {
    "scene": lambda view: view.scene_id,
    "traversal": lambda view: view.traversal_id,
    "camera": lambda view: view.camera,
    "condition": lambda view: f"{view.light}, {view.weather}",
}

MIN_BLOCKS: Final = 5
TOO_FEW_BLOCKS: Final = f"fewer than {MIN_BLOCKS} blocks of frames: an interval would say more than is known"


@dataclass(frozen=True)
class Measure:
    """A metric of single pictures: its name, unit and direction."""

    name: str
    unit: str
    better: Better


def compute_figures(
    protocol: Protocol, measure: Measure, group: str, views: Sequence[RenderView], scores: Sequence[Score]
) -> list[Figure]:
    """The figures of one metric and group.

    Args:
        protocol: says how means are taken, and intervals.
        measure: the metric.
        group: the protocol's group.
        views: (N,).
        scores: (N,) one a view.

    Returns:
        The group's figure, then one a scene, traversal, camera and condition.
    """
    if not views:
        return []
    found = [_figure(protocol, measure, group, "group", "", views, scores, protocol.averaging)]
    for level, key_of in _PARTS.items():
        members: dict[str, list[int]] = {}
        for place, view in enumerate(views):
            members.setdefault(key_of(view), []).append(place)
        for key, places in members.items():
            own, part = [views[place] for place in places], [scores[place] for place in places]
            averaging = tuple(name for name in protocol.averaging if name == "traversal" and level != "traversal")
            found.append(_figure(protocol, measure, group, level, key, own, part, averaging))
    return found


def mean_weights(views: Sequence[RenderView], averaging: Sequence[str]) -> Float64:
    """Weights (N,), of sum 1, of pictures in the mean of means; the last of ``averaging`` is the outermost.

    Raises:
        ValueError: there is no view.
    """
    if not views:
        raise ValueError("no views")
    weights = np.ones(len(views))
    # From the outermost mean inwards, every part of a whole gets the same share of it.
    wholes = np.zeros(len(views), np.int64)
    for name in reversed(averaging):
        keys = [_PARTS["traversal" if name == "traversal" else "scene"](view) for view in views]
        parts = np.unique([f"{whole} {key}" for whole, key in zip(wholes, keys)], return_inverse=True)[1]
        for whole in np.unique(wholes):
            weights[wholes == whole] /= len(np.unique(parts[wholes == whole]))
        wholes = parts
    return np.asarray(weights / np.bincount(wholes)[wholes])


def linearise_mean(values: Float64, weights: Float64) -> Float64:
    """Values (N,) whose plain mean is the weighted mean of the given ones, and varies as that does.

    The mean of means is linearised: under resampling it deviates as the mean of ``N w (x - mean)`` does.

    Args:
        values: (N,) finite.
        weights: (N,), of sum 1.
    """
    mean = math.fsum(weights * values)
    return np.asarray(mean + len(values) * weights * (values - mean))


def assign_blocks(protocol: Protocol, views: Sequence[RenderView]) -> Int64:
    """The block (N,) of consecutive frames that each view is resampled with."""
    traversals, frames = [view.traversal_id for view in views], [view.frame_index for view in views]
    return frame_blocks(traversals, frames, protocol.intervals.block_frames)


def weighted_interval(
    protocol: Protocol, views: Sequence[RenderView], values: Float64, weights: Float64
) -> tuple[float, Interval]:
    """A weighted mean of finite values, and its interval under resampling of blocks of frames."""
    mean = math.fsum(weights * values)
    spread = linearise_mean(values, weights)
    options = protocol.intervals
    blocks = assign_blocks(protocol, views)
    if len(np.unique(blocks)) < MIN_BLOCKS:
        return mean, Interval(mean, math.nan, math.nan, len(values), 0, len(np.unique(blocks)), TOO_FEW_BLOCKS)
    interval = mean_interval(spread, blocks, confidence=options.level, resamples=options.resamples, seed=options.seed)
    return mean, interval


def _figure(
    protocol: Protocol,
    measure: Measure,
    group: str,
    level: Level,
    key: str,
    views: Sequence[RenderView],
    scores: Sequence[Score],
    averaging: Sequence[str],
) -> Figure:
    summary = summarise(scores)
    rows = [row for row, score in enumerate(scores) if math.isfinite(score)]
    value: float | None = None
    interval: Interval | None = None
    if rows:
        own = [views[row] for row in rows]
        values = np.array([float(scores[row]) for row in rows])
        value, interval = weighted_interval(protocol, own, values, mean_weights(own, averaging))
    return Figure(
        metric=measure.name,
        group=group,
        level=level,
        key=key,
        value=value,
        reason=None if rows else summary.mean.reason,
        unit=measure.unit,
        better=measure.better,
        n=summary.n,
        n_inf=summary.n_inf,
        n_missing=summary.n_nan,
        low=None if interval is None else finite_or_none(interval.low),
        high=None if interval is None else finite_or_none(interval.high),
        interval_reason=None if interval is None else interval.reason,
    )
