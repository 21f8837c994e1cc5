"""The tables of a board: sorted in the file, and sortable in a browser that runs scripts."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from html import escape
from itertools import chain, groupby
from math import ceil
from typing import Final

from mirror.metrics.catalogue import MEASURES
from mirror_leaderboard.boards import FLOOR, FLOOR_OF_EDITS, Board, Column, find_figure
from mirror_leaderboard.entry import Entry, Figure, Measured, Reported
from mirror_leaderboard.site.downloads import entry_file

_SHIFT: Final = re.compile(r"(?:(left|right)-)?([0-9.]+)m")
_GROUPS: Final = {
    "training": "Training traversals",
    "novel": "Novel traversals",
    "all": "All",
    "reported": "Stated",
    "measured": "Measured here",
}


_FORGEABLE: Final = (
    "not proof against forgery: a copy of the recording has the best distance of sets, a flat patch the best overlap"
)
_NO_INTERVAL: Final = "no interval: "

_MAX_COLUMNS: Final = 9
"""The number of usual columns that fits a window of 1280 px."""
_USUAL_HEAD: Final = 14
"""Letters of the longest head of a usual column."""


def board_table(board: Board, notes: dict[str, int]) -> str:
    """Format the table of a board; many groups are split into tables that fit a window.

    Args:
        board: the board.
        notes: numbers of the footnotes of its section; new ones are added.
    """
    # The table that ranks comes first.
    parts = sorted(_split_columns(board.columns), key=lambda part: board.ranked_by not in part)
    return "".join(_format_table(board, part, notes, named=len(parts) > 1) for part in parts)


def format_notes(notes: dict[str, int]) -> str:
    """Format the footnotes of a section, each once; empty if there are none.

    Without scripts the list stands below all tables of the section. The script puts it below the shown table, with the
    footnotes of this table alone, which keep their numbers.
    """
    items = "".join(f'<li value="{number}">{escape(note)}</li>' for note, number in notes.items())
    return f'<ol class="notes">{items}</ol>' if notes else ""


def _split_columns(columns: Sequence[Column]) -> list[list[Column]]:
    """Split columns into parts that fit a window, each with whole groups; a group that does not fit is cut."""
    groups = [
        piece for _, members in groupby(columns, key=lambda column: column[0]) for piece in _cut_group(list(members))
    ]
    widest = max(map(_find_width, groups))
    each = len(groups) if _find_width(columns) <= _MAX_COLUMNS else max(int(_MAX_COLUMNS // widest), 1)
    each = ceil(len(groups) / ceil(len(groups) / each))
    return [list(chain(*groups[start : start + each])) for start in range(0, len(groups), each)]


def _cut_group(columns: Sequence[Column]) -> list[list[Column]]:
    """Cut the columns of a group into pieces with similar numbers of columns that fit a window."""
    each = ceil(len(columns) / ceil(_find_width(columns) / _MAX_COLUMNS))
    return [list(columns[start : start + each]) for start in range(0, len(columns), each)]


def _find_width(columns: Sequence[Column]) -> float:
    """Find the width of columns, in usual ones: long heads take more."""
    return sum(max(1.0, max(map(len, _head_lines(MEASURES[metric].head))) / _USUAL_HEAD) for _, metric in columns)


def _head_lines(head: str) -> list[str]:
    """Return the lines of a column's head: the part of the image, as in ``PSNR, new hull (dB)``, has its own."""
    return head.split(", ")


def _format_table(board: Board, part: Sequence[Column], notes: dict[str, int], *, named: bool) -> str:
    best = {column: board.best(column) for column in part}
    rows = "".join(_format_row(entry, board, part, best, notes) for entry in board.entries)
    caption = f"{board.protocol}, {board.title}"
    if named:
        caption += ": " + ", ".join(group_title(group) for group in dict.fromkeys(group for group, _ in part))
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(caption)}"><table class="board">'
        f'<caption class="hidden">{escape(caption)}; the heads of columns sort the table</caption>'
        f"<thead>{_format_heads(board, part, notes)}</thead><tbody>{rows}</tbody></table></div>"
    )


def group_title(group: str) -> str:
    """Return the title of a group on the page."""
    shift = _SHIFT.fullmatch(group)
    if shift is not None:
        return " ".join(filter(None, (shift[2], "m", shift[1])))
    return _GROUPS.get(group, group.replace("-", " "))


def _format_heads(board: Board, part: Sequence[Column], notes: dict[str, int]) -> str:
    spans = [(group, len(list(columns))) for group, columns in groupby(part, key=lambda column: column[0])]
    top = "".join(
        f'<th colspan="{count}" scope="colgroup" class="group">{escape(group_title(group))}</th>'
        for group, count in spans
    )
    heads = "".join(_format_head(column, board, notes) for column in part)
    return (
        f'<tr><th rowspan="2" scope="col" class="method"><button type="button">Method</button></th>{top}'
        f'<th rowspan="2" scope="col" class="source">Source</th></tr><tr>{heads}</tr>'
    )


def _format_head(column: Column, board: Board, notes: dict[str, int]) -> str:
    measure = MEASURES[column[1]]
    direction = "descending" if measure.better == "higher" else "ascending"
    sort = f' aria-sort="{direction}"' if column == board.ranked_by else ""
    first = " first" if _opens_group(board.columns, column) else ""
    marks = _format_marks([_FORGEABLE] if measure.forgeable else [], notes)
    lines = ",<br>".join(map(escape, _head_lines(measure.head)))
    return (
        f'<th scope="col" class="n{first}" data-better="{measure.better}"{sort}>'
        f'<button type="button" title="{escape(measure.about)}; {measure.better} is better">'
        f'{lines}{marks} <span aria-hidden="true">{measure.arrow}</span></button></th>'
    )


def _format_row(
    entry: Entry, board: Board, part: Sequence[Column], best: dict[Column, float | None], notes: dict[str, int]
) -> str:
    name = escape(entry.method)
    if entry.link:
        name = f'<a href="{escape(entry.link)}" rel="nofollow noopener">{name}</a>'
    floor = '<span class="tag floor">floor</span>' if entry.method in (*FLOOR, *FLOOR_OF_EDITS) else ""
    details = ", ".join(_list_variant(entry, board))
    setting = f"<small>{escape(details)}</small>" if details else ""
    # A metric without any value has no column: its notes are shown with the row.
    without_column = [figure for figure in entry.figures if (figure.group, figure.metric) not in board.columns]
    metric_notes = dict.fromkeys(f"{MEASURES[figure.metric].title}: {figure.note}" for figure in without_column)
    marks = _format_marks([*entry.notes, *metric_notes], notes)
    cells = "".join(_format_cell(entry, column, board, best[column], notes) for column in part)
    key = escape(entry.method.lower())
    head = f'<th scope="row" class="method" data-value="{key}">{name}{marks} {floor}{setting}</th>'
    return f'<tr>{head}{cells}<td class="source">{_format_source(entry)}</td></tr>'


def _list_variant(entry: Entry, board: Board) -> Iterator[str]:
    """List what tells the row from others of its method: the version if another is on the board, the setting."""
    others = {other.version for other in board.entries if isinstance(other, Measured) and other.method == entry.method}
    if isinstance(entry, Measured) and len(others) > 1:
        yield f"version {entry.version}"
    if entry.setting:
        yield entry.setting


def _format_cell(entry: Entry, column: Column, board: Board, best: float | None, notes: dict[str, int]) -> str:
    first = " first" if _opens_group(board.columns, column) else ""
    figure = find_figure(entry, column)
    if figure is None:
        return f'<td class="n{first}"><span class="dim" aria-label="none">–</span></td>'
    measure = MEASURES[column[1]]
    marks = _format_marks(list(_list_remarks(figure)), notes)
    if figure.value is None:
        return f'<td class="n{first}"><span class="dim">n/a</span>{marks}</td>'
    text = measure.format(figure.value)
    if best is not None and measure.format(best) == text:
        text = f"<b>{text}</b>"
    details = _format_details(entry, column, board)
    return f'<td class="n{first}" data-value="{figure.value!r}">{text}{marks}{details}</td>'


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


def _format_details(entry: Entry, column: Column, board: Board) -> str:
    """Format the interval of a figure, and its sample count if it differs from that of the previous column."""
    figure = find_figure(entry, column)
    if figure is None:
        return ""
    lines = []
    if figure.low is not None and figure.high is not None:
        measure = MEASURES[figure.metric]
        lines.append(f"{measure.format(figure.low)} to {measure.format(figure.high)}")
    place = board.columns.index(column)
    previous = None if _opens_group(board.columns, column) else find_figure(entry, board.columns[place - 1])
    if figure.n is not None and (previous is None or (previous.n, previous.n_missing) != (figure.n, figure.n_missing)):
        lines.append(f"n = {figure.n - figure.n_missing:,}" + (f" of {figure.n:,}" if figure.n_missing else ""))
    return "".join(f"<small>{line}</small>" for line in lines)


def _format_marks(notes: Sequence[str], known: dict[str, int]) -> str:
    """Format the numbers of notes; equal notes of several rows share a number."""
    numbers = sorted(known.setdefault(note, len(known) + 1) for note in notes)
    return f"<sup>{','.join(map(str, numbers))}</sup>" if numbers else ""


def _format_source(entry: Entry) -> str:
    link = f'<a href="{escape(entry_file(entry))}">entry</a>'
    if isinstance(entry, Reported):
        paper = entry.paper
        title = f'<a href="{escape(paper.url)}" rel="nofollow noopener">{escape(paper.title)}</a>'
        return (
            f'<span class="tag reported">reported</span> <time datetime="{paper.date}">{paper.date}</time>'
            f"<small>{title}, Table {paper.table}, “{escape(paper.row)}” · {link}</small>"
        )
    code = f'<code title="{entry.result_hash}">{entry.result_hash[:8]}</code>'
    day = "" if entry.added is None else f' <time datetime="{entry.added}">{entry.added}</time>'
    return f'<span class="tag measured">measured</span>{day}<small>result {code} · {link}</small>'


def _opens_group(columns: Sequence[Column], column: Column) -> bool:
    place = columns.index(column)
    return place == 0 or columns[place - 1][0] != column[0]
