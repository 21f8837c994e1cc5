"""Counts a result's means again from the table of pictures beside it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from mirror.errors import DatasetError
from mirror.evaluation.figures import mean_weights
from mirror.evaluation.result import IMAGES, Figure, Result
from mirror.protocols.views.view import RenderView
from mirror_leaderboard.entry import ALL
from mirror_leaderboard.refused import RefusedError

_TOLERANCE: Final = 1e-9
_MOST_BYTES: Final = 1 << 30


def require_recomputed_means(result: Result, path: Path) -> None:
    """Hold every mean over pictures against the table of pictures.

    Figures of whole sets, such as FID, cannot be had from it.

    Args:
        result: as read.
        path: its file; the table lies beside it.

    Raises:
        DatasetError: the table is missing or broken.
        RefusedError: a figure is not the mean of its pictures, not of as many, or left out.
    """
    rows = _rows(path.parent / IMAGES)
    columns = set(rows[0]) if rows else set()
    for number, figure in enumerate(result.figures):
        if figure.level == "group" and figure.metric in columns:
            own = [row for row in rows if figure.group in (ALL, row["group"])]
            _require(result, figure, own, path, f"figures.{number}")
    there = {(figure.group, figure.metric) for figure in result.figures if figure.level == "group"}
    for metric in sorted(columns & set(result.protocol.metric_names)):
        for group in dict.fromkeys(row["group"] for row in rows):
            if (group, metric) not in there:
                raise RefusedError(
                    f"{metric} of {group} was measured, by {IMAGES}, and is not there",
                    file=path,
                    place="figures",
                    remedy="evaluate the submission again: mirror evaluate",
                )


def _require(result: Result, figure: Figure, rows: Sequence[Mapping[str, Any]], path: Path, place: str) -> None:
    values = [row[figure.metric] for row in rows]
    infinite = sum(value is not None and math.isinf(value) for value in values)
    if (figure.n, figure.n_inf) != (len(rows), infinite):
        raise RefusedError(
            f"{figure.metric} of {figure.group} is said to be of {figure.n} pictures, {figure.n_inf} of them infinite",
            file=path,
            place=place,
            expected=f"{len(rows)} and {infinite}, by {IMAGES}",
            remedy="evaluate the submission again: mirror evaluate",
        )
    finite = [row for row in rows if row[figure.metric] is not None and math.isfinite(row[figure.metric])]
    mean = None
    if finite:
        keys = ("scene_id", "traversal_id")
        views = [RenderView.model_construct(**{key: row[key] for key in keys}) for row in finite]
        weights = mean_weights(views, result.protocol.averaging)
        mean = math.fsum(weights * np.array([row[figure.metric] for row in finite]))
    fits = (
        mean is None
        if figure.value is None
        else mean is not None and math.isclose(mean, figure.value, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE)
    )
    if not fits:
        raise RefusedError(
            f"{figure.metric} of {figure.group} is {figure.value}, which is not the mean of its pictures",
            file=path,
            place=place,
            expected=f"{mean}, by {IMAGES}",
            remedy="evaluate the submission again: mirror evaluate",
        )


def _rows(file: Path) -> list[dict[str, Any]]:
    try:
        if file.stat().st_size > _MOST_BYTES:
            raise DatasetError("too large", file=file, expected=f"at most {_MOST_BYTES:,} bytes")
        rows: list[dict[str, Any]] = pq.read_table(file).to_pylist()
    except (OSError, pa.ArrowInvalid) as error:
        raise DatasetError(
            f"cannot be read ({str(error).splitlines()[0]})",
            file=file,
            expected="the table of pictures that `mirror evaluate` wrote beside result.json",
        ) from error
    return rows
