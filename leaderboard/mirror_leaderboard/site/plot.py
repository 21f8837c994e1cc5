"""The plot of quality against render time of an image, as inline SVG: up and left is better."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from mirror.metrics.catalogue import MEASURES
from mirror.protocols.ranking import group_title
from mirror_leaderboard.boards import Board, Column, find_value, seconds_per_image
from mirror_leaderboard.entry import Entry, Reported

_WIDTH, _HEIGHT = 640, 340
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 30, 14, 54
# Sizes of labels are those of the larger font on a phone.
_LABEL_PX: Final = 19
_LETTER_PX: Final = 10.0
_POINT_RADIUS_PX: Final = 8.0
_MAX_ROWS: Final = 12


@dataclass(frozen=True)
class _Point:
    seconds: float
    value: float
    label: str
    kind: str


def time_quality_plot(board: Board, entries: Sequence[Entry]) -> dict[str, object] | None:
    """Place the methods of a board on a plot; None if no method has both a render time and a value.

    Values of different data are not comparable: each board has a plot of its own, and there is none for several papers
    that do not name their data.

    Args:
        board: the board.
        entries: all entries: the render time of a method may be in another of its entries.
    """
    column = board.ranked_by
    points = _list_points(board, column, entries)
    papers = {entry.paper.title for entry in board.entries if isinstance(entry, Reported) and entry.dataset is None}
    if not points or len(papers) > 1:
        return None
    measure = MEASURES[column[1]]
    head = f"{group_title(column[0])}: {measure.head} {measure.arrow}"
    x, y = _log_axis([point.seconds for point in points]), _linear_axis([point.value for point in points])
    about = f"{board.title}: {head} against seconds per image: " + "; ".join(
        f"{point.label} {point.value:.{measure.digits}f} at {point.seconds:.3g} s" for point in points
    )
    return {
        "head": head,
        "title": board.title,
        "width": _WIDTH,
        "height": _HEIGHT,
        "about": about,
        "x_ticks": [_place_x_tick(x, tick) for tick in x.ticks],
        "y_ticks": [_place_y_tick(y, tick) for tick in y.ticks],
        "points": _place_points(points, x, y, measure.digits),
        "axis_x": f"{(_LEFT + _WIDTH - _RIGHT) / 2:.0f}",
        "axis_y": _HEIGHT - 8,
    }


@dataclass(frozen=True)
class _Box:
    left: float
    right: float
    top: float
    bottom: float

    def overlaps(self, other: _Box) -> bool:
        horizontally = self.left < other.right and other.left < self.right
        return horizontally and self.top < other.bottom and other.top < self.bottom

    def is_within(self, other: _Box) -> bool:
        horizontally = other.left <= self.left and self.right <= other.right
        return horizontally and other.top <= self.top and self.bottom <= other.bottom


@dataclass(frozen=True)
class _Axis:
    low: float
    high: float
    ticks: tuple[float, ...]
    logarithmic: bool

    def fraction(self, value: float) -> float:
        position = math.log10(value) if self.logarithmic else value
        return (position - self.low) / (self.high - self.low)


def _list_points(board: Board, column: Column, entries: Sequence[Entry]) -> list[_Point]:
    points = []
    for entry in board.entries:
        value, seconds = find_value(entry, column), seconds_per_image(entry, entries)
        if value is not None and seconds is not None:
            points.append(_Point(seconds, value * MEASURES[column[1]].scale, entry.method, entry.kind))
    return points


def _log_axis(values: Sequence[float]) -> _Axis:
    low, high = math.floor(math.log10(min(values) / 1.5)), math.ceil(math.log10(max(values) * 1.5))
    return _Axis(low, high, tuple(10.0**power for power in range(low, high + 1)), logarithmic=True)


def _linear_axis(values: Sequence[float]) -> _Axis:
    span = max(max(values) - min(values), abs(max(values)) * 0.05, 1e-3)
    rough = span / 4
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough)
    first, last = math.floor(min(values) / step - 0.3), math.ceil(max(values) / step + 0.3)
    ticks = tuple(number * step for number in range(first, last + 1))
    return _Axis(ticks[0], ticks[-1], ticks, logarithmic=False)


def _place_x_tick(axis: _Axis, tick: float) -> dict[str, object]:
    x = f"{_to_x(axis, tick):.1f}"
    return {"rule": f"M{x} {_TOP}V{_HEIGHT - _BOTTOM}", "x": x, "y": _HEIGHT - _BOTTOM + 20, "text": f"{tick:g}"}


def _place_y_tick(axis: _Axis, tick: float) -> dict[str, object]:
    y = _to_y(axis, tick)
    rule = f"M{_LEFT} {y:.1f}H{_WIDTH - _RIGHT}"
    return {"rule": rule, "x": _LEFT - 8, "y": f"{y + 4:.1f}", "text": f"{tick:.6g}"}


def _place_points(points: Sequence[_Point], x: _Axis, y: _Axis, digits: int) -> list[dict[str, object]]:
    placed = []
    positions = [(_to_x(x, point.seconds), _to_y(y, point.value)) for point in points]
    radius = _POINT_RADIUS_PX
    occupied = [_Box(at_x - radius, at_x + radius, at_y - radius, at_y + radius) for at_x, at_y in positions]
    for point, (at_x, at_y) in sorted(zip(points, positions), key=lambda item: (-item[0].value, item[0].seconds)):
        side, rows, box = _place_label(at_x, at_y, _LETTER_PX * len(point.label), occupied)
        occupied.append(box)
        label_x, label_y = box.left if side > 0 else box.right, at_y + 4 + rows * _LABEL_PX
        placed.append(
            {
                "title": f"{point.label}: {point.value:.{digits}f} at {point.seconds:.3g} s per image",
                "is_measured": point.kind == "measured",
                "x": f"{at_x:.1f}",
                "y": f"{at_y:.1f}",
                "diamond": f"M{at_x:.1f} {at_y - 8:.1f}l8 8l-8 8l-8 -8z",
                "lead": f"M{at_x:.1f} {at_y:.1f}L{label_x:.1f} {label_y - 5:.1f}" if rows else "",
                "label": point.label,
                "label_x": f"{label_x:.1f}",
                "label_y": f"{label_y:.1f}",
                "ends": side < 0,
            }
        )
    return placed


def _place_label(at_x: float, at_y: float, width: float, occupied: Sequence[_Box]) -> tuple[int, int, _Box]:
    """Find a free place for a label: on the right or left of its point, in the nearest free row.

    Returns:
        1 for right or -1 for left; the row, counted downwards from the point's own; and the label's box.
    """
    plot = _Box(_LEFT, _WIDTH, 0.0, _HEIGHT - _BOTTOM)
    # If no place is free, the label overlaps: the title of the point still shows it.
    fallback = (1, 0, _Box(at_x + 12, at_x + 12 + width, at_y - _LABEL_PX / 2, at_y + _LABEL_PX / 2))
    for distance in range(_MAX_ROWS):
        for rows in dict.fromkeys((-distance, distance)):
            for side in (1, -1):
                start = at_x + 12 if side > 0 else at_x - 12 - width
                middle = at_y + rows * _LABEL_PX
                box = _Box(start, start + width, middle - _LABEL_PX / 2, middle + _LABEL_PX / 2)
                if box.is_within(plot) and not any(box.overlaps(other) for other in occupied):
                    return side, rows, box
    return fallback


def _to_x(axis: _Axis, value: float) -> float:
    return _LEFT + axis.fraction(value) * (_WIDTH - _LEFT - _RIGHT)


def _to_y(axis: _Axis, value: float) -> float:
    return _HEIGHT - _BOTTOM - axis.fraction(value) * (_HEIGHT - _TOP - _BOTTOM)
