"""Quality against the time of a picture, as inline SVG: up and left is better."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

from mirror_leaderboard.boards import Board, Column, find_value, seconds_per_image
from mirror_leaderboard.entry import Entry
from mirror_leaderboard.measures import MEASURES
from mirror_leaderboard.site.tables import group_title

_WIDTH, _HEIGHT = 640, 340
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 30, 14, 54
_HUES: Final = 6
_SHAPES: Final = {"measured": "●", "reported": "◇"}
# Of the larger letters that a phone has.
_LABEL_PX: Final = 19
_LABEL_WIDE: Final = 10.0
_REACH_PX: Final = 8.0
_ROWS: Final = 12


@dataclass(frozen=True)
class _Point:
    seconds: float
    value: float
    label: str
    kind: str
    hue: int


def time_quality_plot(boards: Sequence[Board], entries: Sequence[Entry]) -> str:
    """The plot of one protocol's boards; empty if nothing has both a time and a value.

    Args:
        boards: of one protocol; each has its own colour, since values of different data cannot be compared.
        entries: all that there are: render times may stand in another one of the same method.
    """
    columns = dict.fromkeys(board.ranked_by for board in boards)
    column = next((one for one in columns if _points(boards, one, entries)), None)
    if column is None:
        return ""
    points = _points(boards, column, entries)
    measure = MEASURES[column[1]]
    head = f"{group_title(column[0])}: {measure.head} {measure.arrow}"
    x, y = _log_axis([point.seconds for point in points]), _linear_axis([point.value for point in points])
    drawn = [*_grid(x, y), *_labelled(points, x, y, measure.digits)]
    named = dict.fromkeys((point.hue, boards[point.hue].title) for point in points)
    key = "".join(f'<span><i class="dot h{hue % _HUES}"></i>{escape(title)}</span>' for hue, title in named)
    kinds = {point.kind for point in points}
    shapes = "".join(f"<span>{shape} {kind}</span>" for kind, shape in _SHAPES.items() if kind in kinds)
    about = f"{head} against seconds a picture: " + "; ".join(
        f"{point.label} {point.value:.{measure.digits}f} at {point.seconds:.3g} s" for point in points
    )
    axis = f'<text x="{(_LEFT + _WIDTH - _RIGHT) / 2:.0f}" y="{_HEIGHT - 8}" class="middle">seconds a picture ↓</text>'
    return (
        f'<figure class="plot"><figcaption>{escape(head)}, against the time of a picture</figcaption>'
        f'<p class="key">{key}{shapes}</p>'
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{escape(about)}">'
        f"{''.join(drawn)}{axis}</svg></figure>"
    )


@dataclass(frozen=True)
class _Box:
    left: float
    right: float
    top: float
    bottom: float

    def meets(self, other: _Box) -> bool:
        across = self.left < other.right and other.left < self.right
        return across and self.top < other.bottom and other.top < self.bottom

    def within(self, other: _Box) -> bool:
        across = other.left <= self.left and self.right <= other.right
        return across and other.top <= self.top and self.bottom <= other.bottom


@dataclass(frozen=True)
class _Axis:
    low: float
    high: float
    ticks: tuple[float, ...]
    logarithmic: bool

    def share(self, value: float) -> float:
        at = math.log10(value) if self.logarithmic else value
        return (at - self.low) / (self.high - self.low)


def _points(boards: Sequence[Board], column: Column, entries: Sequence[Entry]) -> list[_Point]:
    found = []
    for hue, board in enumerate(boards):
        for entry in board.entries:
            value, seconds = find_value(entry, column), seconds_per_image(entry, entries)
            if value is not None and seconds is not None:
                found.append(_Point(seconds, value * MEASURES[column[1]].scale, entry.method, entry.kind, hue))
    return found


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


def _grid(x: _Axis, y: _Axis) -> list[str]:
    drawn = []
    for tick in x.ticks:
        at = _across(x, tick)
        drawn.append(f'<path class="rule" d="M{at:.1f} {_TOP}V{_HEIGHT - _BOTTOM}"/>')
        drawn.append(f'<text x="{at:.1f}" y="{_HEIGHT - _BOTTOM + 20}" class="middle dim">{tick:g}</text>')
    for tick in y.ticks:
        at = _down(y, tick)
        drawn.append(f'<path class="rule" d="M{_LEFT} {at:.1f}H{_WIDTH - _RIGHT}"/>')
        drawn.append(f'<text x="{_LEFT - 8}" y="{at + 4:.1f}" class="end dim">{tick:.6g}</text>')
    return drawn


def _labelled(points: Sequence[_Point], x: _Axis, y: _Axis, digits: int) -> list[str]:
    drawn: list[str] = []
    places = [(_across(x, point.seconds), _down(y, point.value)) for point in points]
    taken = [
        _Box(across - _REACH_PX, across + _REACH_PX, down - _REACH_PX, down + _REACH_PX) for across, down in places
    ]
    for point, (across, down) in sorted(zip(points, places), key=lambda one: (-one[0].value, one[0].seconds)):
        title = f"<title>{escape(point.label)}: {point.value:.{digits}f} at {point.seconds:.3g} s a picture</title>"
        hue = f"h{point.hue % _HUES}"
        if point.kind == "measured":
            shape = f'<circle cx="{across:.1f}" cy="{down:.1f}" r="6" class="point {hue}">{title}</circle>'
        else:
            diamond = f"M{across:.1f} {down - 8:.1f}l8 8l-8 8l-8 -8z"
            shape = f'<path d="{diamond}" class="point hollow {hue}">{title}</path>'
        side, rows, box = _free(across, down, _LABEL_WIDE * len(point.label), taken)
        taken.append(box)
        at, near = down + 4 + rows * _LABEL_PX, box.left if side > 0 else box.right
        lead = f'<path class="lead" d="M{across:.1f} {down:.1f}L{near:.1f} {at - 5:.1f}"/>' if rows else ""
        anchor = "" if side > 0 else ' class="end"'
        drawn.append(f'{lead}{shape}<text x="{near:.1f}"{anchor} y="{at:.1f}">{escape(point.label)}</text>')
    return drawn


def _free(across: float, down: float, wide: float, taken: Sequence[_Box]) -> tuple[int, int, _Box]:
    """Where a label fits beside a point: on its right or left, level with it or as few rows off as can be.

    Returns:
        1 or -1 for right or left, rows below, and the label's box.
    """
    whole = _Box(_LEFT, _WIDTH, 0.0, _HEIGHT - _BOTTOM)
    # Where none fits: the titles of the points tell all.
    best = (1, 0, _Box(across + 12, across + 12 + wide, down - _LABEL_PX / 2, down + _LABEL_PX / 2))
    for off in range(_ROWS):
        for rows in dict.fromkeys((-off, off)):
            for side in (1, -1):
                start = across + 12 if side > 0 else across - 12 - wide
                middle = down + rows * _LABEL_PX
                box = _Box(start, start + wide, middle - _LABEL_PX / 2, middle + _LABEL_PX / 2)
                if box.within(whole) and not any(box.meets(other) for other in taken):
                    return side, rows, box
    return best


def _across(x: _Axis, value: float) -> float:
    return _LEFT + x.share(value) * (_WIDTH - _LEFT - _RIGHT)


def _down(y: _Axis, value: float) -> float:
    return _HEIGHT - _BOTTOM - y.share(value) * (_HEIGHT - _TOP - _BOTTOM)
