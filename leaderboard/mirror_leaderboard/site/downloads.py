"""Files beside the page: the table of each board as CSV, its ranks as JSON, and each entry with its signature."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Final

from mirror.metrics.catalogue import MEASURES
from mirror.metrics.images.bootstrap import CONFIDENCE
from mirror.schema.csv_files import encode_csv
from mirror_leaderboard.boards import Board, find_figure
from mirror_leaderboard.entry import Entry, Measured
from mirror_leaderboard.ranks import Rank

CSV_FOLDER: Final = "csv"
RANK_FOLDER: Final = "ranks"
ENTRY_FOLDER: Final = "rows"
"""Not `entries`, which marks a folder as a board."""


def csv_file(board: Board) -> str:
    """Return the file of a board's table, relative to the site."""
    return f"{CSV_FOLDER}/{board.id}.csv"


def rank_file(board: Board) -> str:
    """Return the file of a board's ranks, relative to the site."""
    return f"{RANK_FOLDER}/{board.id}.json"


def entry_file(entry: Entry) -> str:
    """Return the file of an entry, relative to the site."""
    if isinstance(entry, Measured):
        return f"{ENTRY_FOLDER}/{entry.result_hash}.json"
    words = (entry.paper.title, entry.paper.label, entry.dataset or "", entry.paper.row, entry.setting or "")
    name = "-".join("".join(c if c.isalnum() and c.isascii() else "-" for c in word.lower()) for word in words if word)
    return f"{ENTRY_FOLDER}/reported-{name}.json"


def encode_entry(entry: Entry) -> bytes:
    """Encode an entry in the form in which the board stores it."""
    return (json.dumps(entry.model_dump(mode="json"), indent=1, ensure_ascii=False) + "\n").encode()


def encode_board(board: Board) -> bytes:
    """Encode the table of a board, a row for each entry, in the order and the units of the page.

    Rows have their ranks with both ends of the interval. Each metric has four columns: value, both ends of its
    interval, and number of images.
    """
    header = [*_RANK, *_KEYS, *(name for column in board.columns for name in _list_heads(*column))]
    return encode_csv(
        header,
        (
            [rank.rank, rank.low, rank.high, *_list_keys(entry), *_list_numbers(entry, board)]
            for rank, entry in zip(_list_ranks(board), board.entries)
        ),
    )


def encode_ranks(board: Board) -> bytes:
    """Encode the ranks of a board: the figure that ranks, how the intervals were computed, and the rows."""
    group, metric = board.ranked_by
    ranks = board.ranks
    rows = [
        {
            "method": entry.method,
            "version": entry.version if isinstance(entry, Measured) else None,
            "setting": entry.setting,
            "value": None if figure is None else figure.value,
            "rank": rank.rank,
            "low": rank.low,
            "high": rank.high,
            "reason": rank.reason,
            "entry": entry_file(entry),
        }
        for rank, entry, figure in zip(
            _list_ranks(board), board.entries, (find_figure(entry, board.ranked_by) for entry in board.entries)
        )
    ]
    plain = {
        "protocol": board.protocol,
        "dataset": board.title,
        "split": board.split,
        "hashes": board.hashes,
        "options": dict(board.options),
        "ranked_by": {"group": group, "metric": metric, "better": MEASURES[metric].better},
        "intervals": None
        if ranks is None
        else {
            "confidence": CONFIDENCE if ranks.reason is None else None,
            "cluster": ranks.cluster,
            "n_clusters": ranks.n_clusters,
            "reason": ranks.reason,
        },
        "rows": rows,
    }
    return (json.dumps(plain, indent=1, ensure_ascii=False) + "\n").encode()


def _list_ranks(board: Board) -> Sequence[Rank]:
    return [Rank()] * len(board.entries) if board.ranks is None else board.ranks.rows


_RANK: Final = ("rank", "rank low", "rank high")
_KEYS: Final = ("kind", "method", "version", "setting", "date", "protocol", "dataset", "source")


def _list_keys(entry: Entry) -> Sequence[str]:
    if isinstance(entry, Measured):
        return (
            entry.kind,
            entry.method,
            entry.version,
            entry.setting or "",
            str(entry.added or ""),
            f"{entry.protocol} {entry.protocol_version}",
            f"{entry.dataset} {entry.dataset_hash[:8]}",
            entry.result_hash,
        )
    paper = entry.paper
    source = f"{paper.title}, Table {paper.table}, {paper.row}"
    return (entry.kind, entry.method, "", entry.setting or "", paper.date, entry.protocol, entry.dataset or "", source)


def _list_heads(group: str, metric: str) -> Iterator[str]:
    name = f"{group} {metric}"
    unit = MEASURES[metric].board_unit
    yield from (f"{name} {unit}".strip(), f"{name} low", f"{name} high", f"{name} n")


def _list_numbers(entry: Entry, board: Board) -> Iterator[float | None]:
    for column in board.columns:
        figure = find_figure(entry, column)
        scale = MEASURES[column[1]].scale
        for value in (None, None, None) if figure is None else (figure.value, figure.low, figure.high):
            yield None if value is None else value * scale
        yield None if figure is None else figure.n
