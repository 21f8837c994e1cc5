"""Charts and maps as inline SVG, without scripts or network access; CSS classes colour them, also in dark mode."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mirror.arrays import Float64
from mirror.pages.rendering import render_part

if TYPE_CHECKING:
    from markupsafe import Markup

_BAR_HEIGHT, _BAR_GAP, _LABEL_WIDTH, _BAR_WIDTH, _VALUE_WIDTH = 20, 7, 104, 190, 56
_STEP = _BAR_HEIGHT + _BAR_GAP
MAP_REACH = 1.12
"""Half the side of a map, in radii of its scene."""


def bars(title: str, values: Mapping[str, float], *, unit: str = "", digits: int = 0) -> Markup:
    """Draw a horizontal bar chart with one bar for each label, in the given order."""
    top = max(values.values(), default=0.0) or 1.0
    rows = []
    for number, (label, value) in enumerate(values.items()):
        width = _BAR_WIDTH * value / top
        bar = _bar(number, float(_LABEL_WIDTH), width, f"bar {_css(label)}")
        rows.append(_row(number, label, [bar], _LABEL_WIDTH + width, f"{value:,.{digits}f}{unit}"))
    return _draw_chart(title, len(values) * _STEP, rows, [])


def stacked_bars(title: str, rows: Mapping[str, Mapping[str, float]], parts: Sequence[str]) -> Markup:
    """Draw a horizontal bar chart with divided bars, and a legend of the parts.

    Args:
        title: title of the chart.
        rows: the values of the parts of each bar, by the bar's label.
        parts: the parts, in their order.
    """
    top = max((sum(row.values()) for row in rows.values()), default=0.0) or 1.0
    drawn = []
    for number, (label, row) in enumerate(rows.items()):
        x, own = float(_LABEL_WIDTH), []
        for part in parts:
            width = _BAR_WIDTH * row.get(part, 0.0) / top
            if width > 0.0:
                about = f"{part}: {row[part]:g}"
                own.append(_bar(number, x, max(width - 1.5, 0.5), f"part {_css(part)}", about))
            x += width
        drawn.append(_row(number, label, own, x, f"{sum(row.values()):g}"))
    x, y, key = float(_LABEL_WIDTH), len(rows) * _STEP + 6, []
    for part in parts:
        kind = f"part {_css(part)}"
        key.append({"x": f"{x:.1f}", "y": y, "text_x": f"{x + 17:.1f}", "text_y": y + 10.5, "kind": kind, "name": part})
        x += 38 + 7.5 * len(part)
    return _draw_chart(title, len(rows) * _STEP + 24, drawn, key)


def _bar(number: int, x: float, width: float, kind: str, title: str = "") -> dict[str, object]:
    place = {"x": f"{x:.1f}", "y": number * _STEP, "width": f"{width:.1f}", "height": _BAR_HEIGHT}
    return {**place, "kind": kind, "title": title}


def _row(number: int, label: str, own: Sequence[object], end: float, value: str) -> dict[str, object]:
    text_y = f"{number * _STEP + _BAR_HEIGHT * 0.7:.1f}"
    labelled = {"label_x": _LABEL_WIDTH - 8, "text_y": text_y, "label": label}
    return {**labelled, "bars": own, "value_x": f"{end + 6:.1f}", "value": value}


def _draw_chart(title: str, height: int, rows: Sequence[object], key: Sequence[object]) -> Markup:
    width = _LABEL_WIDTH + _BAR_WIDTH + _VALUE_WIDTH
    return render_part("mirror.view", "charts.html", "bar_chart", title, width, height, rows, key)


@dataclass(frozen=True)
class MapTrack:
    """One traversal on a map.

    Attributes:
        x_m: (N,) east of the scene's centre.
        y_m: (N,) north of the scene's centre.
        kind: CSS class that colours the line.
        title: text under the mouse pointer.
    """

    x_m: Float64
    y_m: Float64
    kind: str
    title: str


def scene_map(
    title: str,
    radius_m: float,
    lines: Sequence[MapTrack],
    *,
    north: bool,
    roads: Sequence[Sequence[Float64]] = (),
    lanes: Sequence[Float64] = (),
    ground: str | None = None,
) -> Markup:
    """Draw a scene's circle with its traversals, y up; a dot marks each entry, an arrow head each exit.

    Later lines are thinner, so that lines in the same lane stay visible.

    Args:
        title: title of the map.
        radius_m: radius of the circle.
        lines: the traversals.
        north: whether an arrow states that up is north; a local frame has no north.
        roads: parts of the drivable area as rings (K, 2), the outline first, relative to the scene's centre.
        lanes: middle lines (P, 2) of lanes.
        ground: address of an image of the ground, of the square that the map shows; None: there is none.
    """
    reach, bar, cross = radius_m * MAP_REACH, _scale_bar(radius_m), radius_m * 0.03
    drawn = []
    for number, line in enumerate(lines):
        if len(line.x_m) < 2:
            continue
        turn, arrow = _arrow(line, radius_m * 0.04)
        drawn.append(
            {
                "kind": _css(line.kind),
                "title": line.title,
                "points": _points(np.column_stack([line.x_m, line.y_m])),
                "width": f"{radius_m * (0.012 + 0.02 * (1.0 - (number + 1) / len(lines))):.2f}",
                "entry_x": f"{line.x_m[0]:.1f}",
                "entry_y": f"{-line.y_m[0]:.1f}",
                "dot": f"{radius_m * 0.02:.1f}",
                "turn": turn,
                "arrow": arrow,
            }
        )
    scene = {
        "box": f"{-reach:.1f} {-reach:.1f} {2 * reach:.1f} {2 * reach:.1f}",
        "line": f"{radius_m * 0.012:.2f}",
        "reach": f"{reach:.1f}",
        "side": f"{2 * reach:.1f}",
        "ground": ground,
        "radius": f"{radius_m:.1f}",
        "cross": f"M {-cross:.1f} 0 H {cross:.1f} M 0 {-cross:.1f} V {cross:.1f}",
        "roads": ["".join(f"M {_points(ring)} Z" for ring in rings) for rings in roads],
        "lanes": [f"M {_points(lane)}" for lane in lanes],
        "lines": drawn,
        "scale": f"M {-reach * 0.95:.1f} {reach * 0.95:.1f} h {bar}",
        "scale_x": f"{-reach * 0.95:.1f}",
        "scale_y": f"{reach * 0.91:.1f}",
        "scale_px": f"{radius_m * 0.06:.1f}",
        "scale_m": bar,
        "north": north,
        "north_x": f"{reach * 0.8:.1f}",
        "north_y": f"{-reach * 0.86:.1f}",
        "north_px": f"{radius_m * 0.07:.1f}",
    }
    return render_part("mirror.view", "charts.html", "scene_map", title, scene)


def _points(line: Float64) -> str:
    return " ".join(f"{x:.1f},{-y:.1f}" for x, y in line)


def _arrow(line: MapTrack, size: float) -> tuple[str, str]:
    """Return place and turn of the end of a line, along its last motion, and a triangle to draw there."""
    x, y = float(line.x_m[-1]), float(line.y_m[-1])
    for px, py in zip(line.x_m[::-1], line.y_m[::-1]):
        if math.hypot(x - px, y - py) > 1.0:
            break
    angle = math.degrees(math.atan2(-(y - py), x - px))
    triangle = f"M {size:.1f} 0 L {-size * 0.5:.1f} {size * 0.6:.1f} L {-size * 0.5:.1f} {-size * 0.6:.1f} Z"
    return f"translate({x:.1f} {-y:.1f}) rotate({angle:.1f})", triangle


def _scale_bar(radius_m: float) -> int:
    """Choose a round length of about a third of the radius."""
    power = 10 ** math.floor(math.log10(max(radius_m / 2, 1.0)))
    return int(max(step * power for step in (1, 2, 5) if step * power <= max(radius_m / 2, 1.0)))


def _css(name: str) -> str:
    return "".join(letter if letter.isalnum() else "-" for letter in name.lower())
