"""A board as tables: sorted as it is written, and sortable where scripts run."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from html import escape
from itertools import chain, groupby
from math import ceil
from typing import Final

from mirror_leaderboard.boards import FLOOR, Board, Column, find_figure
from mirror_leaderboard.entry import Entry, Figure, Reported
from mirror_leaderboard.measures import MEASURES

_SHIFT: Final = re.compile(r"(?:(left|right)-)?([0-9.]+)m")
_GROUPS: Final = {
    "training": "Training traversals",
    "novel": "Novel traversals",
    "all": "All",
    "reported": "Stated",
    "measured": "Measured here",
}


_MOST_COLUMNS: Final = 9
"""So many figures side by side fit a window of 1280 px."""


def board_table(board: Board) -> str:
    """The table, with the notes of its rows below; of many groups several tables, none wider than a window."""
    notes: dict[str, int] = {}
    parts = _parts(board.columns)
    tables = "".join(_table(board, part, notes, named=len(parts) > 1) for part in parts)
    listed = "".join(f"<li>{escape(note)}</li>" for note in notes)
    return tables + (f'<ol class="notes">{listed}</ol>' if notes else "")


def _parts(columns: Sequence[Column]) -> list[list[Column]]:
    """Columns of whole groups, as many groups together as fit; all parts about as wide."""
    groups = [list(own) for _, own in groupby(columns, key=lambda column: column[0])]
    each = max(_MOST_COLUMNS // max(map(len, groups)), 1)
    each = ceil(len(groups) / ceil(len(groups) / each))
    return [list(chain(*groups[start : start + each])) for start in range(0, len(groups), each)]


def _table(board: Board, part: Sequence[Column], notes: dict[str, int], *, named: bool) -> str:
    best = {column: board.best(column) for column in part}
    rows = "".join(_row(entry, board, part, best, notes) for entry in board.entries)
    caption = f"{board.protocol}, {board.title}"
    if named:
        caption += ": " + ", ".join(group_title(group) for group in dict.fromkeys(group for group, _ in part))
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(caption)}"><table class="board">'
        f'<caption class="hidden">{escape(caption)}; heads of columns sort</caption>'
        f"<thead>{_heads(board, part)}</thead><tbody>{rows}</tbody></table></div>"
    )


def group_title(group: str) -> str:
    """What a group is called on the page."""
    shift = _SHIFT.fullmatch(group)
    if shift is not None:
        return " ".join(filter(None, (shift[2], "m", shift[1])))
    return _GROUPS.get(group, group.replace("-", " "))


def _heads(board: Board, part: Sequence[Column]) -> str:
    spans = [(group, len(list(columns))) for group, columns in groupby(part, key=lambda column: column[0])]
    top = "".join(
        f'<th colspan="{count}" scope="colgroup" class="group">{escape(group_title(group))}</th>'
        for group, count in spans
    )
    heads = "".join(_head(column, board) for column in part)
    return (
        f'<tr><th rowspan="2" scope="col" class="method"><button type="button">Method</button></th>{top}'
        f'<th rowspan="2" scope="col" class="source">Source</th></tr><tr>{heads}</tr>'
    )


def _head(column: Column, board: Board) -> str:
    measure = MEASURES[column[1]]
    downwards = "descending" if measure.better == "higher" else "ascending"
    sort = f' aria-sort="{downwards}"' if column == board.ranked_by else ""
    first = " first" if _opens_group(board.columns, column) else ""
    return (
        f'<th scope="col" class="n{first}" data-better="{measure.better}"{sort}>'
        f'<button type="button" title="{escape(measure.about)}; {measure.better} is better">'
        f'{escape(measure.head)} <span aria-hidden="true">{measure.arrow}</span></button></th>'
    )


def _row(
    entry: Entry, board: Board, part: Sequence[Column], best: dict[Column, float | None], notes: dict[str, int]
) -> str:
    name = escape(entry.method)
    if entry.link:
        name = f'<a href="{escape(entry.link)}" rel="nofollow noopener">{name}</a>'
    floor = '<span class="tag floor">floor</span>' if entry.method in FLOOR else ""
    setting = f"<small>{escape(entry.setting)}</small>" if entry.setting else ""
    # What nobody has a value of has no column.
    bare = [one for one in entry.figures if (one.group, one.metric) not in board.columns]
    lacking = dict.fromkeys(f"{MEASURES[one.metric].title}: {one.note}" for one in bare)
    marks = _marks([*entry.notes, *lacking], notes)
    cells = "".join(_cell(entry, column, board, best[column], notes) for column in part)
    key = escape(entry.method.lower())
    head = f'<th scope="row" class="method" data-value="{key}">{name}{marks} {floor}{setting}</th>'
    return f'<tr>{head}{cells}<td class="source">{_source(entry)}</td></tr>'


def _cell(entry: Entry, column: Column, board: Board, best: float | None, notes: dict[str, int]) -> str:
    first = " first" if _opens_group(board.columns, column) else ""
    figure = find_figure(entry, column)
    if figure is None:
        return f'<td class="n{first}"><span class="dim" aria-label="none">–</span></td>'
    measure = MEASURES[column[1]]
    marks = _marks(list(_remarks(figure)), notes)
    if figure.value is None:
        return f'<td class="n{first}"><span class="dim">n/a</span>{marks}</td>'
    shown = measure.shown(figure.value)
    if best is not None and measure.shown(best) == shown:
        shown = f"<b>{shown}</b>"
    return f'<td class="n{first}" data-value="{figure.value!r}">{shown}{marks}{_below(entry, column, board)}</td>'


def _remarks(figure: Figure) -> Iterator[str]:
    measure = MEASURES[figure.metric]
    if figure.note:
        yield f"{measure.title}: {figure.note}"
    if figure.n_infinite:
        yield f"{measure.title}: equal to the truth, infinite and not in the mean: {figure.n_infinite:,}"


def _below(entry: Entry, column: Column, board: Board) -> str:
    """The interval; and of how many, where that differs from the column before."""
    figure = find_figure(entry, column)
    if figure is None:
        return ""
    lines = []
    if figure.low is not None and figure.high is not None:
        shown = MEASURES[figure.metric].shown
        lines.append(f"{shown(figure.low)} to {shown(figure.high)}")
    place = board.columns.index(column)
    before = None if _opens_group(board.columns, column) else find_figure(entry, board.columns[place - 1])
    if figure.n is not None and (before is None or (before.n, before.n_missing) != (figure.n, figure.n_missing)):
        lines.append(f"n = {figure.n - figure.n_missing:,}" + (f" of {figure.n:,}" if figure.n_missing else ""))
    return "".join(f"<small>{line}</small>" for line in lines)


def _marks(notes: Sequence[str], known: dict[str, int]) -> str:
    """Numbers of notes; a note that other rows have too keeps its number."""
    numbers = sorted(known.setdefault(note, len(known) + 1) for note in notes)
    return f"<sup>{','.join(map(str, numbers))}</sup>" if numbers else ""


def _source(entry: Entry) -> str:
    if isinstance(entry, Reported):
        paper = entry.paper
        return (
            f'<span class="tag reported">reported</span><small>{escape(paper.title)}, Table {paper.table}, '
            f"“{escape(paper.row)}”</small>"
        )
    code = f'<code title="{entry.result_hash}">{entry.result_hash[:8]}</code>'
    return f'<span class="tag measured">measured</span><small>result {code}</small>'


def _opens_group(columns: Sequence[Column], column: Column) -> bool:
    place = columns.index(column)
    return place == 0 or columns[place - 1][0] != column[0]
