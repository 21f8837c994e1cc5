"""The report: a page with the figures of a result, and its worst, median and best renders beside truth and error.

It is a single HTML file without scripts or network access, and is readable on a phone and in dark mode.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
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
    metrics_list,
    summary_table,
)
from mirror.evaluation.result import Result
from mirror.evaluation.run import Evaluation
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.scorers.scorer import ScoredJob
from mirror.html import inline_image, style_sheet
from mirror.metrics.catalogue import find_measure
from mirror.protocols.views.view import RenderView
from mirror.schema.files import write_bytes
from mirror.version import __version__

_WIDTH_PX: Final = 480
_EXAMPLES_EACH: Final = 2
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
    parts = [
        f"<header><h1>{escape(title)}</h1>{_format_header(done, result, baselines)}</header>",
        "<h2>Figures</h2>",
        summary_table(result, baselines, notes),
        _format_unavailable(result),
        *breakdown_tables(result, notes),
        notes.format(),
        "<h2>Metrics</h2>",
        metrics_list(result),
        *_list_examples(result, done.scored, done.inputs),
        f"<footer>Made by mirror {__version__}; protocol {result.protocol_hash[:12]}, "
        f"result {result.hash[:12]}.</footer>",
    ]
    style = style_sheet() + files("mirror.evaluation").joinpath("report.css").read_text()
    page = (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<style>{style}</style></head><body><main>{''.join(parts)}</main></body></html>\n"
    )
    write_bytes(out, page.encode())


def error_map(render: UInt8, truth: UInt8, scored: Bool) -> UInt8:
    """Colour the absolute difference, mean over channels: black is 0, then red and yellow, white is 64 levels or more.

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
    """Return an image (H, W, 3) whose pixels in a mask (H, W) are grey."""
    covered = image.copy()
    covered[hidden] = _GREY
    return covered


def _format_header(done: Evaluation, result: Result, baselines: Sequence[Result]) -> str:
    submission, dataset = result.submission, result.dataset
    views = done.plan.views
    scenes, traversals = ({getattr(view, key) for view in views} for key in ("scene_id", "traversal_id"))
    parts = [f"{len(scenes)} scenes", f"{len(traversals)} traversals", f"{len(views)} views"]
    authors = f", {submission.method.authors}" if submission.method.authors else ""
    appearance = f"{submission.appearance.policy} {submission.appearance.description}".strip()
    root = "" if done.inputs is None else Path(done.inputs.dataset.root).name
    lines = [
        f"{submission.method.name} {submission.method.version}{authors}; appearance: {appearance}",
        f"dataset {dataset.dataset_hash[:12]} (folder {root}), split {dataset.split}: {', '.join(parts)}; protocol "
        f"version {result.protocol.version}",
        *result.warnings,
    ]
    texts = "".join(f'<p class="dim">{escape(line)}</p>' for line in lines)
    return _format_headline(result, baselines) + texts


def _format_headline(result: Result, baselines: Sequence[Result]) -> str:
    """Format the figure that ranks, with those of the baselines; empty if no group has a figure."""
    figure = find_headline(result)
    if figure is None:
        return ""
    beside = [
        f"{one.submission.method.name} {format_value(other)}"
        for one in baselines
        for other in one.figures
        if (other.level, other.group, other.metric) == ("group", figure.group, figure.metric)
    ]
    ranks = "ranks results" if result.protocol.ranking is not None else ""
    words = "; ".join(filter(None, [f"{figure.group}: {figure.metric}", ranks, *beside]))
    tile = f'<div class="tile"><b>{escape(format_value(figure))}</b><span>{escape(words)}</span></div>'
    return f'<div class="tiles">{tile}</div>'


def _require_comparable(result: Result, baselines: Sequence[Result]) -> None:
    for one in baselines:
        if (one.protocol_hash, one.dataset) != (result.protocol_hash, result.dataset):
            raise UsageError(
                f"the result of {one.submission.method.name} has another protocol, dataset or split",
                place="--baseline",
                expected=f"a result of protocol {result.protocol_hash[:12]}, plan {result.dataset.plan_hash[:12]}",
                remedy="evaluate the baseline with the same dataset, protocol and split",
            )


def _format_unavailable(result: Result) -> str:
    """Format the metrics without weights or data in one line; empty if there are none."""
    if not result.unavailable:
        return ""
    parts = [f"{metric} ({reason.partition('; ')[0]})" for metric, reason in result.unavailable.items()]
    return f'<p class="dim">Not scored: {escape("; ".join(parts))}.</p>'


def _list_examples(result: Result, scored: Sequence[ScoredJob], inputs: ScoringInputs) -> Iterable[str]:
    """List the worst, median and best renders of each group by the metric that ranks, or by PSNR."""
    ranking = result.protocol.ranking
    metric = "psnr" if ranking is None else ranking.metric
    figure = next((figure for figure in result.figures if figure.metric == metric), None)
    if figure is None:
        return
    ranked: dict[str, list[tuple[float, ScoredJob]]] = {}
    for scored_job in scored:
        value = scored_job.values.get(metric)
        if isinstance(value, float) and not math.isnan(value):
            ranked.setdefault(scored_job.job.views[0].group, []).append((value, scored_job))
    for group, group_ranked in ranked.items():
        group_ranked.sort(key=lambda item: item[0], reverse=find_measure(metric).better == "lower")
        yield f"<h2>Renders of {escape(group)}</h2>"
        yield '<p class="dim">Render, truth, and error: white is 64 of 255 levels or more, grey is not scored.</p>'
        for title, ranks in _select_ranks(len(group_ranked)).items():
            for rank in ranks:
                value, scored_job = group_ranked[rank]
                shown = format_value(figure.model_copy(update={"value": value}))
                yield _format_triple(f"{title}: {metric} {shown}", scored_job.job.views[0], inputs)


def _select_ranks(count: int) -> dict[str, range]:
    """Select disjoint ranges of ranks among `count` sorted renders: worst, median and best."""
    each = min(_EXAMPLES_EACH, max(count // 3, 1))
    middle = max((count - each) // 2, 0)
    ranks = {"worst": range(min(each, count))}
    if count > 2:
        ranks["median"] = range(middle, middle + each)
    if count > 1:
        ranks["best"] = range(count - each, count)
    return ranks


def _format_triple(title: str, view: RenderView, inputs: ScoringInputs) -> str:
    render, truth, scored = inputs.render(view), inputs.truth.image(view), inputs.scored_mask(view)
    outside = inputs.truth.outside_lens(view)
    images = (
        ("render", cover(render, outside)),
        ("truth", cover(truth, outside)),
        ("error", error_map(render, truth, scored)),
    )
    figures = ""
    for name, image in images:
        inlined = inline_image(image, f"{name} of {view.path}", _WIDTH_PX)
        figures += f"<figure>{inlined}<figcaption>{name}</figcaption></figure>"
    return (
        f'<p><b>{escape(title)}</b> <span class="dim">{escape(view.camera)}, frame {view.frame_index} of '
        f"{escape(view.traversal_id)}, {escape(view.light)}, {escape(view.weather)}</span></p>"
        f'<div class="triple">{figures}</div>'
    )
