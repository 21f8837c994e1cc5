"""The report of rollouts: figures with intervals, the worst rollouts from above, and a table of all of them.

It is a single HTML file without scripts or network access, as that of renders.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.evaluation.report_tables import Footnotes, breakdown_tables, metrics_list, summary_table
from mirror.evaluation.rollouts import RolloutEvaluation
from mirror.evaluation.scorers.safety import ScoredRollout
from mirror.html import html_table, style_sheet
from mirror.metrics.catalogue import MEASURES
from mirror.metrics.safety import StateLog, find_collisions, read_state_log
from mirror.schema.files import write_bytes
from mirror.schema.road_map import RoadMap, read_road_map
from mirror.schema.rollout import MAP_FILE, STATES_FILE
from mirror.version import __version__

_SHOWN: Final = 4
_RANKED_BY: Final = "epdms"
_BESIDE_M: Final = 12.0
_MOST: Final = 500
_COLUMNS: Final = ("collisions", "at_fault_collisions", "least_ttc", "drivable_margin", "off_road", "epdms")
_STYLE: Final = (
    "svg{width:100%;height:auto;max-height:26rem;background:#dfe4dc}.plans{display:grid;gap:1rem;"
    "grid-template-columns:repeat(auto-fit,minmax(20rem,1fr))}figure{margin:0}figcaption{font-size:.9em}"
)


def write_rollout_report(done: RolloutEvaluation, folder: Path, out: Path) -> None:
    """Write the report of an evaluation of rollouts.

    Args:
        done: the evaluation.
        folder: the evaluated folder.
        out: HTML file; it is replaced atomically.

    Raises:
        DatasetError: a rollout cannot be read, or the file cannot be written.
    """
    result = done.result
    title = f"{result.submission.method.name}: {result.protocol.name}"
    notes = Footnotes()
    parts = [
        f"<header><h1>{escape(title)}</h1>{_format_header(done)}</header>",
        "<h2>Figures</h2><p>Means over the rollouts of a scenario, then over the scenarios.</p>",
        summary_table(result, (), notes),
        "<h2>Worst rollouts</h2>",
        _format_worst(done.scored, folder),
        "<h2>Rollouts</h2>",
        _format_rollouts(done.scored),
        # The protocol's traversals are the scenarios of the rollouts.
        *breakdown_tables(result, notes, {"traversal": "By scenario"}),
        notes.format(),
        "<h2>Metrics</h2>",
        metrics_list(result),
        f"<footer>Made by mirror {__version__}; protocol {result.protocol_hash[:12]}, "
        f"result {result.hash[:12]}.</footer>",
    ]
    style = style_sheet() + files("mirror.evaluation").joinpath("report.css").read_text() + _STYLE
    page = (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<style>{style}</style></head><body><main>{''.join(parts)}</main></body></html>\n"
    )
    write_bytes(out, page.encode())


def _format_header(done: RolloutEvaluation) -> str:
    scored, result = done.scored, done.result
    scenarios = {one.rollout.scenario for one in scored}
    tiles = [
        (f"{len(scored)}", f"rollouts of {len(scenarios)} scenarios in the world {scored[0].rollout.world}"),
        (f"{sum(bool(one.values.get('collisions')) for one in scored)}", "with a collision"),
        (f"{sum((one.values.get('drivable_area') == 0.0) for one in scored)}", "off the drivable area"),
    ]
    boxes = "".join(f'<div class="tile"><b>{value}</b><span>{escape(words)}</span></div>' for value, words in tiles)
    warnings = "".join(f'<p class="dim">{escape(warning)}</p>' for warning in result.warnings)
    return f'<div class="tiles">{boxes}</div>{warnings}'


def _rank(scored: Sequence[ScoredRollout]) -> list[ScoredRollout]:
    """The worst first: by EPDMS, then by the least time to collision."""

    def key(one: ScoredRollout) -> tuple[float, float, str]:
        score, least = one.values.get(_RANKED_BY), one.values.get("least_ttc")
        return (math.inf if score is None else float(score), math.inf if least is None else float(least), one.path)

    return sorted(scored, key=key)


def _format_rollouts(scored: Sequence[ScoredRollout]) -> str:
    rows = []
    for one in _rank(scored)[:_MOST]:
        values = []
        for name in _COLUMNS:
            value, cause = one.values.get(name), one.causes.get(name)
            text = one.reasons.get(name, "none") if value is None else f"{value:.3g}"
            values.append(escape(text) + (f"<small>{escape(cause)}</small>" if value and cause else ""))
        rows.append(
            [escape(one.rollout.scenario), str(one.rollout.seed), one.rollout.ending.replace("_", " "), *values]
        )
    left = len(scored) - len(rows)
    more = f"<p>{left} better rollouts are not listed.</p>" if left else ""
    return html_table(["scenario", "n:seed", "ended by", *(f"n:{name}" for name in _COLUMNS)], rows) + more


def _format_worst(scored: Sequence[ScoredRollout], folder: Path) -> str:
    plans = []
    for one in _rank(scored)[:_SHOWN]:
        run = folder / one.path
        plan = draw_plan(read_state_log(run / STATES_FILE), read_road_map(run / MAP_FILE))
        score, measure = one.values.get(_RANKED_BY), MEASURES[_RANKED_BY]
        shown = "none" if score is None else f"{score:.2f}"
        words = f"{one.rollout.scenario}, seed {one.rollout.seed}: {measure.title} {shown}"
        plans.append(f"<figure>{plan}<figcaption>{escape(words)}</figcaption></figure>")
    legend = (
        "<p>From above: the drivable area grey, the ego's way blue with its box at the end, the ways of other road "
        "users orange, collisions red.</p>"
    )
    return f'{legend}<div class="plans">{"".join(plans)}</div>'


def draw_plan(log: StateLog, road_map: RoadMap) -> str:
    """Draw a rollout from above as SVG: the drivable area, the ways of all actors, their last boxes and collisions."""
    ego = np.column_stack([log.x_m[:, 0], log.y_m[:, 0]])
    low, high = ego.min(axis=0) - _BESIDE_M, ego.max(axis=0) + _BESIDE_M
    width, height = (high - low).tolist()

    def points(line: Float64) -> str:
        return " ".join(f"{x - low[0]:.2f},{high[1] - y:.2f}" for x, y in line.tolist())

    rings = [np.asarray(ring)[:, :2] for ring in road_map.drivable_rings]
    area = " ".join("M" + points(ring).replace(" ", " L") + "Z" for ring in rings)
    parts = [f'<path d="{area}" fill="#9aa09a" fill-rule="evenodd"/>']
    for actor in reversed(range(len(log.ids))):
        rows = np.flatnonzero(log.present[:, actor])
        if not len(rows):
            continue
        colour = "#1f5fbf" if actor == 0 else "#d9822b"
        way = np.column_stack([log.x_m[rows, actor], log.y_m[rows, actor]])
        last = _rectangle(log, int(rows[-1]), actor)
        parts.append(
            f'<polyline points="{points(way)}" fill="none" stroke="{colour}" stroke-width="0.5"/>'
            f'<polygon points="{points(last)}" fill="{colour}"><title>{escape(log.ids[actor])}</title></polygon>'
        )
    for collision in find_collisions(log):
        row = int(np.searchsorted(log.stamps_ns, collision.stamp_ns).clip(0, len(ego) - 1))
        x, y = ego[row]
        ring = 'r="2.5" fill="none" stroke="#c00" stroke-width="0.7"'
        parts.append(f'<circle cx="{x - low[0]:.2f}" cy="{high[1] - y:.2f}" {ring}/>')
    return f'<svg viewBox="0 0 {width:.2f} {height:.2f}" role="img" aria-label="from above">{"".join(parts)}</svg>'


def _rectangle(log: StateLog, row: int, actor: int) -> Float64:
    yaw, length, width = log.yaw_rad[row, actor], log.length_m[actor], log.width_m[actor]
    ahead = 0.5 * length * np.array([np.cos(yaw), np.sin(yaw)])
    left = 0.5 * width * np.array([-np.sin(yaw), np.cos(yaw)])
    middle = np.array([log.x_m[row, actor], log.y_m[row, actor]])
    return np.array([middle + ahead + left, middle + ahead - left, middle - ahead - left, middle - ahead + left])
