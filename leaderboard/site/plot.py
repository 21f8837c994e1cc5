"""Quality against the time of a picture, as inline SVG: up and left is better."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

from leaderboard.boards import Board, Column, seconds_per_picture, value_of
from leaderboard.entry import Entry
from leaderboard.measures import MEASURES
from leaderboard.site.tables import group_title

_WIDTH, _HEIGHT = 640, 340
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 30, 14, 54
_HUES: Final = 6
_SHAPES: Final = {"measured": "●", "reported": "◇"}
# Of the larger letters that a phone has.
_LABEL_PX: Final = 19
_LABEL_WIDE: Final = 10.0


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
            value, seconds = value_of(entry, column), seconds_per_picture(entry, entries)
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
    taken: list[tuple[float, float, float]] = []
    for point in sorted(points, key=lambda point: (-point.value, point.seconds)):
        across, down = _across(x, point.seconds), _down(y, point.value)
        title = f"<title>{escape(point.label)}: {point.value:.{digits}f} at {point.seconds:.3g} s a picture</title>"
        hue = f"h{point.hue % _HUES}"
        if point.kind == "measured":
            shape = f'<circle cx="{across:.1f}" cy="{down:.1f}" r="6" class="point {hue}">{title}</circle>'
        else:
            diamond = f"M{across:.1f} {down - 8:.1f}l8 8l-8 8l-8 -8z"
            shape = f'<path d="{diamond}" class="point hollow {hue}">{title}</path>'
        wide = _LABEL_WIDE * len(point.label)
        left = across + 12 + wide > _WIDTH - _RIGHT
        start, end = (across - 12 - wide, across - 12) if left else (across + 12, across + 12 + wide)
        at = down + 4
        while any(abs(at - other) < _LABEL_PX and start < last and first < end for other, first, last in taken):
            at += _LABEL_PX
        taken.append((at, start, end))
        side = f'x="{end:.1f}" class="end"' if left else f'x="{start:.1f}"'
        drawn.append(f'{shape}<text {side} y="{at:.1f}">{escape(point.label)}</text>')
    return drawn


def _across(x: _Axis, value: float) -> float:
    return _LEFT + x.share(value) * (_WIDTH - _LEFT - _RIGHT)


def _down(y: _Axis, value: float) -> float:
    return _HEIGHT - _BOTTOM - y.share(value) * (_HEIGHT - _TOP - _BOTTOM)
