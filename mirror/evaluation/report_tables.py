"""Tables of the report: figures by group and part, a column a metric, beside those of baselines; footnotes once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from mirror.evaluation.result import GroupFigure, Level, Result
from mirror.metrics.catalogue import Measure, find_measure
from mirror.protocols.ranking import group_title

_EXAMPLES_EACH: Final = 2
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
    """Numbers of remarks, where equal remarks share one number."""

    numbers: dict[str, int] = field(default_factory=dict)

    def mark(self, remarks: Iterable[str]) -> list[int]:
        """Return the numbers of remarks; new remarks get the next numbers."""
        return sorted({self.numbers.setdefault(remark, len(self.numbers) + 1) for remark in remarks})


@dataclass(frozen=True)
class FigureCell:
    """A figure in the form in which a page shows it.

    Attributes:
        text: its value, without the unit.
        marks: numbers of its footnotes.
        interval: both ends of its interval; empty without one.
    """

    text: str
    marks: Sequence[int]
    interval: str


@dataclass(frozen=True)
class FigureRow:
    """A row of a table of figures.

    Attributes:
        labels: its labels.
        cells: its figures; None: there is none.
        n: the numbers of samples.
    """

    labels: Sequence[str]
    cells: Sequence[FigureCell | None]
    n: str


@dataclass(frozen=True)
class FigureTable:
    """A table of figures: heads (heads of numbers begin with ``n:``) and rows."""

    head: Sequence[str]
    rows: Sequence[FigureRow]


@dataclass(frozen=True)
class Breakdown:
    """The figures of the parts of a level, such as all cameras, below a title."""

    title: str
    table: FigureTable


@dataclass(frozen=True)
class _Row:
    labels: tuple[str, ...]
    figures: dict[str, GroupFigure]


def summary_table(result: Result, baselines: Sequence[Result], notes: Footnotes) -> FigureTable:
    """Arrange the figures of every group: a row for the method, and one for each baseline."""
    rows = []
    for group in dict.fromkeys(figure.group for figure in result.figures):
        for one in (result, *baselines):
            figures = [figure for figure in one.figures if (figure.level, figure.group) == ("group", group)]
            name = one.submission.method.name if one is result else f"{one.submission.method.name} (baseline)"
            rows.append(_Row((group_title(group), name), {figure.metric: figure for figure in figures}))
    return _arrange(("group", "method"), [row for row in rows if row.figures], notes)


def breakdown_tables(result: Result, notes: Footnotes, levels: Mapping[Level, str] = LEVELS) -> Iterator[Breakdown]:
    """Arrange the figures of each level under its title; with one part, a level's figures equal the groups'."""
    for level, title in levels.items():
        rows: dict[tuple[str, str], dict[str, GroupFigure]] = {}
        for figure in result.figures:
            if figure.level == level:
                rows.setdefault((group_title(figure.group), figure.key), {})[figure.metric] = figure
        if rows:
            parts = [_Row(labels, figures) for labels, figures in rows.items()]
            yield Breakdown(title, _arrange(("group", level), parts, notes))


def list_measures(result: Result) -> list[Measure]:
    """List every metric of a result, with its description and direction."""
    return [find_measure(metric) for metric in dict.fromkeys(figure.metric for figure in result.figures)]


def find_headline(result: Result) -> GroupFigure | None:
    """Find the ranking figure; without a ranking, the first figure of a group with a value."""
    of_groups = [figure for figure in result.figures if figure.level == "group"]
    if result.protocol.ranking is not None:
        column = result.protocol.ranking.column
        return next((figure for figure in of_groups if (figure.group, figure.metric) == column), None)
    return next((figure for figure in of_groups if figure.value is not None), None)


def select_ranks(count: int) -> dict[str, range]:
    """Select disjoint ranges of ranks among `count` sorted examples, worst first: worst, median and best."""
    each = min(_EXAMPLES_EACH, max(count // 3, 1))
    middle = max((count - each) // 2, 0)
    ranks = {"worst": range(min(each, count))}
    if count > 2:
        ranks["median"] = range(middle, middle + each)
    if count > 1:
        ranks["best"] = range(count - each, count)
    return ranks


def format_value(figure: GroupFigure) -> str:
    """Format a value with its unit."""
    return "none" if figure.value is None else f"{_number(figure, figure.value)} {figure.unit}".strip()


def _arrange(labels: Sequence[str], rows: Sequence[_Row], notes: Footnotes) -> FigureTable:
    metrics = dict.fromkeys(metric for row in rows for metric, one in row.figures.items() if one.value is not None)
    metrics = metrics or dict.fromkeys(metric for row in rows for metric in row.figures)
    if len(metrics) > _WIDEST:
        return _arrange_long(labels, rows, notes)
    arranged = []
    for row in rows:
        cells = [_format_cell(row.figures.get(metric), notes) for metric in metrics]
        counts = dict.fromkeys(str(figure.n) for figure in row.figures.values())
        arranged.append(FigureRow(row.labels, cells, ", ".join(counts)))
    return FigureTable([*labels, *(f"n:{metric_head(metric)}" for metric in metrics), "n:n"], arranged)


def _arrange_long(labels: Sequence[str], rows: Sequence[_Row], notes: Footnotes) -> FigureTable:
    arranged = [
        FigureRow([*row.labels, metric_head(metric)], [_format_cell(figure, notes)], str(figure.n))
        for row in rows
        for metric, figure in row.figures.items()
    ]
    return FigureTable([*labels, "metric", "n:value", "n:n"], arranged)


def metric_head(metric: str) -> str:
    """Return the title of a metric with the unit of results and the direction of better values."""
    measure = find_measure(metric)
    return f"{measure.title}{f', {measure.unit}' if measure.unit else ''} {measure.arrow}"


def _format_cell(figure: GroupFigure | None, notes: Footnotes) -> FigureCell | None:
    if figure is None:
        return None
    text = "none" if figure.value is None else _number(figure, figure.value)
    interval = ""
    if figure.low is not None and figure.high is not None:
        interval = f"{_number(figure, figure.low)} to {_number(figure, figure.high)}"
    return FigureCell(text, notes.mark(_list_remarks(figure)), interval)


def _list_remarks(figure: GroupFigure) -> Iterator[str]:
    title = find_measure(figure.metric).title
    if figure.value is not None and figure.low is None and figure.interval_reason:
        yield f"No interval: {figure.interval_reason}."
    for remark in (figure.note, figure.reason):
        if remark:
            yield f"{title}: {remark}."
    if figure.n_inf:
        yield f"{title}: {figure.n_inf} equal to the truth (infinite, left out of the mean)."
    if figure.n_missing:
        yield f"{title}: {figure.n_missing} without a value."


def _number(figure: GroupFigure, value: float) -> str:
    return find_measure(figure.metric).format_exactly(value)
