"""Comparison of results: the difference of every figure from the first result's, its interval and its p-value."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from mirror.counting import count_of
from mirror.errors import DatasetError, UsageError
from mirror.evaluation.figures import (
    MIN_BLOCKS,
    TOO_FEW_BLOCKS,
    assign_blocks,
    linearise_mean,
    mean_weights,
    overall_averaging,
)
from mirror.evaluation.result import IMAGES, GroupFigure, Result, finite_or_none
from mirror.evaluation.run import read_result
from mirror.metrics.catalogue import find_measure
from mirror.metrics.images.bootstrap import paired_difference
from mirror.protocols.ranking import ALL
from mirror.protocols.views.view import RenderView
from mirror.schema.parquet_memory import read_python_rows

_KEYS: Final = ("group", "scene_id", "traversal_id", "frame_index", "camera", "light", "weather")


@dataclass(frozen=True)
class FigureComparison:
    """One figure of two results.

    Attributes:
        metric: name of the metric.
        group: group of the protocol.
        first: value of the first result.
        other: value of the other result.
        difference: other minus first, averaged in the protocol's order over images with finite values in both; None:
            the figure is of a set of images, or no image has two finite values.
        low: lower end of the difference's confidence interval.
        high: upper end of the difference's confidence interval.
        p_value: two-sided p-value of a sign-flip test over blocks of frames.
        n: number of compared images.
        reason: why there is no interval or p-value.
        better: ``first`` or ``other``; None: the interval contains 0, or the p-value is above 1 - confidence level.
        ranks: whether this is the figure that ranks results of the protocol.
    """

    metric: str
    group: str
    first: float | None
    other: float | None
    difference: float | None
    low: float | None
    high: float | None
    p_value: float | None
    n: int
    reason: str | None
    better: str | None
    ranks: bool = False


@dataclass(frozen=True)
class ResultComparison:
    """The comparison of a result with the first result.

    Attributes:
        name: method name of the other result.
        path: path of the other result.
        rows: comparisons, one for each figure; the one that ranks is the first.
    """

    name: str
    path: str
    rows: tuple[FigureComparison, ...]


def compare(paths: Sequence[Path]) -> tuple[Result, list[ResultComparison]]:
    """Compare the first result with each of the others.

    Args:
        paths: two or more result files or their folders.

    Returns:
        The first result, and one comparison for each of the others.

    Raises:
        UsageError: fewer than two results, or results of different protocols, views or hidden truth.
        DatasetError: a file is missing or damaged.
    """
    if len(paths) < 2:
        listed = f": {paths[0]}" if paths else ""
        raise UsageError(f"{count_of(len(paths), 'result')} to compare{listed}", expected="two or more results")
    results = [read_result(path) for path in paths]
    first = results[0]
    for path, other in zip(paths[1:], results[1:]):
        for what, first_hash, other_hash in (
            ("protocols", first.protocol_hash, other.protocol_hash),
            ("views", first.dataset.plan_hash, other.dataset.plan_hash),
            ("hidden truth", first.dataset.hidden_truth, other.dataset.hidden_truth),
        ):
            if first_hash != other_hash:
                raise UsageError(
                    f"this result and {paths[0]} use different {what}",
                    file=path,
                    expected="results of the same protocol, split and dataset",
                    remedy="evaluate both with the same protocol, split, dataset and hidden truth",
                )
    rows = [_read_image_rows(path) for path in paths]
    return first, [
        ResultComparison(other.submission.method.name, str(path), tuple(_compare(first, other, rows[0], other_rows)))
        for path, other, other_rows in zip(paths[1:], results[1:], rows[1:])
    ]


def _read_image_rows(path: Path) -> dict[str, dict[str, Any]]:
    file = (path if path.is_dir() else path.parent) / IMAGES
    try:
        return {row["path"]: row for row in read_python_rows(file)}
    except (OSError, ValueError, KeyError) as error:
        raise DatasetError(
            f"cannot be read ({error})", file=file, expected="the table of images beside result.json"
        ) from error


def _compare(
    first: Result, other: Result, first_rows: dict[str, dict[str, Any]], other_rows: dict[str, dict[str, Any]]
) -> list[FigureComparison]:
    figures = {(figure.group, figure.metric): figure for figure in other.figures if figure.level == "group"}
    rows = [
        _compare_figure(first, figure, figures[figure.group, figure.metric], first_rows, other_rows)
        for figure in first.figures
        if figure.level == "group" and (figure.group, figure.metric) in figures
    ]
    column = None if first.protocol.ranking is None else first.protocol.ranking.column
    rows = [replace(row, ranks=(row.group, row.metric) == column) for row in rows]
    return sorted(rows, key=lambda row: not row.ranks)


def _compare_figure(
    result: Result,
    first: GroupFigure,
    other: GroupFigure,
    first_rows: dict[str, dict[str, Any]],
    other_rows: dict[str, dict[str, Any]],
) -> FigureComparison:
    name = first.metric
    ranking = result.protocol.ranking
    is_overall = ranking is not None and first.group == ALL
    groups = ranking.groups if ranking is not None and is_overall else (first.group,)
    paths = [
        path
        for path, row in first_rows.items()
        if row["group"] in groups
        and path in other_rows
        and _is_finite(row.get(name))
        and _is_finite(other_rows[path].get(name))
    ]
    if not paths:
        is_of_images = not first_rows or name in next(iter(first_rows.values()))
        reason = "no image has a finite value in both" if is_of_images else "a figure of a set of images has no pairs"
        return _without_difference(first, other, reason)
    views = [_make_view(first_rows[path]) for path in paths]
    changes = np.array([other_rows[path][name] - first_rows[path][name] for path in paths])
    averaging = overall_averaging(result.protocol) if is_overall else result.protocol.averaging
    weights = mean_weights(views, averaging)
    spread = linearise_mean(changes, weights)
    options = result.protocol.intervals
    blocks = assign_blocks(result.protocol, views)
    difference = math.fsum(weights * changes)
    if len(np.unique(blocks)) < MIN_BLOCKS:
        return replace(_without_difference(first, other, TOO_FEW_BLOCKS), difference=difference, n=len(paths))
    paired = paired_difference(
        spread,
        np.zeros_like(spread),
        blocks,
        confidence=options.level,
        resamples=options.resamples,
        seed=options.seed,
    )
    interval = paired.interval
    better = None
    is_significant = paired.p_value <= 1.0 - options.level
    if is_significant and (interval.low > 0.0 or interval.high < 0.0):
        better = "other" if (interval.low > 0.0) == (find_measure(name).better == "higher") else "first"
    return FigureComparison(
        metric=name,
        group=first.group,
        first=first.value,
        other=other.value,
        difference=difference,
        low=finite_or_none(interval.low),
        high=finite_or_none(interval.high),
        p_value=finite_or_none(paired.p_value),
        n=len(paths),
        reason=interval.reason,
        better=better,
    )


def _without_difference(first: GroupFigure, other: GroupFigure, reason: str) -> FigureComparison:
    return FigureComparison(
        first.metric, first.group, first.value, other.value, None, None, None, None, 0, reason, None
    )


def _is_finite(value: object) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value)


def _make_view(row: dict[str, Any]) -> RenderView:
    """Make a view with only the fields that means and blocks use."""
    return RenderView.model_construct(**{key: row[key] for key in _KEYS})
