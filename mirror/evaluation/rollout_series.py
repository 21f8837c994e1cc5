"""Time series of a rollout as SVG: speed, time to collision, and the margin to the road's edge."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from mirror.arrays import Float64
from mirror.evaluation.drive_curves import DriveCurve, contact_curve, margin_curve, speed_curve
from mirror.metrics.safety import StateLog
from mirror.pages.rendering import render_part
from mirror.schema.road_map import RoadMap

if TYPE_CHECKING:
    from markupsafe import Markup

_WIDTH: Final = 320.0
_HEIGHT: Final = 44.0


def draw_series(log: StateLog, road_map: RoadMap) -> Markup:
    """Draw the ego's speed, its least time to collision and its margin to the road's edge over time."""
    curves = speed_curve(log), contact_curve(log), margin_curve(log, road_map)
    rows = [_draw_row(curve, 0.0, log.times_s) for curve in curves]
    return render_part(
        "mirror.evaluation", "series.html", "series", f"{_WIDTH:g}", f"{_HEIGHT:g}", rows, f"{log.times_s[-1]:.1f}"
    )


def _draw_row(curve: DriveCurve, level: float, times_s: Float64) -> dict[str, object]:
    values = curve.values
    finite = values[np.isfinite(values)]
    low, high = min(level, finite.min(initial=level)), max(level, finite.max(initial=level))
    span = max(high - low, 1e-9)

    def place(value: float) -> float:
        return _HEIGHT - 2.0 - (_HEIGHT - 4.0) * (value - low) / span

    x = _WIDTH * times_s / max(float(times_s[-1]), 1e-9)
    lines = [
        " ".join(f"{x[row]:.1f},{place(float(values[row])):.1f}" for row in part)
        for part in _split(np.flatnonzero(np.isfinite(values)))
    ]
    words = f"{finite.min():.1f} to {finite.max():.1f} {curve.unit}" if len(finite) else "none"
    return {"name": curve.title, "words": words, "lines": lines, "level": f"{place(level):.1f}"}


def _split(rows: Sequence[int] | np.ndarray) -> list[np.ndarray]:
    """Split ascending rows where one is missing."""
    found = np.asarray(rows, np.int64)
    return [part for part in np.split(found, np.flatnonzero(np.diff(found) > 1) + 1) if len(part)]
