"""Boards: entries of one protocol and one data set, side by side; only what was measured alike is ranked together."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from mirror.protocols.document import load_protocol, protocol_names
from mirror.schema.files import sha256_bytes
from mirror_leaderboard.entry import ALL, Entry, Figure, Measured, Reported
from mirror_leaderboard.measures import MEASURES, Measure

FLOOR: Final = ("nearest_frame", "mean_color")
"""Methods that show nothing but what was recorded: what every method must beat."""

Column = tuple[str, str]
"""Group and metric."""

_Options = tuple[tuple[str, str], ...]
_Key = tuple[str, str, str | None, tuple[str, str] | None, _Options]

_RANKED_BY: Final = {
    "static-reconstruction": ("novel", "psnr_cc"),
    "lane-shift": ("right-3m", "psnr_cc"),
    "vehicle-translation": ("0m", "fid"),
    "editing-accuracy": (ALL, "edit_iou_hull"),
}


@dataclass(frozen=True)
class Board:
    """Entries that answer the same question of the same data.

    Attributes:
        protocol: its name.
        title: the data set's name, or that the paper does not say.
        split: of measured entries.
        hashes: of the protocol and the data set, of measured entries.
        options: what else decides the figures.
        entries: the rows, best first.
        columns: groups and metrics that any of them has a value of, in the protocol's order.
    """

    protocol: str
    title: str
    split: str | None
    hashes: tuple[str, str] | None
    options: _Options
    entries: tuple[Entry, ...]
    columns: tuple[Column, ...]

    @property
    def id(self) -> str:
        """For links within the page."""
        evidence = json.dumps([self.split, self.hashes, self.options])
        words = [self.protocol, self.title, "" if self.hashes is None else sha256_bytes(evidence.encode())[:8]]
        return "-".join(re.sub("[^a-z0-9]", "-", word.lower()) for word in words if word)

    @cached_property
    def ranked_by(self) -> Column:
        """The column that rows are in the order of."""
        return _ranked_by(self.protocol, self.columns, self.entries)

    def best(self, column: Column) -> float | None:
        """The best value of a column; None: fewer than two entries have one."""
        values = [value for entry in self.entries if (value := find_value(entry, column)) is not None]
        if len(values) < 2:
            return None
        return max(values) if MEASURES[column[1]].better == "higher" else min(values)


def make_boards(entries: Iterable[Entry]) -> list[Board]:
    """The boards of entries, in the order of protocols; those with measured entries first."""
    together: dict[_Key, list[Entry]] = {}
    for entry in entries:
        together.setdefault(_key(entry), []).append(entry)
    order = {name: place for place, name in enumerate(_protocol_order())}
    keys = sorted(together, key=lambda key: (order[key[0]], key[3] is None, key[1], key[2] or "", key[3] or (), key[4]))
    return [_board(key, together[key]) for key in keys]


def find_value(entry: Entry, column: Column) -> float | None:
    """An entry's value in a column; None: it has none."""
    figure = find_figure(entry, column)
    return None if figure is None else figure.value


def find_figure(entry: Entry, column: Column) -> Figure | None:
    """An entry's figure in a column."""
    return next((one for one in entry.figures if (one.group, one.metric) == column), None)


def seconds_per_image(entry: Entry, entries: Sequence[Entry]) -> float | None:
    """How long a method renders a picture; None: nobody says.

    A measured entry says it itself. Of a reported one it stands in the same paper's own table: that of the static
    scene, which says nothing of edited or generated pictures.
    """
    if isinstance(entry, Measured):
        return None if entry.frames_per_second is None else 1.0 / entry.frames_per_second
    if load_protocol(entry.protocol).task != "reconstruction":
        return None
    for other in entries:
        if isinstance(other, Reported) and (other.method, other.paper.title) == (entry.method, entry.paper.title):
            rate = find_value(other, (ALL, "frames_per_second"))
            if rate:
                return 1.0 / rate
    return None


def _key(entry: Entry) -> _Key:
    if isinstance(entry, Reported):
        return (entry.protocol, entry.dataset or "Data set not stated", None, None, ())
    hashes, options = (entry.protocol_hash, entry.dataset_hash), tuple(sorted(entry.options.items()))
    return (entry.protocol, entry.dataset, entry.split, hashes, options)


def _board(key: _Key, entries: list[Entry]) -> Board:
    columns = _columns(key[0], entries)
    by = _ranked_by(key[0], columns, entries)
    measure = MEASURES[by[1]]
    rows = sorted(entries, key=lambda entry: _rank(entry, by, measure))
    return Board(*key, tuple(rows), columns)


def _rank(entry: Entry, by: Column, measure: Measure) -> tuple[bool, float, str]:
    value = find_value(entry, by)
    sign = -1.0 if measure.better == "higher" else 1.0
    return (value is None, 0.0 if value is None else sign * value, entry.method.lower())


def _ranked_by(protocol: str, columns: Sequence[Column], entries: Sequence[Entry]) -> Column:
    """The protocol's own column, else the first that most entries have."""
    chosen = _RANKED_BY.get(protocol)
    if chosen is not None and any(find_value(entry, chosen) is not None for entry in entries):
        return chosen
    return max(columns, key=lambda column: sum(find_value(entry, column) is not None for entry in entries))


def _columns(protocol: str, entries: Iterable[Entry]) -> tuple[Column, ...]:
    figures = [figure for entry in entries for figure in entry.figures]
    valued = [figure for figure in figures if figure.value is not None]
    found = dict.fromkeys((figure.group, figure.metric) for figure in valued or figures)
    groups = {group.name: place for place, group in enumerate(load_protocol(protocol).groups)}
    metrics = {name: place for place, name in enumerate(MEASURES)}
    return tuple(sorted(found, key=lambda column: (groups.get(column[0], len(groups)), column[0], metrics[column[1]])))


def _protocol_order() -> list[str]:
    first = ["static-reconstruction", "lane-shift", "vehicle-translation", "generation", "editing-accuracy"]
    return [*first, *(name for name in protocol_names() if name not in first)]
