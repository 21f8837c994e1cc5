"""The report of rollouts: the best, median and worst from above, figures with intervals, and a table of all of them.

It is a single HTML file without scripts or network access, as that of renders.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from mirror.arrays import Float64
from mirror.evaluation.compare import ResultComparison
from mirror.evaluation.report_tables import (
    Footnotes,
    breakdown_tables,
    list_measures,
    metric_head,
    select_ranks,
    summary_table,
)
from mirror.evaluation.result import Level
from mirror.evaluation.rollout_series import draw_series
from mirror.evaluation.rollouts import RolloutEvaluation
from mirror.evaluation.scorers.safety import ScoredRollout
from mirror.metrics.catalogue import MEASURES
from mirror.metrics.safety import StateLog, find_collisions, read_state_log
from mirror.pages.rendering import render_page, render_part
from mirror.schema.files import write_bytes
from mirror.schema.road_map import RoadMap, read_road_map
from mirror.schema.rollout import MAP_FILE, STATES_FILE

if TYPE_CHECKING:
    from markupsafe import Markup

_RANKED_BY: Final = "epdms"
_BESIDE_M: Final = 12.0
_MOST: Final = 500
_COLUMNS: Final = ("collisions", "at_fault_collisions", "least_ttc", "drivable_margin", "off_road", "epdms")


def write_rollout_report(
    done: RolloutEvaluation, folder: Path, out: Path, comparisons: Sequence[ResultComparison] = ()
) -> None:
    """Write the report of an evaluation of rollouts.

    Args:
        done: the evaluation.
        folder: the evaluated folder.
        out: HTML file; it is replaced atomically.
        comparisons: paired comparisons with the results of other policies on the same drives.

    Raises:
        DatasetError: a rollout cannot be read, or the file cannot be written.
    """
    result = done.result
    title = f"{result.submission.method.name}: {result.protocol.name}"
    notes = Footnotes()
    listed = _rank(done.scored)[:_MOST]
    page = render_page(
        "mirror.evaluation",
        "rollouts.html",
        title=title,
        tiles=_list_tiles(done.scored),
        result=result,
        summary=summary_table(result, (), notes),
        examples=_draw_examples(done.scored, folder),
        columns=[f"n:{metric_head(name)}" for name in _COLUMNS],
        rollouts=[_describe_rollout(one) for one in listed],
        unlisted=len(done.scored) - len(listed),
        # The protocol's traversals are the scenarios of the rollouts.
        breakdowns=list(breakdown_tables(result, notes, _list_levels(done.scored))),
        comparisons=[_describe_comparison(one) for one in comparisons],
        remarks=list(notes.numbers),
        measures=list_measures(result),
    )
    write_bytes(out, page.encode())


def _list_levels(scored: Sequence[ScoredRollout]) -> dict[Level, str]:
    """List the levels at which the rollouts differ."""
    levels: dict[Level, str] = {"traversal": "By scenario"}
    if len({one.rollout.scene_id for one in scored}) > 1:
        levels["scene"] = "By street"
    if len({(one.scenario.light, one.scenario.weather) for one in scored}) > 1:
        levels["condition"] = "By light and weather"
    if any(one.rollout.sensors is not None for one in scored):
        levels["camera"] = "By fault of the sensors"
    return levels


def _describe_comparison(comparison: ResultComparison) -> dict[str, object]:
    rows = []
    for row in comparison.rows:
        between = "" if row.low is None or row.high is None else f"{row.low:+.3f} to {row.high:+.3f}"
        values = ["none" if value is None else f"{value:.3f}" for value in (row.first, row.other)]
        difference = "none" if row.difference is None else f"{row.difference:+.3f}"
        title = MEASURES[row.metric].title
        rows.append({"title": title, "values": values, "difference": difference, "between": between, "n": row.n})
    return {"name": comparison.name, "rows": rows}


def _list_tiles(scored: Sequence[ScoredRollout]) -> list[tuple[str, str]]:
    scenarios = {one.rollout.scenario for one in scored}
    return [
        (f"{len(scored)}", f"rollouts of {len(scenarios)} scenarios in the world {scored[0].rollout.world}"),
        (f"{sum(bool(one.values.get('collisions')) for one in scored)}", "with a collision"),
        (f"{sum((one.values.get('drivable_area') == 0.0) for one in scored)}", "off the drivable area"),
    ]


def _rank(scored: Sequence[ScoredRollout]) -> list[ScoredRollout]:
    """Order the worst first: by EPDMS, then by the least time to collision."""

    def key(one: ScoredRollout) -> tuple[float, float, str]:
        score, least = one.values.get(_RANKED_BY), one.values.get("least_ttc")
        return (math.inf if score is None else float(score), math.inf if least is None else float(least), one.path)

    return sorted(scored, key=key)


def _describe_rollout(one: ScoredRollout) -> dict[str, object]:
    cells = []
    for name in _COLUMNS:
        value, cause = one.values.get(name), one.causes.get(name)
        text = one.reasons.get(name, "none") if value is None else f"{value:.3g}"
        cells.append({"text": text, "cause": cause if value and cause else ""})
    run = one.rollout
    return {"scenario": run.scenario, "seed": run.seed, "ending": run.ending.replace("_", " "), "cells": cells}


def _draw_examples(scored: Sequence[ScoredRollout], folder: Path) -> list[dict[str, object]]:
    """Draw the best, median and worst rollouts from above."""
    ranked = _rank(scored)
    plans: list[dict[str, object]] = []
    for title, ranks in reversed(select_ranks(len(ranked)).items()):
        for one in (ranked[rank] for rank in reversed(ranks)):
            run = folder / one.path
            log, road_map = read_state_log(run / STATES_FILE), read_road_map(run / MAP_FILE)
            plan = draw_plan(log, road_map, moves=title == "worst")
            series = draw_series(log, road_map) if title == "worst" else ""
            score, measure = one.values.get(_RANKED_BY), MEASURES[_RANKED_BY]
            shown = "none" if score is None else f"{score:.2f}"
            words = f"{title}: {one.rollout.scenario}, seed {one.rollout.seed}, {measure.title} {shown}"
            if one.rollout.sensors is not None:
                words += f", {one.rollout.sensors}"
            plans.append({"plan": plan, "words": words, "series": series})
    return plans


def draw_plan(log: StateLog, road_map: RoadMap, *, moves: bool = False) -> Markup:
    """Draw a rollout from above as SVG: the drivable area, the ways of all actors, their last boxes and collisions.

    Args:
        log: the states.
        road_map: the map.
        moves: whether the boxes move along their ways, again and again; without a script.
    """
    ego = np.column_stack([log.x_m[:, 0], log.y_m[:, 0]])
    low, high = ego.min(axis=0) - _BESIDE_M, ego.max(axis=0) + _BESIDE_M
    width, height = (high - low).tolist()

    def points(line: Float64) -> str:
        return " ".join(f"{x - low[0]:.2f},{high[1] - y:.2f}" for x, y in line.tolist())

    rings = [np.asarray(ring)[:, :2] for ring in road_map.drivable_rings]
    area = " ".join("M" + points(ring).replace(" ", " L") + "Z" for ring in rings)
    actors = []
    for actor in reversed(range(len(log.ids))):
        rows = np.flatnonzero(log.present[:, actor])
        if not len(rows):
            continue
        way = np.column_stack([log.x_m[rows, actor], log.y_m[rows, actor]])
        box = _rectangle(log, int(rows[-1]), actor)
        about: dict[str, object] = {"id": log.ids[actor], "is_ego": actor == 0, "moves": ""}
        if moves and len(rows) == len(log.stamps_ns) and ((way > low) & (way < high)).all(axis=1).any():
            about["moves"] = ";".join(points(_rectangle(log, row, actor)) for row in rows.tolist())
        actors.append({**about, "way": points(way), "box": points(box)})
    collisions = []
    for collision in find_collisions(log):
        row = int(np.searchsorted(log.stamps_ns, collision.stamp_ns).clip(0, len(ego) - 1))
        x, y = ego[row]
        collisions.append((f"{x - low[0]:.2f}", f"{high[1] - y:.2f}"))
    size = (f"{width:.2f}", f"{height:.2f}")
    return render_part(
        "mirror.evaluation", "plan.html", "plan", *size, area, actors, collisions, f"{log.times_s[-1]:g}"
    )


def _rectangle(log: StateLog, row: int, actor: int) -> Float64:
    yaw, length, width = log.yaw_rad[row, actor], log.length_m[actor], log.width_m[actor]
    ahead = 0.5 * length * np.array([np.cos(yaw), np.sin(yaw)])
    left = 0.5 * width * np.array([-np.sin(yaw), np.cos(yaw)])
    middle = np.array([log.x_m[row, actor], log.y_m[row, actor]])
    return np.array([middle + ahead + left, middle + ahead - left, middle - ahead - left, middle - ahead + left])
