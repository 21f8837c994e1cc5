"""A page of a rollout: its video, and the figures of its safety. One HTML file without scripts or network access."""

from __future__ import annotations

import base64
import math
from html import escape
from pathlib import Path
from typing import Final

from mirror.html import html_table, style_sheet
from mirror.metrics.safety.report import FIGURES, SafetyReport
from mirror.schema.files import write_bytes
from mirror.schema.scenario import Scenario

PAGE_FILE: Final = "report.html"
_HEAD: Final = ("figure", "n:value", "unit", "better", "caused by", "n:at")


def write_page(
    path: Path,
    scenario: Scenario,
    policy: str,
    world: str,
    lines: list[str],
    safety: SafetyReport,
    start_ns: int,
    video: Path | None,
) -> None:
    """Write the page of a rollout.

    Args:
        path: the page.
        scenario: the scenario.
        policy: name of the policy.
        world: name of the renderer.
        lines: how it ended, in words.
        safety: the figures.
        start_ns: stamp of the first state.
        video: the video; None: there is none.

    Raises:
        DatasetError: the page cannot be written.
    """  # fmt: skip
    title = f"{scenario.name}, driven by {policy}"
    shown = "" if video is None else _inline_video(video)
    rows = []
    for name, figure in safety.figures.items():
        unit, better = FIGURES[name]
        value = "" if math.isnan(figure.value) else f"{figure.value:.4g}"
        at = "" if figure.stamp_ns is None else f"{1e-9 * (figure.stamp_ns - start_ns):.2f} s"
        reason = figure.reason or figure.cause or ""
        rows.append([escape(name), value, escape(unit), better, escape(reason), at])
    page = (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<style>{style_sheet()}video{{max-width:100%}}</style></head><body><header><h1>{escape(title)}</h1>"
        f"<p>{escape(scenario.description)} World: {escape(world)}.</p></header>"
        f"<p>{'<br>'.join(escape(line) for line in lines)}</p>{shown}<h2>Safety</h2>{html_table(_HEAD, rows)}"
        "</body></html>\n"
    )
    write_bytes(path, page.encode())


def _inline_video(path: Path) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<video controls autoplay muted loop src="data:video/mp4;base64,{data}"></video>'
