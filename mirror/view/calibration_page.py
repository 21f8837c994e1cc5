"""The report page of a calibration check: verdict, histogram, estimates, stages, validity in time, drift."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np

from mirror.arrays import Float64
from mirror.calibration.check import CalibrationCheck, CameraCheck, TraversalCheck
from mirror.calibration.estimate import AXES, OBSERVABLE_DEG
from mirror.calibration.localisation import PAPER_PERCENT
from mirror.calibration.stages import JUMP_CM, JUMP_DEG, StageDifference
from mirror.calibration.statistics import LIMIT_DEG, FleetStatistics
from mirror.counting import count_of
from mirror.html import html_table, style_sheet
from mirror.schema.files import write_bytes
from mirror.version import __version__

_WIDTH, _HEIGHT, _LEFT, _BOTTOM = 420, 170, 34, 24
_LARGEST_PX: Final = 640
_BINS: Final = 24
_COLOURS: Final = {"factory": "#8a8a8a", "online": "#4c78a8", "refined": "#54a24b"}
_CONFUSED: Final = (
    "In a bend some other errors look like a rotation of the camera, most of all like yaw: a focal length or a length "
    "of the recorded way that is wrong by a share of a percent, drift of the recorded positions, and the position of "
    "the camera on the vehicle. They are unknowns with priors, so their uncertainty is a part of each figure; the "
    "table of axes states the largest source of it. An error of the clock between poses and images, of the principal "
    "point or of the distortion is not an unknown: it is counted as a rotation."
)
_CSS: Final = (
    ".limit{stroke:#c0392b;stroke-width:1.5;stroke-dasharray:4 3}.axis{stroke:currentColor;opacity:.4}"
    ".hist{fill:#4c78a8}.over{fill:#c0392b}.verdict{font-size:1.4rem;font-weight:700}"
    "svg text{font-size:11px;fill:currentColor}"
    ".whole{white-space:normal;min-width:17em;max-width:40em;overflow-wrap:break-word}"
    "td:first-child{white-space:normal;overflow-wrap:anywhere;min-width:11em}"
)


def write_calibration_page(check: CalibrationCheck, out: Path) -> None:
    """Write the page: one HTML file without script or network.

    Args:
        check: the check.
        out: the file; replaced as a whole.
    """
    parts = [
        f"<header><h1>Calibration check</h1>{_verdict(check.statistics)}</header>",
        '<p class="dim">An error is the angle between a delivered mounting and its estimate from images, for one '
        "camera in one traversal, over the observable axes. The verdict counts traversals: one is good if all its "
        "cameras are below the limit. The bounds are Clopper and Pearson's, one-sided, 95 %.</p>",
        _charts(check),
        "<h2>Errors by camera</h2>",
        '<p class="dim">About each axis the error and its standard deviation. In brackets: the axis is unobservable, '
        "because its standard deviation is above 0.1 degrees.</p>",
        _camera_table(check),
        "<h2>Which axes were observable, and why</h2>",
        '<p class="dim">The standard deviation of the error about each axis, in degrees, and the largest source of it '
        f"with its share of the variance. An axis is observable up to {OBSERVABLE_DEG:g} degrees. Turning shows roll, "
        "driving ahead shows pitch and yaw; tracks of points show all of them.</p>",
        _axes_table(check),
        f'<p class="dim">{_CONFUSED}</p>',
        "<h2>Traversals</h2>",
        _traversal_table(check.traversals),
        "<h2>Stages beside each other</h2>",
        _stage_table(check.history.between_stages),
        "<h2>Validity and jumps in time</h2>",
        '<p class="dim">Each bar is a validity interval (grey: factory, blue: online, green: refined); a red line is a '
        f"jump above {JUMP_DEG:g} degrees or {JUMP_CM:g} cm within one stage.</p>",
        _validity(check),
        "<h2>Localisation drift</h2>",
        _drift(check.traversals),
        f"<footer>Made by mirror {__version__} from the dataset {escape(check.dataset)}.</footer>",
    ]
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Calibration check</title>'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<style>{style_sheet()}{_CSS}</style></head><body><main>{''.join(parts)}</main></body></html>\n"
    )
    write_bytes(out, page.encode())


def _known(check: CalibrationCheck) -> list[tuple[TraversalCheck, CameraCheck]]:
    return [(item, one) for item in check.traversals for one in item.cameras if one.angle_deg is not None]


def _verdict(found: FleetStatistics) -> str:
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
    tiles = {
        "traversals below 0.3 deg": f"{found.samples_below} of {found.samples}",
        "bounds of that share": f"{found.share_lower:.1%} to {found.share_upper:.1%}",
        "cameras below 0.3 deg": f"{found.cameras_below} of {found.cameras}",
        "median error (deg)": _number(found.median_deg),
        "99.7 % quantile, robust (deg)": _number(found.robust_quantile_deg),
        "99.7 % quantile, empirical (deg)": _number(found.empirical_quantile_deg),
        "rms without noise of the estimate (deg)": _number(found.corrected_rms_deg),
        "vehicles": f"{found.vehicles}",
    }
    cells = "".join(f'<div class="tile"><b>{value}</b><span>{name}</span></div>' for name, value in tiles.items())
    return f'<p class="verdict">{headline}</p><p>{why}</p><div class="tiles">{cells}</div>'


def _charts(check: CalibrationCheck) -> str:
    """The charts of the errors; a sentence if there is none."""
    values = np.array([one.angle_deg for _, one in _known(check)], np.float64)
    if not len(values):
        return '<p class="dim">No chart of errors: no camera has an estimate.</p>'
    return f'<div class="grid two">{_histogram(values)}{_over_days(check.traversals)}</div>'


def _histogram(values: Float64) -> str:
    """A histogram of errors (at least one), in degrees, with the limit as a line."""
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
            f'<rect class="{kind}" x="{_LEFT + number * width:.1f}" y="{_HEIGHT - _BOTTOM - height:.1f}"'
            f' width="{width - 1.0:.1f}" height="{height:.1f}"><title>{count}</title></rect>'
        )
    at = _LEFT + (_WIDTH - _LEFT) * LIMIT_DEG / top
    labels = _axis_labels(np.linspace(0.0, top, 5), top, "{:.2f}")
    drawing = "".join(bars) + _vertical(at) + f'<text x="{at + 4:.1f}" y="12">{LIMIT_DEG:g} deg</text>' + labels
    return _figure(f"Errors of {len(values)} cameras (degrees; tallest bar: {most})", drawing)


def _over_days(traversals: Sequence[TraversalCheck]) -> str:
    """The largest and the median error of each traversal over the days of the fleet; at least one has an estimate."""
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
        drawn.append(
            f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{low:.1f}" y2="{high:.1f}" class="axis"/>'
            f'<circle cx="{x:.1f}" cy="{low:.1f}" r="3" class="hist"><title>{day}</title></circle>'
        )
    limit = _y(LIMIT_DEG, top)
    drawn.append(f'<line x1="{_LEFT}" x2="{_WIDTH}" y1="{limit:.1f}" y2="{limit:.1f}" class="limit"/>')
    first, last = (datetime.fromtimestamp(value, UTC).date().isoformat() for value in (seconds.min(), seconds.max()))
    drawn.append(
        f'<text x="{_LEFT}" y="{_HEIGHT - 6}">{first}</text>'
        f'<text x="{_WIDTH}" y="{_HEIGHT - 6}" text-anchor="end">{last}</text>'
        f'<text x="2" y="{limit + 4:.1f}">{LIMIT_DEG:g}</text><text x="2" y="12">{top:.2f}</text>'
    )
    return _figure("Errors over the days: median (dot) and largest (line end) of each traversal", "".join(drawn))


def _y(value: float, top: float) -> float:
    return (_HEIGHT - _BOTTOM) * (1.0 - value / top)


def _axis_labels(values: Iterable[float], top: float, form: str) -> str:
    return "".join(
        f'<text x="{_LEFT + (_WIDTH - _LEFT) * value / top:.1f}" y="{_HEIGHT - 8}" text-anchor="middle">'
        f"{form.format(value)}</text>"
        for value in values
    )


def _vertical(x: float) -> str:
    return f'<line x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{_HEIGHT - _BOTTOM}" class="limit"/>'


def _figure(title: str, drawing: str, height: int = _HEIGHT) -> str:
    box = f'viewBox="0 0 {_WIDTH + 12} {height}" style="max-width:{_LARGEST_PX}px"'
    svg = f'<svg {box} role="img" aria-label="{escape(title)}">{drawing}</svg>'
    return f"<figure><figcaption>{escape(title)}</figcaption>{svg}</figure>"


def _camera_table(check: CalibrationCheck) -> str:
    if not any(item.cameras for item in check.traversals):
        return '<p class="dim">No camera could be checked: the table of traversals states the reasons.</p>'
    rows = []
    for item in check.traversals:
        for one in item.cameras:
            axes = [
                f"{error:+.3f} ± {sigma:.3f}" if known else f"(± {sigma:.2f})"
                for error, sigma, known in zip(one.error_deg, one.sigma_deg, one.observable)
            ]
            angle = "--" if one.angle_deg is None else f"{one.angle_deg:.3f}"
            rows.append(
                [escape(item.traversal_id), escape(one.camera), one.stage, angle, one.status, *axes,
                 f"{one.focal_error_percent:+.2f} ± {one.focal_sigma_percent:.2f}", f"{one.tracks:,}"]
            )  # fmt: skip
    head = (
        "traversal",
        "camera",
        "stage",
        "n:angle (deg)",
        "status",
        "n:roll",
        "n:pitch",
        "n:yaw",
        "n:focal length (%)",
        "n:tracks",
    )
    return html_table(head, rows)


def _axes_table(check: CalibrationCheck) -> str:
    rows = []
    for item in check.traversals:
        for one in item.cameras:
            axes = [
                f"{'yes' if known else '<b>no</b>'}, ± {sigma:.3f}<br><small>{escape(name)} {share:.0%}</small>"
                for known, sigma, name, share in zip(one.observable, one.sigma_deg, one.source, one.source_share)
            ]
            why = (
                one.reason or f"turned {item.turned_deg:.0f} degrees over {item.driven_m:.0f} m, {one.tracks:,} tracks"
            )
            rows.append([escape(item.traversal_id), escape(one.camera), *axes, _whole(why)])
    if not rows:
        return '<p class="dim">No camera could be checked: the table of traversals states the reasons.</p>'
    return html_table(("traversal", "camera", *AXES, "why"), rows)


def _whole(text: str) -> str:
    """A text that wraps, so that it is read without scrolling sideways."""
    return f'<div class="whole">{escape(text)}</div>' if text else ""


def _traversal_table(traversals: Sequence[TraversalCheck]) -> str:
    rows = [
        [escape(one.traversal_id), escape(one.vehicle_id), one.light, one.status, f"{one.frames}",
         f"{one.driven_m:.0f}", f"{one.turned_deg:.0f}", _way(one), _whole(one.message or "; ".join(one.unread))]
        for one in traversals
    ]  # fmt: skip
    head = (
        "traversal",
        "vehicle",
        "light",
        "status",
        "n:frames",
        "n:driven (m)",
        "n:turned (deg)",
        "n:way (%)",
        "message",
    )
    return html_table(head, rows)


def _way(one: TraversalCheck) -> str:
    """By how much the recorded way is too long."""
    if one.way_error_percent is None:
        return "--"
    return f"{one.way_error_percent:+.2f} ± {one.way_sigma_percent:.2f}"


def _stage_table(differences: Sequence[StageDifference]) -> str:
    rows = [
        [escape(one.vehicle_id), escape(one.drive_id), escape(one.camera), f"{one.first} to {one.second}",
         f"{one.angle_deg:.3f}", *(f"{axis:+.3f}" for axis in one.axes_deg), f"{one.distance_cm:.1f}"]
        for one in differences
    ]  # fmt: skip
    if not rows:
        return '<p class="dim">No camera has two stages.</p>'
    head = ("vehicle", "drive", "camera", "stages", "n:angle (deg)", "n:roll", "n:pitch", "n:yaw", "n:distance (cm)")
    return html_table(head, rows)


def _validity(check: CalibrationCheck) -> str:
    """Validity intervals as bars, one line for each vehicle, camera and stage; jumps as red lines."""
    if not check.history.rows:
        return '<p class="dim">The dataset has no calibrations.</p>'
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
        drawn.append(f'<text x="0" y="{y + 9}">{escape(f"{vehicle[-12:]} {camera} {stage}")}</text>')
        for row in own:
            start, end = place(row["valid_from_ns"], 180.0), place(row["valid_to_ns"], float(_WIDTH))
            drawn.append(
                f'<rect x="{start:.1f}" y="{y}" width="{max(end - start, 1.0):.1f}" height="9" '
                f'fill="{_COLOURS[stage]}" opacity="0.55"/>'
            )
        for jump in check.history.in_time:
            if jump.is_jump and (jump.vehicle_id, jump.camera, jump.second) == (vehicle, camera, stage):
                x = place(jump.at_ns, 180.0)
                drawn.append(
                    f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{y - 2}" y2="{y + 11}" stroke="#c0392b" stroke-width="2">'
                    f"<title>{jump.angle_deg:.3f} degrees, {jump.distance_cm:.1f} cm</title></line>"
                )
    low = 14 * len(lines) + 14
    days = (datetime.fromtimestamp(at * 1e-9, UTC).date().isoformat() for at in (first, last))
    drawn += [
        f'<text x="{x}" y="{low}" text-anchor="{anchor}">{day}</text>'
        for x, anchor, day in zip((180, _WIDTH), ("start", "end"), days)
    ]
    jumps = [one for one in check.history.in_time if one.is_jump]
    title = f"{len(rows)} calibrations, {len(jumps)} jumps"
    return _figure(title, "".join(drawn), low + 6)


def _drift(traversals: Sequence[TraversalCheck]) -> str:
    lengths = list(dict.fromkeys(length for one in traversals for length in one.drift_percent))
    if not lengths:
        return '<p class="dim">Not measured: no layer of reference poses was named (--reference-poses).</p>'
    rows = [
        [escape(one.traversal_id), *(_percent(one.drift_percent.get(length)) for length in lengths)]
        for one in traversals
    ]
    text = f"Median drift in percent of the distance; the paper states {PAPER_PERCENT:g} %."
    return f'<p class="dim">{text}</p>' + html_table(("traversal", *(f"n:{one} m" for one in lengths)), rows)


def _percent(value: float | None) -> str:
    return "--" if value is None else f"{value:.3f}"


def _number(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else "--"
