"""Computes a result's means again from the table of images beside it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from mirror.errors import DatasetError
from mirror.evaluation.clusters import compute_clusters
from mirror.evaluation.figures import mean_weights, overall_averaging
from mirror.evaluation.result import IMAGES, ClusterMean, GroupFigure, Result
from mirror.protocols.ranking import ALL
from mirror.protocols.views.view import RenderView
from mirror.schema.parquet_memory import read_python_rows
from mirror_leaderboard.refused import RefusedError

_TOLERANCE: Final = 1e-9
_MAX_BYTES: Final = 1 << 30


def require_recomputed_means(result: Result, path: Path) -> None:
    """Compare every mean over images, also the means of clusters, with the table of images.

    Figures of whole sets, such as FID, cannot be computed from the table.

    Args:
        result: the result.
        path: file of the result; the table lies beside it.

    Raises:
        DatasetError: the table is missing or broken.
        RefusedError: a figure differs from the mean of its images, states a wrong number of images, or is missing.
    """
    rows = read_rows(path)
    columns = set(rows[0]) if rows else set()
    ranking = result.protocol.ranking
    overall = ranking.groups if ranking is not None else ()
    for number, figure in enumerate(result.figures):
        if figure.level == "group" and figure.metric in columns:
            averaged = overall if figure.group == ALL else (figure.group,)
            members = [row for row in rows if row["group"] in averaged]
            _require_mean(result, figure, members, path, f"figures.{number}")
    present = {(figure.group, figure.metric) for figure in result.figures if figure.level == "group"}
    groups = dict.fromkeys(row["group"] for row in rows)
    if ranking is not None and set(ranking.groups) & set(groups):
        groups[ranking.group] = None
    for metric in sorted(columns & set(result.protocol.metric_names)):
        for group in groups:
            if (group, metric) not in present:
                raise RefusedError(
                    f"{metric} of {group} is missing, although {IMAGES} has its values",
                    file=path,
                    place="figures",
                    remedy="evaluate the submission again: mirror evaluate",
                )
    _require_clusters(result, rows, path)


def _require_clusters(result: Result, rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    expected = compute_clusters(result.protocol, rows)
    if result.clusters and not _are_equal(result.clusters, expected):
        raise RefusedError(
            "means of clusters are not those of the images",
            file=path,
            place="clusters",
            expected=f"those of {IMAGES}",
            remedy="evaluate the submission again: mirror evaluate",
        )


def _are_equal(stated: Sequence[ClusterMean], expected: Sequence[ClusterMean]) -> bool:
    return len(stated) == len(expected) and all(
        (one.key, one.n) == (other.key, other.n)
        and math.isclose(one.value, other.value, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE)
        and math.isclose(one.weight, other.weight, rel_tol=_TOLERANCE)
        for one, other in zip(stated, expected)
    )


def _require_mean(
    result: Result, figure: GroupFigure, rows: Sequence[Mapping[str, Any]], path: Path, place: str
) -> None:
    values = [row[figure.metric] for row in rows]
    infinite = sum(value is not None and math.isinf(value) for value in values)
    if (figure.n, figure.n_inf) != (len(rows), infinite):
        raise RefusedError(
            f"{figure.metric} of {figure.group} states {figure.n} images, {figure.n_inf} of them infinite",
            file=path,
            place=place,
            expected=f"{len(rows)} and {infinite}, as in {IMAGES}",
            remedy="evaluate the submission again: mirror evaluate",
        )
    finite = [row for row in rows if row[figure.metric] is not None and math.isfinite(row[figure.metric])]
    mean = None
    if finite:
        keys = ("group", "scene_id", "traversal_id")
        views = [RenderView.model_construct(**{key: row[key] for key in keys}) for row in finite]
        is_overall = figure.group == ALL
        averaging = overall_averaging(result.protocol) if is_overall else result.protocol.averaging
        weights = mean_weights(views, averaging)
        mean = math.fsum(weights * np.array([row[figure.metric] for row in finite]))
    is_equal = (
        mean is None
        if figure.value is None
        else mean is not None and math.isclose(mean, figure.value, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE)
    )
    if not is_equal:
        raise RefusedError(
            f"{figure.metric} of {figure.group} is {figure.value}, which is not the mean of its images",
            file=path,
            place=place,
            expected=f"{mean}, as in {IMAGES}",
            remedy="evaluate the submission again: mirror evaluate",
        )


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Read the table of images beside a result.

    Raises:
        DatasetError: the table is missing, too large or broken.
    """
    file = path.parent / IMAGES
    try:
        if file.stat().st_size > _MAX_BYTES:
            raise DatasetError("too large", file=file, expected=f"at most {_MAX_BYTES:,} bytes")
        rows = read_python_rows(file)
    except (OSError, pa.ArrowInvalid) as error:
        raise DatasetError(
            f"cannot be read ({str(error).splitlines()[0]})",
            file=file,
            expected="the table of images that `mirror evaluate` wrote beside result.json",
        ) from error
    return rows
