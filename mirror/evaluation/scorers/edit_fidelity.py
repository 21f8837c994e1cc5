"""Scores edited images against the exact truth of the edit, in the hulls of the vehicles and outside them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from mirror.arrays import Bool, UInt8
from mirror.evaluation.figures import compute_figures, compute_overall_figure
from mirror.evaluation.result import GroupFigure
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.scorers.reconstruction import find_score, score_pixels
from mirror.evaluation.scorers.scorer import ScoredJob, Values
from mirror.metrics.catalogue import MEASURES
from mirror.metrics.score import Score
from mirror.protocols.document import Protocol
from mirror.protocols.metrics import EditFidelity, metric_name
from mirror.protocols.ranking import ALL
from mirror.protocols.views.edited_region import grown_hulls
from mirror.protocols.views.plan import find_group
from mirror.protocols.views.view import RenderView

LEAST: Final = "least"
"""The part that stands for the worst of all parts."""


def fidelity_metrics(protocol: Protocol) -> list[EditFidelity]:
    """List the metrics of a protocol that need the exact truth of edits."""
    return [metric for metric in protocol.metrics if isinstance(metric, EditFidelity)]


def has_fidelity(view: RenderView, inputs: ScoringInputs) -> bool:
    """Return whether a view is scored against the exact truth: its vehicles move, and the organiser rendered it."""
    return bool(
        inputs.hidden is not None
        and fidelity_metrics(inputs.protocol)
        and find_group(inputs.protocol, view.group).vehicle_shift_m
    )


def score_fidelity(view: RenderView, render: UInt8, inputs: ScoringInputs) -> Values:
    """Compute the figures of all parts of one edited view.

    A part with fewer scored pixels than the protocol requests of a vehicle has no value, and a view whose targets have
    none either.

    Args:
        view: a view for which `has_fidelity` holds.
        render: (H, W, 3) its render.
        inputs: the protocol and the truth.
    """
    vehicles = inputs.protocol.vehicles
    least_px = 1.0 if vehicles is None else vehicles.min_area_px
    truth, scored = inputs.truth.image(view), inputs.scored_mask(view)
    old, new = grown_hulls(view)
    parts = {"old": old & scored, "new": new & scored, "outside": scored & ~old & ~new}
    values: dict[str, float | int | str | None] = {f"{name}_px": int(part.sum()) for name, part in parts.items()}
    known: dict[tuple[str, str], Score] = {}
    for metric in fidelity_metrics(inputs.protocol):

        def score(part: str, metric: EditFidelity = metric) -> Score:
            key = metric.figure.model_dump_json(), part
            if key not in known:
                known[key] = _score_part(metric, render, truth, parts, part, least_px, inputs)
            return known[key]

        value = _least([score(part) for part in parts], score("new")) if metric.part == LEAST else score(metric.part)
        name = metric_name(metric)
        values[name] = float(value)
        if value.reason is not None:
            values[f"{name}.reason"] = value.reason
    return values


def _score_part(
    metric: EditFidelity,
    render: UInt8,
    truth: UInt8,
    parts: dict[str, Bool],
    part: str,
    least_px: float,
    inputs: ScoringInputs,
) -> Score:
    for needed in dict.fromkeys(("new", part)):
        if parts[needed].sum() < least_px:
            return Score(math.nan, f"the part {needed} has fewer than {least_px:g} scored pixels")
    return score_pixels(metric.figure, render, truth, parts[part], inputs)[0]


def _least(scores: list[Score], of_target: Score) -> Score:
    """Return the least of the scores with a value; none if the target has none."""
    return of_target if math.isnan(of_target) else min(score for score in scores if not math.isnan(score))


def fidelity_figures(protocol: Protocol, scored: Sequence[ScoredJob], inputs: ScoringInputs) -> list[GroupFigure]:
    """Compute the figures against the exact truth: of each group whose vehicles move, and of all groups that rank."""
    figures: list[GroupFigure] = []
    members = [one for one in scored if has_fidelity(one.job.views[0], inputs)]
    for metric in fidelity_metrics(protocol) if members else ():
        measure = MEASURES[metric_name(metric)]
        for group in [*dict.fromkeys(one.job.views[0].group for one in members), ALL]:
            of_group = [one for one in members if group in (ALL, one.job.views[0].group)]
            views = [one.job.views[0] for one in of_group]
            scores = [find_score(one.values, measure.name) for one in of_group]
            if group == ALL:
                figures += compute_overall_figure(protocol, measure, views, scores)
            else:
                figures += compute_figures(protocol, measure, group, views, scores)
    return figures
