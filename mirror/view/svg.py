"""Charts and maps as inline SVG, without scripts or network access; CSS classes colour them, also in dark mode."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from mirror.arrays import Float64

_BAR_HEIGHT, _BAR_GAP, _LABEL_WIDTH, _BAR_WIDTH, _VALUE_WIDTH = 20, 7, 104, 190, 56


def bars(title: str, values: Mapping[str, float], *, unit: str = "", digits: int = 0) -> str:
    """Draw a horizontal bar chart with one bar for each label, in the given order."""
    top = max(values.values(), default=0.0) or 1.0
    height = len(values) * (_BAR_HEIGHT + _BAR_GAP)
    width = _LABEL_WIDTH + _BAR_WIDTH + _VALUE_WIDTH
    rows = []
    for number, (label, value) in enumerate(values.items()):
        y = number * (_BAR_HEIGHT + _BAR_GAP)
        middle = y + _BAR_HEIGHT * 0.7
        rows.append(
            f'<text x="{_LABEL_WIDTH - 8}" y="{middle:.1f}" class="end">{escape(label)}</text>'
            f'<rect x="{_LABEL_WIDTH}" y="{y}" width="{_BAR_WIDTH * value / top:.1f}" height="{_BAR_HEIGHT}" rx="3"'
            f' class="bar {_css(label)}"/>'
            f'<text x="{_LABEL_WIDTH + _BAR_WIDTH * value / top + 6:.1f}" y="{middle:.1f}">'
            f"{value:,.{digits}f}{escape(unit)}</text>"
        )
    drawing = f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{escape(title)}">{"".join(rows)}</svg>'
    return f"<figure><figcaption>{escape(title)}</figcaption>{drawing}</figure>"


def stacked_bars(title: str, rows: Mapping[str, Mapping[str, float]], parts: Sequence[str]) -> str:
    """Draw a horizontal bar chart with divided bars, and a legend of the parts.

    Args:
        title: title of the chart.
        rows: the values of the parts of each bar, by the bar's label.
        parts: the parts, in their order.
    """
    top = max((sum(row.values()) for row in rows.values()), default=0.0) or 1.0
    step, elements = _BAR_HEIGHT + _BAR_GAP, []
    for number, (label, row) in enumerate(rows.items()):
        y, x = number * step, float(_LABEL_WIDTH)
        middle = y + _BAR_HEIGHT * 0.7
        elements.append(f'<text x="{_LABEL_WIDTH - 8}" y="{middle:.1f}" class="end">{escape(label)}</text>')
        for part in parts:
            width = _BAR_WIDTH * row.get(part, 0.0) / top
            if width > 0.0:
                elements.append(
                    f'<rect x="{x:.1f}" y="{y}" width="{max(width - 1.5, 0.5):.1f}" height="{_BAR_HEIGHT}" rx="3"'
                    f' class="part {_css(part)}"><title>{escape(part)}: {row[part]:g}</title></rect>'
                )
            x += width
        elements.append(f'<text x="{x + 6:.1f}" y="{middle:.1f}">{sum(row.values()):g}</text>')
    x = float(_LABEL_WIDTH)
    for part in parts:
        y = len(rows) * step + 6
        elements.append(f'<rect x="{x:.1f}" y="{y}" width="12" height="12" rx="3" class="part {_css(part)}"/>')
        elements.append(f'<text x="{x + 17:.1f}" y="{y + 10.5}">{escape(part)}</text>')
        x += 38 + 7.5 * len(part)
    width, height = _LABEL_WIDTH + _BAR_WIDTH + _VALUE_WIDTH, len(rows) * step + 24
    drawing = f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{escape(title)}">{"".join(elements)}</svg>'
    return f"<figure><figcaption>{escape(title)}</figcaption>{drawing}</figure>"


@dataclass(frozen=True)
class Line:
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
    lines: Sequence[Line],
    *,
    north: bool,
    roads: Sequence[Sequence[Float64]] = (),
    lanes: Sequence[Float64] = (),
) -> str:
    """Draw a scene's circle with its traversals, y up; a dot marks each entry, an arrow head each exit.

    Later lines are thinner, so that lines in the same lane stay visible.

    Args:
        title: title of the map.
        radius_m: radius of the circle.
        lines: the traversals.
        north: whether an arrow states that up is north; a local frame has no north.
        roads: parts of the drivable area as rings (K, 2), the outline first, relative to the scene's centre.
        lanes: middle lines (P, 2) of lanes.
    """
    reach = radius_m * 1.12
    parts = [f'<circle cx="0" cy="0" r="{radius_m:.1f}" class="roi"/>']
    parts += [f'<path class="road" d="{"".join(f"M {_points(ring)} Z" for ring in rings)}"/>' for rings in roads]
    parts += [f'<path class="lane" d="M {_points(lane)}"/>' for lane in lanes]
    for number, line in enumerate(lines):
        if len(line.x_m) < 2:
            continue
        width = radius_m * (0.012 + 0.02 * (1.0 - (number + 1) / len(lines)))
        points = _points(np.column_stack([line.x_m, line.y_m]))
        tip = _arrow(line, radius_m * 0.04)
        polyline = f'<polyline points="{points}" style="stroke-width:{width:.2f}px"/>'
        parts.append(
            f'<g class="{_css(line.kind)}"><title>{escape(line.title)}</title>{polyline}'
            f'<circle cx="{line.x_m[0]:.1f}" cy="{-line.y_m[0]:.1f}" r="{radius_m * 0.02:.1f}" class="entry"/>{tip}</g>'
        )
    bar = _scale_bar(radius_m)
    parts.append(
        f'<path d="M {-reach * 0.95:.1f} {reach * 0.95:.1f} h {bar}" class="scale"/>'
        f'<text x="{-reach * 0.95:.1f}" y="{reach * 0.91:.1f}" style="font-size:{radius_m * 0.06:.1f}px">'
        f"{bar} m</text>"
    )
    if north:
        parts.append(
            f'<text x="{reach * 0.8:.1f}" y="{-reach * 0.86:.1f}" style="font-size:{radius_m * 0.07:.1f}px">N ↑</text>'
        )
    box = f"{-reach:.1f} {-reach:.1f} {2 * reach:.1f} {2 * reach:.1f}"
    parts.insert(1, _cross(radius_m * 0.03))
    drawing = (
        f'<svg viewBox="{box}" class="map" style="--line:{radius_m * 0.012:.2f}px" role="img"'
        f' aria-label="{escape(title)}">{"".join(parts)}</svg>'
    )
    return f"<figure><figcaption>{escape(title)}</figcaption>{drawing}</figure>"


def _points(line: Float64) -> str:
    return " ".join(f"{x:.1f},{-y:.1f}" for x, y in line)


def _cross(size: float) -> str:
    """Draw the centre of the scene."""
    return f'<path class="centre" d="M {-size:.1f} 0 H {size:.1f} M 0 {-size:.1f} V {size:.1f}"/>'


def _arrow(line: Line, size: float) -> str:
    """Draw a triangle at the end of a line, along its last motion."""
    x, y = float(line.x_m[-1]), float(line.y_m[-1])
    for px, py in zip(line.x_m[::-1], line.y_m[::-1]):
        if math.hypot(x - px, y - py) > 1.0:
            break
    angle = math.degrees(math.atan2(-(y - py), x - px))
    return (
        f'<path class="exit" transform="translate({x:.1f} {-y:.1f}) rotate({angle:.1f})"'
        f' d="M {size:.1f} 0 L {-size * 0.5:.1f} {size * 0.6:.1f} L {-size * 0.5:.1f} {-size * 0.6:.1f} Z"/>'
    )


def _scale_bar(radius_m: float) -> int:
    """Choose a round length of about a third of the radius."""
    power = 10 ** math.floor(math.log10(max(radius_m / 2, 1.0)))
    return int(max(step * power for step in (1, 2, 5) if step * power <= max(radius_m / 2, 1.0)))


def _css(name: str) -> str:
    return "".join(letter if letter.isalnum() else "-" for letter in name.lower())
