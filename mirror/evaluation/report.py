"""The report: a page with the best, median and worst renders over their truth, and the figures of a result.

It is a single HTML file without scripts or network access, and is readable on a phone and in dark mode.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from mirror.arrays import Bool, UInt8
from mirror.errors import UsageError
from mirror.evaluation.report_tables import (
    Footnotes,
    breakdown_tables,
    find_headline,
    format_value,
    list_measures,
    select_ranks,
    summary_table,
)
from mirror.evaluation.result import Result
from mirror.evaluation.run import Evaluation
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.scorers.scorer import ScoredJob
from mirror.metrics.catalogue import find_measure
from mirror.pages.images import inline_image
from mirror.pages.rendering import render_page
from mirror.protocols.ranking import group_title
from mirror.protocols.views.view import RenderView
from mirror.schema.files import write_bytes

_WIDTH_PX: Final = 480
_FULL_ERROR: Final = 64.0
_GREY: Final = 96
"""Level of pixels that are not compared."""


def write_report(done: Evaluation, out: Path, baselines: Sequence[Result] = ()) -> None:
    """Write the report of an evaluation.

    Args:
        done: evaluation with a result.
        out: HTML file; it is replaced atomically.
        baselines: results of the same protocol, dataset and split, such as that of a floor, which are shown beside it.

    Raises:
        UsageError: the evaluation has no result, or a baseline is not comparable.
        DatasetError: an image cannot be read, or the file cannot be written.
    """
    if done.result is None or done.inputs is None:
        raise UsageError("nothing was scored", remedy="correct the submission's problems first")
    result = done.result
    _require_comparable(result, baselines)
    title = f"{result.submission.method.name}: {result.protocol.name}"
    notes = Footnotes()
    page = render_page(
        "mirror.evaluation",
        "report.html",
        title=title,
        headline=_find_headline(result, baselines),
        lines=_list_lines(done, result),
        summary=summary_table(result, baselines, notes),
        unavailable=_list_unavailable(result),
        breakdowns=list(breakdown_tables(result, notes)),
        remarks=list(notes.numbers),
        measures=list_measures(result),
        examples=list(_list_examples(result, done.scored, done.inputs)),
        result=result,
    )
    write_bytes(out, page.encode())


def error_map(render: UInt8, truth: UInt8, scored: Bool) -> UInt8:
    """Colour the absolute difference, averaged over channels: 0 is black, then red, yellow, and white from 64 levels.

    Args:
        render: (H, W, 3), RGB.
        truth: (H, W, 3), RGB.
        scored: (H, W) mask; unscored pixels are grey.
    """
    import cv2

    difference = np.abs(render.astype(np.int16) - truth).mean(axis=2)
    level = np.minimum(difference * (255.0 / _FULL_ERROR), 255.0).astype(np.uint8)
    coloured = np.asarray(cv2.applyColorMap(level, cv2.COLORMAP_HOT), np.uint8)[..., ::-1].copy()
    return cover(coloured, ~scored)


def cover(image: UInt8, hidden: Bool) -> UInt8:
    """Return an image (H, W, 3) in which the pixels of a mask (H, W) are grey."""
    covered = image.copy()
    covered[hidden] = _GREY
    return covered


def _list_lines(done: Evaluation, result: Result) -> list[str]:
    """List what was evaluated on what, and the warnings."""
    submission, dataset = result.submission, result.dataset
    views = done.plan.views
    scenes, traversals = ({getattr(view, key) for view in views} for key in ("scene_id", "traversal_id"))
    parts = [f"{len(scenes)} scenes", f"{len(traversals)} traversals", f"{len(views)} views"]
    authors = f", {submission.method.authors}" if submission.method.authors else ""
    appearance = f"{submission.appearance.policy} {submission.appearance.description}".strip()
    root = "" if done.inputs is None else Path(done.inputs.dataset.root).name
    return [
        f"{submission.method.name} {submission.method.version}{authors}; appearance: {appearance}",
        f"dataset {dataset.dataset_hash[:12]} (folder {root}), split {dataset.split}: {', '.join(parts)}; protocol "
        f"version {result.protocol.version}",
        *result.warnings,
    ]


def _find_headline(result: Result, baselines: Sequence[Result]) -> tuple[str, str] | None:
    """Return the figure that ranks and its name, with those of the baselines; None: no group has a figure."""
    figure = find_headline(result)
    if figure is None:
        return None
    beside = [
        f"{one.submission.method.name} {format_value(other)}"
        for one in baselines
        for other in one.figures
        if (other.level, other.group, other.metric) == ("group", figure.group, figure.metric)
    ]
    ranks = "ranks results" if result.protocol.ranking is not None else ""
    return format_value(figure), "; ".join(
        filter(None, [f"{group_title(figure.group)}: {find_measure(figure.metric).title}", ranks, *beside])
    )


def _require_comparable(result: Result, baselines: Sequence[Result]) -> None:
    for one in baselines:
        if (one.protocol_hash, one.dataset) != (result.protocol_hash, result.dataset):
            raise UsageError(
                f"the result of {one.submission.method.name} has another protocol, dataset or split",
                place="--baseline",
                expected=f"a result of protocol {result.protocol_hash[:12]}, plan {result.dataset.plan_hash[:12]}",
                remedy="evaluate the baseline with the same dataset, protocol and split",
            )


def _list_unavailable(result: Result) -> str:
    """List the metrics without weights or data in one line; empty if there are none."""
    parts = [
        f"{find_measure(metric).title} ({reason.partition('; ')[0]})" for metric, reason in result.unavailable.items()
    ]
    return "; ".join(parts)


def _list_examples(result: Result, scored: Sequence[ScoredJob], inputs: ScoringInputs) -> Iterable[dict[str, object]]:
    """List the best, median and worst renders of each group by the metric that ranks, or by PSNR."""
    ranking = result.protocol.ranking
    metric = "psnr" if ranking is None else ranking.metric
    measure = find_measure(metric)
    figure = next((figure for figure in result.figures if figure.metric == metric), None)
    if figure is None:
        return
    ranked: dict[str, list[tuple[float, ScoredJob]]] = {}
    for scored_job in scored:
        value = scored_job.values.get(metric)
        if isinstance(value, float) and not math.isnan(value):
            ranked.setdefault(scored_job.job.views[0].group, []).append((value, scored_job))
    for group, group_ranked in ranked.items():
        group_ranked.sort(key=lambda item: item[0], reverse=measure.better == "lower")
        renders = []
        for title, ranks in reversed(select_ranks(len(group_ranked)).items()):
            for rank in reversed(ranks):
                value, scored_job = group_ranked[rank]
                shown, view = format_value(figure.model_copy(update={"value": value})), scored_job.job.views[0]
                about = {"title": f"{title}: {measure.title} {shown}", "view": view, "id": f"{group}-{title}-{rank}"}
                renders.append({**about, **_inline_views(view, inputs)})
        yield {"name": group_title(group), "renders": renders}


def _inline_views(view: RenderView, inputs: ScoringInputs) -> dict[str, object]:
    """Return a render, its truth and its error as images, and their width."""
    render, truth, scored = inputs.render(view), inputs.truth.image(view), inputs.scored_mask(view)
    outside = inputs.truth.outside_lens(view)
    images = {
        "render": cover(render, outside),
        "truth": cover(truth, outside),
        "error": error_map(render, truth, scored),
    }
    inlined = {name: inline_image(image, f"{name} of {view.path}", _WIDTH_PX) for name, image in images.items()}
    return {**inlined, "width": min(render.shape[1], _WIDTH_PX)}
