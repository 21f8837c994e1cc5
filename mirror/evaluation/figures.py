"""Figures from the scores of images: means in the protocol's order and their intervals, for each group and part."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Final

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.evaluation.result import GroupFigure, Level, finite_or_none
from mirror.metrics.catalogue import Measure
from mirror.metrics.images.aggregate import summarise
from mirror.metrics.images.bootstrap import Interval, frame_blocks, mean_interval
from mirror.metrics.score import Score
from mirror.protocols.document import Protocol
from mirror.protocols.ranking import ALL
from mirror.protocols.views.view import RenderView

_PARTS: Final[Mapping[Level, Callable[[RenderView], str]]] = {
    "scene": lambda view: view.scene_id,
    "traversal": lambda view: view.traversal_id,
    "camera": lambda view: view.camera,
    "condition": lambda view: f"{view.light}, {view.weather}",
}

_LEVELS: Final[Mapping[str, str]] = {"traversal": "traversal_id", "scene": "scene_id", "group": "group"}
"""Fields of a view that name its part of each level of a mean."""

_CACHED: Final = 256

MIN_BLOCKS: Final = 5
TOO_FEW_BLOCKS: Final = f"fewer than {MIN_BLOCKS} blocks of frames: an interval would say more than is known"


def compute_figures(
    protocol: Protocol, measure: Measure, group: str, views: Sequence[RenderView], scores: Sequence[Score]
) -> list[GroupFigure]:
    """Compute the figures of one metric and group.

    Args:
        protocol: protocol with the settings of means and intervals.
        measure: the metric.
        group: group of the protocol.
        views: (N,) views.
        scores: (N,) scores, one for each view.

    Returns:
        The figure of the group, then one for each scene, traversal, camera and condition.
    """
    if not views:
        return []
    figures = [_compute_figure(protocol, measure, group, "group", "", views, scores, protocol.averaging)]
    for level, part_key in _PARTS.items():
        members: dict[str, list[int]] = {}
        for index, view in enumerate(views):
            members.setdefault(part_key(view), []).append(index)
        for key, indices in members.items():
            part_views, part_scores = [views[index] for index in indices], [scores[index] for index in indices]
            averaging = tuple(name for name in protocol.averaging if name == "traversal" and level != "traversal")
            figures.append(_compute_figure(protocol, measure, group, level, key, part_views, part_scores, averaging))
    return figures


def compute_overall_figure(
    protocol: Protocol, measure: Measure, views: Sequence[RenderView], scores: Sequence[Score]
) -> list[GroupFigure]:
    """Compute the mean of one metric over the groups that rank, each group counting equally.

    Args:
        protocol: protocol with the ranking key and the settings of means and intervals.
        measure: the metric.
        views: (N,) views of any groups.
        scores: (N,) scores, one for each view.

    Returns:
        The figure of the group `ALL`; nothing if the protocol ranks by a single group, whose figure is known.
    """
    if protocol.ranking is None or protocol.ranking.group != ALL:
        return []
    rows = [row for row, view in enumerate(views) if view.group in protocol.ranking.groups]
    if not rows:
        return []
    members, member_scores = [views[row] for row in rows], [scores[row] for row in rows]
    averaging = overall_averaging(protocol)
    return [_compute_figure(protocol, measure, ALL, "group", "", members, member_scores, averaging)]


def overall_averaging(protocol: Protocol) -> tuple[str, ...]:
    """Return the levels of the mean over groups, innermost first: the protocol's levels, then the group."""
    return (*protocol.averaging, "group")


def mean_weights(views: Sequence[RenderView], averaging: Sequence[str]) -> Float64:
    """Compute the weights (N,), of sum 1, of images in the mean of means.

    Args:
        views: (N,) views.
        averaging: levels of the mean, innermost first: ``traversal``, ``scene``, ``group``.

    Returns:
        (N,) weights.

    Raises:
        ValueError: `views` is empty.
    """
    if not views:
        raise ValueError("no views")
    parts = [tuple(getattr(view, _LEVELS[name]) for name in averaging) for view in views]
    return _mean_weights(tuple(parts))


@lru_cache(_CACHED)
def _mean_weights(parts: tuple[tuple[str, ...], ...]) -> Float64:
    """Weights of images by their parts of each level, innermost first; the metrics of a group share them."""
    weights = np.ones(len(parts))
    # From the outermost level inwards, all parts of a parent get equal shares of its weight.
    parents = np.zeros(len(parts), np.int64)
    for level in reversed(range(len(parts[0]))):
        keys = [f"{parent} {part[level]}" for parent, part in zip(parents, parts)]
        children = np.unique(keys, return_inverse=True)[1]
        # The number of different children of each parent. (Without an inverse, `np.unique` imports masked arrays.)
        families = dict.fromkeys(zip(parents.tolist(), children.tolist()))
        weights /= np.bincount([parent for parent, _ in families])[parents]
        parents = children
    weights = np.asarray(weights / np.bincount(parents)[parents])
    weights.flags.writeable = False
    return weights


def linearise_mean(values: Float64, weights: Float64) -> Float64:
    """Linearise a weighted mean: return values (N,) with the same plain mean, and equal deviations when resampled.

    Under resampling, the weighted mean deviates to first order like the plain mean of ``N w (x - mean)``.

    Args:
        values: (N,) finite values.
        weights: (N,) weights of sum 1.
    """
    mean = math.fsum(weights * values)
    return np.asarray(mean + len(values) * weights * (values - mean))


def assign_blocks(protocol: Protocol, views: Sequence[RenderView]) -> Int64:
    """Return the block (N,) of each view: consecutive frames that are resampled together."""
    frames = tuple((view.traversal_id, view.frame_index) for view in views)
    return _assign_blocks(frames, protocol.intervals.block_frames)


@lru_cache(_CACHED)
def _assign_blocks(frames: tuple[tuple[str, int], ...], length: int) -> Int64:
    """Blocks of images by their traversals and frames; the metrics of a group share them."""
    blocks = frame_blocks([traversal for traversal, _ in frames], [frame for _, frame in frames], length)
    blocks.flags.writeable = False
    return blocks


def weighted_interval(
    protocol: Protocol, views: Sequence[RenderView], values: Float64, weights: Float64
) -> tuple[float, Interval]:
    """Compute a weighted mean of finite values, and its interval from resampling blocks of frames."""
    mean = math.fsum(weights * values)
    spread = linearise_mean(values, weights)
    options = protocol.intervals
    blocks = assign_blocks(protocol, views)
    # Blocks are counted from 0, without a gap.
    n_blocks = int(blocks.max()) + 1
    if n_blocks < MIN_BLOCKS:
        return mean, Interval(mean, math.nan, math.nan, len(values), 0, n_blocks, TOO_FEW_BLOCKS)
    interval = mean_interval(spread, blocks, confidence=options.level, resamples=options.resamples, seed=options.seed)
    return mean, interval


def _compute_figure(
    protocol: Protocol,
    measure: Measure,
    group: str,
    level: Level,
    key: str,
    views: Sequence[RenderView],
    scores: Sequence[Score],
    averaging: Sequence[str],
) -> GroupFigure:
    summary = summarise(scores)
    rows = [row for row, score in enumerate(scores) if math.isfinite(score)]
    value: float | None = None
    interval: Interval | None = None
    if rows:
        finite_views = [views[row] for row in rows]
        values = np.array([float(scores[row]) for row in rows])
        value, interval = weighted_interval(protocol, finite_views, values, mean_weights(finite_views, averaging))
    return GroupFigure(
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
