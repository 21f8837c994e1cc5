"""The page of a drive: its video, curves that follow the video's time, its events and the figures of its safety.

It is one HTML file without network access. Its one script moves the marks of the curves; a policy with its hash allows
no other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from mirror.evaluation.drive_curves import DriveCurve
from mirror.metrics.catalogue import MEASURES
from mirror.metrics.safety.report import SafetyFigure, SafetyReport
from mirror.pages.images import inline_video
from mirror.pages.rendering import content_policy, read_script, render_page, script_data
from mirror.schema.files import write_bytes
from mirror.schema.scenario import Scenario

if TYPE_CHECKING:
    from mirror.arrays import Float64

PAGE_FILE: Final = "report.html"
_PACKAGE: Final = "hybridworldsim.simulator.rollout"
_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM = 560, 150, 46, 10, 20, 24
_TICKS: Final = 4
_SECONDS: Final = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, math.inf)
_FIRST_EVENTS: Final = {
    "least_ttc": "least time to collision",
    "drivable_margin": "least margin to the road's edge",
    "off_road": "off the drivable area",
    "wrong_lane": "in a lane of the other direction",
    "comfort": "beyond a bound of comfort",
}
"""Figures whose stamp is an event, in words."""
_BAD: Final = ("off_road", "wrong_lane")


@dataclass(frozen=True, eq=False)
class DrivePageContent:
    """The content of the page of a drive.

    Attributes:
        scenario: the scenario.
        policy: name of the policy.
        world: name of the renderer.
        lines: how it ended, in words.
        safety: its figures.
        stamps_ns: stamps of the T states.
        curves: quantities at the states.
        video: the video, with an image for each state; None: there is none.
    """

    scenario: Scenario
    policy: str
    world: str
    lines: Sequence[str]
    safety: SafetyReport
    stamps_ns: Sequence[int]
    curves: Sequence[DriveCurve]
    video: Path | None


@dataclass(frozen=True)
class Event:
    """An event of a drive.

    Attributes:
        time_s: seconds since the first state.
        words: what happened, and who caused it.
        kind: ``bad`` for a collision, a red light or a way off the lanes; else ``note``.
    """

    time_s: float
    words: str
    kind: str


def write_page(path: Path, content: DrivePageContent) -> None:
    """Write the page of a drive.

    Args:
        path: the page.
        content: what it shows.

    Raises:
        DatasetError: the page cannot be written.
    """
    start_ns = content.stamps_ns[0]
    times = np.array([1e-9 * (stamp_ns - start_ns) for stamp_ns in content.stamps_ns])
    events = list_events(content.safety, start_ns)
    script = read_script(_PACKAGE, "drive.js")
    data = {
        "times": [round(time, 6) for time in times.tolist()],
        "left": _LEFT,
        "right": _WIDTH - _RIGHT,
        "curves": [
            {"unit": curve.unit, "digits": curve.digits, "values": _encode(curve.values)} for curve in content.curves
        ],
    }
    page = render_page(
        _PACKAGE,
        "drive.html",
        title=f"{content.scenario.name}, driven by {content.policy}",
        policy=content_policy(script, images="data:", media="data:"),
        script=script,
        description=content.scenario.description,
        world=content.world,
        lines=content.lines,
        video=None if content.video is None else inline_video(content.video),
        data=script_data(data),
        charts=[_draw_curve(curve, times, events) for curve in content.curves],
        events=[
            {"number": number, "time": f"{event.time_s:.2f} s", "at": f"{event.time_s:.3f}", "event": event}
            for number, event in enumerate(events, 1)
        ],
        rows=[_describe_figure(figure, start_ns) for figure in content.safety.figures.values()],
    )
    write_bytes(path, page.encode())


def list_events(safety: SafetyReport, start_ns: int) -> list[Event]:
    """List the events of a drive in the order of their times.

    Args:
        safety: its safety.
        start_ns: stamp of the first state.
    """
    events = []
    for collision in safety.collisions:
        fault = {True: ", caused by the ego", False: ", not caused by the ego", None: ""}[collision.is_at_fault]
        words = (
            f"collision with {collision.agent} ({collision.category}) at {collision.impact_speed_mps:.1f} m/s{fault}"
        )
        events.append(Event(1e-9 * (collision.stamp_ns - start_ns), words, "bad"))
    for light in safety.red_lights:
        events.append(Event(1e-9 * (light.stamp_ns - start_ns), f"stop line of {light.signal} passed at red", "bad"))
    for name, words in _FIRST_EVENTS.items():
        figure = safety.figures[name]
        if figure.stamp_ns is not None:
            cause = f", {figure.cause}" if name == "least_ttc" and figure.cause else ""
            shown = f": {_format(figure)}{cause}" if name in ("least_ttc", "drivable_margin") else ""
            kind = "bad" if name in _BAD else "note"
            events.append(Event(1e-9 * (figure.stamp_ns - start_ns), f"{words}{shown}", kind))
    return sorted(events, key=lambda event: event.time_s)


def _describe_figure(figure: SafetyFigure, start_ns: int) -> dict[str, object]:
    """Describe a figure by the catalogue, in which boards and papers find their names."""
    measure = MEASURES[figure.name]
    at = "" if figure.stamp_ns is None else f"{1e-9 * (figure.stamp_ns - start_ns):.2f} s"
    return {"measure": measure, "value": _format(figure), "note": figure.reason or figure.cause or "", "at": at}


def _format(figure: SafetyFigure) -> str:
    if math.isnan(figure.value):
        return ""
    unit = MEASURES[figure.name].unit
    return "none" if math.isinf(figure.value) else f"{figure.value:.4g} {unit}".strip()


def _encode(values: Float64) -> list[float | None]:
    return [round(value, 4) if math.isfinite(value) else None for value in values.tolist()]


def _draw_curve(curve: DriveCurve, times: Float64, events: Sequence[Event]) -> dict[str, object]:
    """Place the parts of a chart in its box; a curve without any value has no parts."""
    drawn = {"title": curve.title, "unit": curve.unit, "about": curve.about, "width": _WIDTH, "height": _HEIGHT}
    finite = np.isfinite(curve.values)
    if not finite.any():
        return {**drawn, "paths": None}
    ticks = _round_ticks(float(curve.values[finite].min()), float(curve.values[finite].max()))
    low, high, last = ticks[0], ticks[-1], max(float(times[-1]), 1e-9)

    def across(time_s: float) -> str:
        return f"{_LEFT + min(time_s / last, 1.0) * (_WIDTH - _LEFT - _RIGHT):.1f}"

    def up(value: float) -> str:
        return f"{_HEIGHT - _BOTTOM - (value - low) / (high - low) * (_HEIGHT - _TOP - _BOTTOM):.1f}"

    parts = np.split(np.arange(len(times)), np.flatnonzero(np.diff(finite)) + 1)
    points = [f"{across(time)} {up(value)}" for time, value in zip(times.tolist(), curve.values.tolist())]
    step = next(size for size in _SECONDS if last / size <= 8)
    seconds = [number * step for number in range(int(last / step + 1e-9) + 1)]
    return {
        **drawn,
        "paths": ["M" + "L".join(points[row] for row in part) for part in parts if finite[part[0]]],
        "top": _TOP,
        "bottom": _HEIGHT - _BOTTOM,
        "left": _LEFT,
        "right": _WIDTH - _RIGHT,
        "levels": [{"y": up(tick), "text": f"{tick:g}"} for tick in ticks],
        "seconds": [{"x": across(second), "text": f"{second:g}"} for second in seconds],
        "events": [
            {"x": across(event.time_s), "number": number, "event": event} for number, event in enumerate(events, 1)
        ],
    }


def _round_ticks(low: float, high: float) -> list[float]:
    """Return three to six round levels that enclose an interval."""
    span = max(high - low, 0.05 * max(abs(low), abs(high)), 0.1)
    rough = span / (_TICKS - 1)
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough * (1 - 1e-9))
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [round(number * step, 10) for number in range(first, max(last, first + 1) + 1)]
