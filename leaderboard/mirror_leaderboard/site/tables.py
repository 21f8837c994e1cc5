"""The tables of a board: sorted in the file, and sortable in a browser that runs scripts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, groupby
from math import ceil
from typing import Final

from mirror.metrics.catalogue import MEASURES, Measure
from mirror.protocols.document import load_protocol
from mirror.protocols.ranking import group_title
from mirror_leaderboard.boards import FLOOR, FLOOR_OF_EDITS, Board, Column, find_figure
from mirror_leaderboard.entry import Entry, Figure, Measured
from mirror_leaderboard.ranks import Rank
from mirror_leaderboard.site.downloads import entry_file

_FORGEABLE: Final = (
    "not proof against forgery: a copy of the recording has the best distance of sets, a flat patch the best overlap"
)
_NO_INTERVAL: Final = "no interval: "

_MAX_COLUMNS: Final = 9
"""The number of usual columns, with that of ranks, that fits a window of 1280 px."""
_USUAL_HEAD: Final = 14
"""Letters of the longest head of a usual column."""


@dataclass(frozen=True)
class ColumnHead:
    """The head of a column.

    Attributes:
        measure: the metric.
        lines: its lines.
        marks: numbers of its footnotes.
        sort: how the table is sorted by it, as ``aria-sort`` has it; empty: it is not.
        opens_group: whether a group of columns begins with it.
    """

    measure: Measure
    lines: Sequence[str]
    marks: Sequence[int]
    sort: str
    opens_group: bool


@dataclass(frozen=True)
class Cell:
    """A figure of a row.

    Attributes:
        text: the figure as it is shown; None: the entry has none.
        value: its value, by which the table is sorted; None: it has none.
        is_best: whether it is the best of its column.
        marks: numbers of its footnotes.
        details: its interval and its number of samples.
        opens_group: whether a group of columns begins with it.
    """

    text: str | None
    value: float | None
    is_best: bool
    marks: Sequence[int]
    details: Sequence[str]
    opens_group: bool


@dataclass(frozen=True)
class Row:
    """A row of a board.

    Attributes:
        entry: its entry.
        file: the entry's file, relative to the site.
        is_floor: whether the method is a floor.
        details: what tells it from other rows of its method.
        marks: numbers of its footnotes.
        rank: its rank; None: the board has no ranks.
        rank_marks: numbers of the footnotes of its rank.
        cells: its figures.
    """

    entry: Entry
    file: str
    is_floor: bool
    details: str
    marks: Sequence[int]
    rank: Rank | None
    rank_marks: Sequence[int]
    cells: Sequence[Cell]


@dataclass(frozen=True)
class BoardTable:
    """A table of a board.

    Attributes:
        caption: its name.
        has_ranks: whether its rows have ranks.
        groups: titles of the groups of its columns, each with the number of columns.
        heads: heads of its columns.
        rows: its rows.
    """

    caption: str
    has_ranks: bool
    groups: Sequence[tuple[str, int]]
    heads: Sequence[ColumnHead]
    rows: Sequence[Row]


def board_tables(board: Board, notes: dict[str, int]) -> list[BoardTable]:
    """Arrange the table of a board; many groups are split into tables that fit a window.

    Args:
        board: the board.
        notes: numbers of the footnotes of its section; new ones are added.
    """
    # The table that ranks comes first.
    parts = sorted(
        _split_columns(board.columns, _MAX_COLUMNS - (board.ranks is not None)),
        key=lambda part: board.ranked_by not in part,
    )
    return [_arrange_table(board, part, notes, named=len(parts) > 1) for part in parts]


def _split_columns(columns: Sequence[Column], most: int) -> list[list[Column]]:
    """Split columns into parts that fit a window, each with whole groups; a group that does not fit is cut."""
    groups = [
        piece
        for _, members in groupby(columns, key=lambda column: column[0])
        for piece in _cut_group(list(members), most)
    ]
    widest = max(map(_find_width, groups))
    each = len(groups) if _find_width(columns) <= most else max(int(most // widest), 1)
    each = ceil(len(groups) / ceil(len(groups) / each))
    return [list(chain(*groups[start : start + each])) for start in range(0, len(groups), each)]


def _cut_group(columns: Sequence[Column], most: int) -> list[list[Column]]:
    """Cut the columns of a group into pieces with similar numbers of columns that fit a window."""
    each = ceil(len(columns) / ceil(_find_width(columns) / most))
    return [list(columns[start : start + each]) for start in range(0, len(columns), each)]


def _find_width(columns: Sequence[Column]) -> float:
    """Find the width of columns, in usual ones: long heads take more."""
    return sum(max(1.0, max(map(len, _head_lines(MEASURES[metric].head))) / _USUAL_HEAD) for _, metric in columns)


def _head_lines(head: str) -> list[str]:
    """Return the lines of a column's head: the part of the image, as in ``PSNR, new hull (dB)``, has its own."""
    return head.split(", ")


def _arrange_table(board: Board, part: Sequence[Column], notes: dict[str, int], *, named: bool) -> BoardTable:
    best = {column: board.best(column) for column in part}
    caption = f"{board.protocol}, {board.title}"
    if named:
        caption += ": " + ", ".join(group_title(group) for group in dict.fromkeys(group for group, _ in part))
    groups = [
        (group_title(group), len(list(columns))) for group, columns in groupby(part, key=lambda column: column[0])
    ]
    # Footnotes are numbered by rows, then by heads.
    ranks = [None] * len(board.entries) if board.ranks is None else board.ranks.rows
    rows = [_arrange_row(entry, rank, board, part, best, notes) for entry, rank in zip(board.entries, ranks)]
    return BoardTable(
        caption, board.ranks is not None, groups, [_arrange_head(column, board, notes) for column in part], rows
    )


def _arrange_head(column: Column, board: Board, notes: dict[str, int]) -> ColumnHead:
    measure = MEASURES[column[1]]
    direction = "descending" if measure.better == "higher" else "ascending"
    return ColumnHead(
        measure=measure,
        lines=_head_lines(measure.head),
        marks=_number_notes([_FORGEABLE] if measure.forgeable else [], notes),
        sort=direction if column == board.ranked_by else "",
        opens_group=_opens_group(board.columns, column),
    )


def _arrange_row(
    entry: Entry,
    rank: Rank | None,
    board: Board,
    part: Sequence[Column],
    best: dict[Column, float | None],
    notes: dict[str, int],
) -> Row:
    # A metric without any value has no column: its notes are shown with the row.
    without_column = [figure for figure in entry.figures if (figure.group, figure.metric) not in board.columns]
    metric_notes = dict.fromkeys(f"{MEASURES[figure.metric].title}: {figure.note}" for figure in without_column)
    return Row(
        entry=entry,
        file=entry_file(entry),
        is_floor=entry.method in (*FLOOR, *FLOOR_OF_EDITS),
        details=", ".join(list_variant(entry, board)),
        marks=_number_notes([*entry.notes, *metric_notes], notes),
        rank=rank,
        rank_marks=[] if rank is None or rank.reason is None else _number_notes([rank.reason], notes),
        cells=[_arrange_cell(entry, column, board, best[column], notes) for column in part],
    )


def list_variant(entry: Entry, board: Board) -> Iterator[str]:
    """List what tells the row from others of its method: the version if another is on the board, the setting."""
    others = {other.version for other in board.entries if isinstance(other, Measured) and other.method == entry.method}
    if isinstance(entry, Measured) and len(others) > 1:
        yield f"version {entry.version}"
    if entry.setting:
        yield entry.setting
    if isinstance(entry, Measured) and load_protocol(entry.protocol).suite is not None:
        if entry.verified:
            yield "states verified"
        if entry.policy_run is not None:
            yield f"policy run by the organiser ({entry.policy_run})"


def _arrange_cell(entry: Entry, column: Column, board: Board, best: float | None, notes: dict[str, int]) -> Cell:
    opens_group = _opens_group(board.columns, column)
    figure = find_figure(entry, column)
    if figure is None:
        return Cell(None, None, is_best=False, marks=[], details=[], opens_group=opens_group)
    measure = MEASURES[column[1]]
    marks = _number_notes(list(_list_remarks(figure)), notes)
    if figure.value is None:
        return Cell("n/a", None, is_best=False, marks=marks, details=[], opens_group=opens_group)
    text = measure.format(figure.value)
    is_best = best is not None and measure.format(best) == text
    return Cell(text, figure.value, is_best, marks, _list_details(entry, column, board), opens_group)


def _list_remarks(figure: Figure) -> Iterator[str]:
    """List the remarks on a figure. Why there is no interval is one footnote for all metrics."""
    title = MEASURES[figure.metric].title
    remark, mark, reason = (figure.note or "").partition(_NO_INTERVAL)
    if remark := remark.removesuffix("; "):
        yield f"{title}: {remark}"
    if reason:
        yield mark + reason
    if figure.n_infinite:
        yield f"{title}: {figure.n_infinite:,} equal to the truth (infinite, left out of the mean)"


def _list_details(entry: Entry, column: Column, board: Board) -> list[str]:
    """List the interval of a figure, and its sample count if it differs from that of the previous column."""
    figure = find_figure(entry, column)
    if figure is None:
        return []
    lines = []
    if figure.low is not None and figure.high is not None:
        measure = MEASURES[figure.metric]
        lines.append(f"{measure.format(figure.low)} to {measure.format(figure.high)}")
    place = board.columns.index(column)
    previous = None if _opens_group(board.columns, column) else find_figure(entry, board.columns[place - 1])
    if figure.n is not None and (previous is None or (previous.n, previous.n_missing) != (figure.n, figure.n_missing)):
        lines.append(f"n = {figure.n - figure.n_missing:,}")
        if figure.n_missing:
            lines.append(f"of {figure.n:,}")
    return lines


def _number_notes(notes: Sequence[str], known: dict[str, int]) -> list[int]:
    """Return the numbers of notes; equal notes of several rows share a number."""
    return sorted(known.setdefault(note, len(known) + 1) for note in notes)


def _opens_group(columns: Sequence[Column], column: Column) -> bool:
    place = columns.index(column)
    return place == 0 or columns[place - 1][0] != column[0]
