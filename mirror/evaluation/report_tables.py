"""Tables of the report: figures by group and part, a column a metric, beside those of baselines; footnotes once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Final

from mirror.evaluation.result import Figure, Level, Result
from mirror.html import html_table
from mirror.metrics.catalogue import find_measure

_WIDEST: Final = 8
"""With more metrics a table has a row for each, since a page would not show so many columns."""

LEVELS: Final[Mapping[Level, str]] = {
    "scene": "By scene",
    "traversal": "By traversal",
    "camera": "By camera",
    "condition": "By condition",
}


@dataclass
class Footnotes:
    """Numbers of remarks: equal remarks share one."""

    numbers: dict[str, int] = field(default_factory=dict)

    def mark(self, remarks: Iterable[str]) -> str:
        """Return the marks of remarks; new remarks get the next numbers."""
        found = sorted({self.numbers.setdefault(remark, len(self.numbers) + 1) for remark in remarks})
        return f"<sup>{','.join(map(str, found))}</sup>" if found else ""

    def format(self) -> str:
        """Format the list of remarks; empty if there are none."""
        items = "".join(f"<li>{escape(remark)}</li>" for remark in self.numbers)
        return f'<ol class="notes">{items}</ol>' if items else ""


@dataclass(frozen=True)
class _Row:
    labels: tuple[str, ...]
    figures: dict[str, Figure]


def summary_table(result: Result, baselines: Sequence[Result], notes: Footnotes) -> str:
    """Format the figures of every group: a row for the method, and one for each baseline."""
    rows = []
    for group in dict.fromkeys(figure.group for figure in result.figures):
        for one in (result, *baselines):
            figures = [figure for figure in one.figures if (figure.level, figure.group) == ("group", group)]
            name = one.submission.method.name if one is result else f"{one.submission.method.name} (baseline)"
            rows.append(_Row((group, name), {figure.metric: figure for figure in figures}))
    return _format(("group", "method"), [row for row in rows if row.figures], notes)


def breakdown_tables(result: Result, notes: Footnotes, levels: Mapping[Level, str] = LEVELS) -> Iterator[str]:
    """Format the figures of each level under its title; a level with one part repeats the groups."""
    for level, title in levels.items():
        rows: dict[tuple[str, str], dict[str, Figure]] = {}
        for figure in result.figures:
            if figure.level == level:
                rows.setdefault((figure.group, figure.key), {})[figure.metric] = figure
        if rows:
            parts = [_Row(labels, figures) for labels, figures in rows.items()]
            yield f"<h3>{title}</h3>{_format(('group', level), parts, notes)}"


def metrics_list(result: Result) -> str:
    """Format the sentence and the direction of every metric of a result."""
    measures = [find_measure(metric) for metric in dict.fromkeys(figure.metric for figure in result.figures)]
    items = (f"<li><b>{escape(one.name)}</b>: {escape(one.about)}; {one.better} is better.</li>" for one in measures)
    return f'<ul class="notes">{"".join(items)}</ul>'


def find_headline(result: Result) -> Figure | None:
    """Find the figure that ranks; without a ranking key, the first figure of a group with a value."""
    of_groups = [figure for figure in result.figures if figure.level == "group"]
    if result.protocol.ranking is not None:
        column = result.protocol.ranking.column
        return next((figure for figure in of_groups if (figure.group, figure.metric) == column), None)
    return next((figure for figure in of_groups if figure.value is not None), None)


def format_value(figure: Figure) -> str:
    """Format a value with its unit."""
    return "none" if figure.value is None else f"{_number(figure, figure.value)} {figure.unit}".strip()


def _format(labels: Sequence[str], rows: Sequence[_Row], notes: Footnotes) -> str:
    metrics = dict.fromkeys(metric for row in rows for metric, one in row.figures.items() if one.value is not None)
    metrics = metrics or dict.fromkeys(metric for row in rows for metric in row.figures)
    if len(metrics) > _WIDEST:
        return _format_long(labels, rows, notes)
    head = [*labels, *(f"n:{_head(metric)}" for metric in metrics), "n:n"]
    cells = []
    for row in rows:
        values = [_format_cell(row.figures.get(metric), notes) for metric in metrics]
        counts = dict.fromkeys(str(figure.n) for figure in row.figures.values())
        cells.append([*map(escape, row.labels), *values, ", ".join(counts)])
    return html_table(head, cells)


def _format_long(labels: Sequence[str], rows: Sequence[_Row], notes: Footnotes) -> str:
    cells = [
        [*map(escape, row.labels), escape(metric), _format_cell(figure, notes), str(figure.n)]
        for row in rows
        for metric, figure in row.figures.items()
    ]
    return html_table([*labels, "metric", "n:value", "n:n"], cells)


def _head(metric: str) -> str:
    unit = find_measure(metric).unit
    return f"{metric}, {unit}" if unit else metric


def _format_cell(figure: Figure | None, notes: Footnotes) -> str:
    if figure is None:
        return ""
    text = "none" if figure.value is None else _number(figure, figure.value)
    interval = ""
    if figure.low is not None and figure.high is not None:
        interval = f"<small>{_number(figure, figure.low)} to {_number(figure, figure.high)}</small>"
    return f"{text}{notes.mark(_list_remarks(figure))}{interval}"


def _list_remarks(figure: Figure) -> Iterator[str]:
    if figure.value is not None and figure.low is None and figure.interval_reason:
        yield f"No interval: {figure.interval_reason}."
    for remark in (figure.note, figure.reason):
        if remark:
            yield f"{figure.metric}: {remark}."
    if figure.n_inf:
        yield f"{figure.metric}: {figure.n_inf} equal to the truth (infinite, left out of the mean)."
    if figure.n_missing:
        yield f"{figure.metric}: {figure.n_missing} without a value."


def _number(figure: Figure, value: float) -> str:
    return find_measure(figure.metric).format_exactly(value)
