"""Results side by side: every figure with its difference from the first result's, and how likely chance makes it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow.parquet as pq

from mirror.errors import DatasetError, UsageError
from mirror.evaluation.figures import MIN_BLOCKS, TOO_FEW_BLOCKS, assign_blocks, linearise_mean, mean_weights
from mirror.evaluation.result import IMAGES, Figure, Result, finite_or_none
from mirror.evaluation.run import read_result
from mirror.metrics.images.bootstrap import paired_difference
from mirror.protocols.views.view import RenderView

_KEYS: Final = ("scene_id", "traversal_id", "frame_index", "camera", "light", "weather")


@dataclass(frozen=True)
class FigureComparison:
    """One figure of two results.

    Attributes:
        metric: its name.
        group: the protocol's group.
        first: the first result's value.
        other: the other's.
        difference: other less first, over pictures where both are finite, in the protocol's order of means; None: the
            figure is of a whole set, not of pictures, or none is finite.
        low: lower end of the difference's interval.
        high: upper end.
        p_value: of flipping the signs of blocks of frames, two-sided.
        n: pictures that were compared.
        reason: why there is no interval or p-value.
        better: ``first``, ``other``, or None: the interval holds 0, or the p-value says that it may be chance.
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


@dataclass(frozen=True)
class ResultComparison:
    """Two results.

    Attributes:
        name: of the other's method.
        path: of the other.
        rows: figure by figure.
    """

    name: str
    path: str
    rows: tuple[FigureComparison, ...]


def compare(paths: Sequence[Path]) -> tuple[Result, list[ResultComparison]]:
    """Compare results with the first of them.

    Args:
        paths: two or more results or their folders.

    Returns:
        The first result, and one comparison for each of the others.

    Raises:
        UsageError: fewer than two, or they are of other protocols, splits or datasets.
        DatasetError: a file is missing or not that of its result.
    """
    if len(paths) < 2:
        listed = ", ".join(map(str, paths)) or "none"
        raise UsageError(f"one result alone: {listed}", expected="two or more")
    results = [read_result(path) for path in paths]
    first = results[0]
    for path, other in zip(paths[1:], results[1:]):
        for what, one, two in (
            ("protocol", first.protocol_hash, other.protocol_hash),
            ("views", first.dataset.plan_hash, other.dataset.plan_hash),
            ("hidden truth", first.dataset.hidden_truth, other.dataset.hidden_truth),
        ):
            if one != two:
                raise UsageError(
                    f"its {what} is another than that of {paths[0]}",
                    file=path,
                    expected="results of one protocol, split and dataset",
                    remedy="evaluate both submissions in the same way",
                )
    rows = [_images(path) for path in paths]
    return first, [
        ResultComparison(other.submission.method.name, str(path), tuple(_compare(first, other, rows[0], own)))
        for path, other, own in zip(paths[1:], results[1:], rows[1:])
    ]


def _images(path: Path) -> dict[str, dict[str, Any]]:
    file = (path if path.is_dir() else path.parent) / IMAGES
    try:
        return {row["path"]: row for row in pq.read_table(file).to_pylist()}
    except (OSError, ValueError, KeyError) as error:
        raise DatasetError(
            f"cannot be read ({error})", file=file, expected="the table of pictures that lies beside result.json"
        ) from error


def _compare(
    first: Result, other: Result, mine: dict[str, dict[str, Any]], theirs: dict[str, dict[str, Any]]
) -> list[FigureComparison]:
    figures = {(figure.group, figure.metric): figure for figure in other.figures if figure.level == "group"}
    found = []
    for figure in first.figures:
        key = (figure.group, figure.metric)
        if figure.level == "group" and key in figures:
            found.append(_one(first, figure, figures[key], mine, theirs))
    return found


def _one(
    result: Result, first: Figure, other: Figure, mine: dict[str, dict[str, Any]], theirs: dict[str, dict[str, Any]]
) -> FigureComparison:
    name = first.metric
    paths = [
        path
        for path, row in mine.items()
        if row["group"] == first.group and path in theirs and _finite(row.get(name)) and _finite(theirs[path].get(name))
    ]
    if not paths:
        reason = "a figure of a whole set has no pairs" if mine and name not in next(iter(mine.values())) else None
        return _alone(first, other, reason or "no picture has a finite value in both")
    views = [_view(mine[path]) for path in paths]
    changes = np.array([theirs[path][name] - mine[path][name] for path in paths])
    weights = mean_weights(views, result.protocol.averaging)
    spread = linearise_mean(changes, weights)
    options = result.protocol.intervals
    blocks = assign_blocks(result.protocol, views)
    difference = math.fsum(weights * changes)
    if len(np.unique(blocks)) < MIN_BLOCKS:
        return replace(_alone(first, other, TOO_FEW_BLOCKS), difference=difference, n=len(paths))
    found = paired_difference(
        spread,
        np.zeros_like(spread),
        blocks,
        confidence=options.level,
        resamples=options.resamples,
        seed=options.seed,
    )
    interval = found.interval
    better = None
    sure = found.p_value <= 1.0 - options.level
    if first.better != "none" and sure and (interval.low > 0.0 or interval.high < 0.0):
        better = "other" if (interval.low > 0.0) == (first.better == "higher") else "first"
    return FigureComparison(
        metric=name,
        group=first.group,
        first=first.value,
        other=other.value,
        difference=difference,
        low=finite_or_none(interval.low),
        high=finite_or_none(interval.high),
        p_value=finite_or_none(found.p_value),
        n=len(paths),
        reason=interval.reason,
        better=better,
    )


def _alone(first: Figure, other: Figure, reason: str) -> FigureComparison:
    return FigureComparison(
        first.metric, first.group, first.value, other.value, None, None, None, None, 0, reason, None
    )


def _finite(value: object) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value)


def _view(row: dict[str, Any]) -> RenderView:
    """What means and blocks are taken by."""
    return RenderView.model_construct(**{key: row[key] for key in _KEYS})
