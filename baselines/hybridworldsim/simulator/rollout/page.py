"""A page of a rollout: its video, and the figures of its safety. One HTML file without scripts or network access."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

from mirror.metrics.safety.report import FIGURES, SafetyReport
from mirror.pages.images import inline_video
from mirror.pages.rendering import render_page
from mirror.schema.files import write_bytes
from mirror.schema.scenario import Scenario

PAGE_FILE: Final = "report.html"


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
    rows = []
    for name, figure in safety.figures.items():
        unit, better = FIGURES[name]
        value = "" if math.isnan(figure.value) else f"{figure.value:.4g}"
        at = "" if figure.stamp_ns is None else f"{1e-9 * (figure.stamp_ns - start_ns):.2f} s"
        rows.append([name, value, unit, better, figure.reason or figure.cause or "", at])
    page = render_page(
        "hybridworldsim.simulator.rollout",
        "drive.html",
        title=f"{scenario.name}, driven by {policy}",
        description=scenario.description,
        world=world,
        lines=lines,
        video=None if video is None else inline_video(video),
        rows=rows,
    )
    write_bytes(path, page.encode())
