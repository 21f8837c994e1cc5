"""The report page of a calibration check: verdict, histogram, estimates, stages, validity in time, drift."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from mirror.arrays import Float64
from mirror.calibration.check import CalibrationCheck, CameraCheck, TraversalCheck
from mirror.calibration.estimate import AXES, OBSERVABLE_DEG
from mirror.calibration.localisation import PAPER_PERCENT
from mirror.calibration.stages import JUMP_CM, JUMP_DEG, StageDifference
from mirror.calibration.statistics import LIMIT_DEG, FleetStatistics
from mirror.counting import count_of
from mirror.pages.rendering import render_page, render_part
from mirror.schema.files import write_bytes

if TYPE_CHECKING:
    from markupsafe import Markup

_WIDTH, _HEIGHT, _LEFT, _BOTTOM = 420, 170, 34, 24
_BINS: Final = 24


@dataclass(frozen=True)
class _Shape:
    """A part of a chart, at strings that are numbers; ``kind`` is a CSS class."""

    shape: Literal["bar", "line", "dot", "text"]
    x: str
    y: str
    kind: str = ""
    title: str = ""
    x_to: str = ""
    y_to: str = ""
    width: str = ""
    height: str = ""
    text: str = ""
    anchor: str = ""


def write_calibration_page(check: CalibrationCheck, out: Path) -> None:
    """Write the page as one HTML file without script or network access.

    Args:
        check: the check.
        out: the file; replaced as a whole.
    """
    headline, why = _verdict(check.statistics)
    page = render_page(
        "mirror.view",
        "calibration.html",
        title="Calibration check",
        headline=headline,
        why=why,
        tiles=_tiles(check.statistics),
        charts=_charts(check),
        cameras=_camera_rows(check),
        observable_deg=OBSERVABLE_DEG,
        axis_names=list(AXES),
        axes=_axes_rows(check),
        traversals=check.traversals,
        stages=_stage_rows(check.history.between_stages),
        jump_deg=JUMP_DEG,
        jump_cm=JUMP_CM,
        validity=_validity(check),
        drift=_drift(check.traversals),
        dataset=check.dataset,
    )
    write_bytes(out, page.encode())


def _known(check: CalibrationCheck) -> list[tuple[TraversalCheck, CameraCheck]]:
    return [(item, one) for item in check.traversals for one in item.cameras if one.angle_deg is not None]


def _verdict(found: FleetStatistics) -> tuple[str, str]:
    """Return the verdict and its reason."""
    why = {
        "pass": f"at least 99.7 % of the traversals are below {LIMIT_DEG:g} degrees",
        "fail": f"fewer than 99.7 % of the traversals are below {LIMIT_DEG:g} degrees",
        "too few": f"too few traversals for a verdict on the fleet: a pass needs {found.needed} without a failure",
    }[found.verdict]
    headline: str = found.verdict
    if not found.samples:
        headline, why = "not checked", f"no camera could be checked: the tables below give the reasons; {why}"
    elif found.verdict == "too few":
        headline = f"{found.samples_below} of {count_of(found.samples, 'traversal')} below {LIMIT_DEG:g} degrees"
    return headline, why


def _tiles(found: FleetStatistics) -> list[tuple[str, str]]:
    return [
        (f"{found.samples_below} of {found.samples}", "traversals below 0.3 deg"),
        (f"{found.share_lower:.1%} to {found.share_upper:.1%}", "bounds of that share"),
        (f"{found.cameras_below} of {found.cameras}", "cameras below 0.3 deg"),
        (_number(found.median_deg), "median error (deg)"),
        (_number(found.robust_quantile_deg), "99.7 % quantile, robust (deg)"),
        (_number(found.empirical_quantile_deg), "99.7 % quantile, empirical (deg)"),
        (_number(found.corrected_rms_deg), "rms without noise of the estimate (deg)"),
        (f"{found.vehicles}", "vehicles"),
    ]


def _charts(check: CalibrationCheck) -> list[Markup]:
    """Draw the charts of the errors; none without an estimate."""
    values = np.array([one.angle_deg for _, one in _known(check)], np.float64)
    return [_histogram(values), _over_days(check.traversals)] if len(values) else []


def _histogram(values: Float64) -> Markup:
    """Draw a histogram of errors (at least one), in degrees, with the limit as a line."""
    top = max(2.0 * LIMIT_DEG, float(values.max()) * 1.05)
    # The limit is an edge of bins, so that no bar has errors of both sides.
    step = LIMIT_DEG / max(round(_BINS * LIMIT_DEG / top), 1)
    edges = step * np.arange(np.ceil(top / step) + 1)
    top, counts = float(edges[-1]), np.histogram(values, bins=edges)[0]
    most, width = int(counts.max()), (_WIDTH - _LEFT) / len(counts)
    bars = []
    for number, count in enumerate(counts.tolist()):
        height = (_HEIGHT - _BOTTOM - 10) * count / most
        kind = "over" if edges[number] >= LIMIT_DEG - 1e-9 else "hist"
        bars.append(
            _Shape(
                "bar",
                f"{_LEFT + number * width:.1f}",
                f"{_HEIGHT - _BOTTOM - height:.1f}",
                kind,
                title=f"{count}",
                width=f"{width - 1.0:.1f}",
                height=f"{height:.1f}",
            )
        )
    at = _LEFT + (_WIDTH - _LEFT) * LIMIT_DEG / top
    limit = _Shape("line", f"{at:.1f}", "0", "limit", x_to=f"{at:.1f}", y_to=f"{_HEIGHT - _BOTTOM}")
    name = _Shape("text", f"{at + 4:.1f}", "12", text=f"{LIMIT_DEG:g} deg")
    title = f"Errors of {len(values)} cameras (degrees; tallest bar: {most})"
    return _draw(title, [*bars, limit, name, *_axis_labels(np.linspace(0.0, top, 5), top)])


def _over_days(traversals: Sequence[TraversalCheck]) -> Markup:
    """Draw the largest and the median error of each traversal over the days; at least one has an estimate."""
    points = [
        (item.entry_ns * 1e-9, [one.angle_deg for one in item.cameras if one.angle_deg is not None])
        for item in traversals
    ]
    points = [(second, angles) for second, angles in points if angles]
    seconds = np.array([second for second, _ in points])
    span = max(float(np.ptp(seconds)), 1.0)
    top = max(2.0 * LIMIT_DEG, max(max(angles) for _, angles in points) * 1.05)
    drawn = []
    for second, angles in points:
        x = _LEFT + 8 + (_WIDTH - _LEFT - 16) * (second - seconds.min()) / span
        low, high = (_y(value, top) for value in (float(np.median(angles)), max(angles)))
        day = datetime.fromtimestamp(second, UTC).date().isoformat()
        drawn += [
            _Shape("line", f"{x:.1f}", f"{low:.1f}", "axis", x_to=f"{x:.1f}", y_to=f"{high:.1f}"),
            _Shape("dot", f"{x:.1f}", f"{low:.1f}", "hist", title=day),
        ]
    limit = _y(LIMIT_DEG, top)
    first, last = (datetime.fromtimestamp(value, UTC).date().isoformat() for value in (seconds.min(), seconds.max()))
    drawn += [
        _Shape("line", f"{_LEFT}", f"{limit:.1f}", "limit", x_to=f"{_WIDTH}", y_to=f"{limit:.1f}"),
        _Shape("text", f"{_LEFT}", f"{_HEIGHT - 6}", text=first),
        _Shape("text", f"{_WIDTH}", f"{_HEIGHT - 6}", text=last, anchor="end"),
        _Shape("text", "2", f"{limit + 4:.1f}", text=f"{LIMIT_DEG:g}"),
        _Shape("text", "2", "12", text=f"{top:.2f}"),
    ]
    return _draw("Errors over the days: median (dot) and largest (line end) of each traversal", drawn)


def _y(value: float, top: float) -> float:
    return (_HEIGHT - _BOTTOM) * (1.0 - value / top)


def _axis_labels(values: Iterable[float], top: float) -> list[_Shape]:
    y = f"{_HEIGHT - 8}"
    return [
        _Shape("text", f"{_LEFT + (_WIDTH - _LEFT) * value / top:.1f}", y, text=f"{value:.2f}", anchor="middle")
        for value in values
    ]


def _draw(title: str, shapes: Sequence[_Shape], height: int = _HEIGHT) -> Markup:
    return render_part("mirror.view", "calibration_charts.html", "chart", title, _WIDTH + 12, height, shapes)


def _camera_rows(check: CalibrationCheck) -> list[list[str]]:
    rows = []
    for item in check.traversals:
        for one in item.cameras:
            axes = [
                f"{error:+.3f} ± {sigma:.3f}" if known else f"(± {sigma:.2f})"
                for error, sigma, known in zip(one.error_deg, one.sigma_deg, one.observable)
            ]
            angle = "--" if one.angle_deg is None else f"{one.angle_deg:.3f}"
            rows.append(
                [item.traversal_id, one.camera, one.stage, angle, one.status, *axes,
                 f"{one.focal_error_percent:+.2f} ± {one.focal_sigma_percent:.2f}", f"{one.tracks:,}"]
            )  # fmt: skip
    return rows


def _axes_rows(check: CalibrationCheck) -> list[dict[str, Any]]:
    rows = []
    for item in check.traversals:
        for one in item.cameras:
            turned = f"turned {item.turned_deg:.0f} degrees over {item.driven_m:.0f} m, {one.tracks:,} tracks"
            axes = list(zip(one.observable, one.sigma_deg, one.source, one.source_share))
            why = one.reason or turned
            rows.append({"traversal_id": item.traversal_id, "camera": one.camera, "axes": axes, "why": why})
    return rows


def _stage_rows(differences: Sequence[StageDifference]) -> list[list[str]]:
    return [
        [one.vehicle_id, one.drive_id, one.camera, f"{one.first} to {one.second}", f"{one.angle_deg:.3f}",
         *(f"{axis:+.3f}" for axis in one.axes_deg), f"{one.distance_cm:.1f}"]
        for one in differences
    ]  # fmt: skip


def _validity(check: CalibrationCheck) -> Markup | None:
    """Draw validity intervals as bars, one line for each vehicle, camera and stage; jumps as red lines."""
    if not check.history.rows:
        return None
    times = [item.entry_ns for item in check.traversals]
    rows = check.history.rows
    times += [row[name] for row in rows for name in ("valid_from_ns", "valid_to_ns") if row[name] is not None]
    first, last = min(times), max(max(times), min(times) + 1)
    lines: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        lines.setdefault((row["vehicle_id"], row["camera"], row["stage"]), []).append(row)
    drawn = []

    def place(at: int | None, default: float) -> float:
        return default if at is None else 180.0 + (_WIDTH - 180.0) * (at - first) / (last - first)

    for number, ((vehicle, camera, stage), own) in enumerate(lines.items()):
        y = 14 * number + 4
        drawn.append(_Shape("text", "0", f"{y + 9}", text=f"{vehicle[-12:]} {camera} {stage}"))
        for row in own:
            start, end = place(row["valid_from_ns"], 180.0), place(row["valid_to_ns"], float(_WIDTH))
            width = f"{max(end - start, 1.0):.1f}"
            drawn.append(_Shape("bar", f"{start:.1f}", f"{y}", f"interval {stage}", width=width, height="9"))
        for jump in check.history.in_time:
            if jump.is_jump and (jump.vehicle_id, jump.camera, jump.second) == (vehicle, camera, stage):
                x = f"{place(jump.at_ns, 180.0):.1f}"
                about = f"{jump.angle_deg:.3f} degrees, {jump.distance_cm:.1f} cm"
                drawn.append(_Shape("line", x, f"{y - 2}", "jump", title=about, x_to=x, y_to=f"{y + 11}"))
    low = 14 * len(lines) + 14
    days = (datetime.fromtimestamp(at * 1e-9, UTC).date().isoformat() for at in (first, last))
    drawn += [
        _Shape("text", f"{x}", f"{low}", text=day, anchor=anchor)
        for x, anchor, day in zip((180, _WIDTH), ("start", "end"), days)
    ]
    jumps = [one for one in check.history.in_time if one.is_jump]
    return _draw(f"{len(rows)} calibrations, {len(jumps)} jumps", drawn, low + 6)


def _drift(traversals: Sequence[TraversalCheck]) -> dict[str, Any]:
    """Return the median drift over each length, as heads and rows of a table."""
    lengths = list(dict.fromkeys(length for one in traversals for length in one.drift_percent))
    rows = [[one.traversal_id, *(_percent(one.drift_percent.get(length)) for length in lengths)] for one in traversals]
    return {"lengths": [f"n:{one} m" for one in lengths], "rows": rows, "paper_percent": PAPER_PERCENT}


def _percent(value: float | None) -> str:
    return "--" if value is None else f"{value:.3f}"


def _number(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else "--"
