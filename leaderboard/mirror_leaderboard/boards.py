"""Boards: entries with the same protocol and dataset, ranked together only if they were measured in the same way."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Final, Literal

from mirror.metrics.catalogue import MEASURES
from mirror.protocols.document import Protocol, commit_to_secret, load_protocol, protocol_names
from mirror.protocols.ranking import ALL, Ranking
from mirror.schema.hashing import hash_document
from mirror_leaderboard.entry import COMMITMENT, Entry, Figure, Measured, Reported
from mirror_leaderboard.former import find_former
from mirror_leaderboard.ranks import BoardRanks, rank_rows

FLOOR: Final = ("nearest_frame", "smoothed_nearest_frame", "grey_frame", "camera_mean", "mean_color")
"""Baselines that only show recorded pixels: every method must beat them."""

FLOOR_OF_EDITS: Final = ("unmoved_recording", "erased_vehicle", "flat_patch")
"""Baselines that show no edit, for protocols that edit vehicles."""

_PUBLIC_SEED: Final = re.compile(r"\bseed \d+", re.IGNORECASE)

UNVERIFIED: Final = "unverified:"
STATED: Final = "stated:"
"""Options that separate the tables of entries that the organiser did not verify; their values say why."""

_OF_RENDERS: Final = {UNVERIFIED: "the renders were not scored again"}
_UNVERIFIED: Final = {
    "safety": {UNVERIFIED: "the controls were not driven again"},
    "editing-accuracy": {UNVERIFIED: "the regions are not those of the built-in extractor"},
    "runtime": {STATED: "by the submissions, not measured here"},
}

Column = tuple[str, str]
"""A group and a metric."""

_Options = tuple[tuple[str, str], ...]
_Key = tuple[str, str, str | None, tuple[str, ...] | None, _Options]


@dataclass(frozen=True)
class Board:
    """Comparable entries: the entries of one protocol and one set of data.

    Attributes:
        protocol: name of the protocol.
        title: name of the dataset, or a note that the paper does not state it.
        split: split of measured entries.
        hashes: hashes of the protocol, the dataset and the plan (where it is known), for measured entries.
        options: other options that determine the figures.
        entries: the rows, best first.
        columns: groups and metrics with a value in any entry, in the protocol's order.
    """

    protocol: str
    title: str
    split: str | None
    hashes: tuple[str, ...] | None
    options: _Options
    entries: tuple[Entry, ...]
    columns: tuple[Column, ...]

    @property
    def id(self) -> str:
        """Identifier for links within the page."""
        evidence = hash_document([self.split, self.hashes, self.options])
        words = [self.protocol, self.title, "" if self.hashes is None else evidence[:8]]
        return "-".join(re.sub("[^a-z0-9]", "-", word.lower()) for word in words if word)

    @property
    def is_older(self) -> bool:
        """Return whether the entries were measured by another version of the protocol than the present one."""
        return self.hashes is not None and _load_present(self.protocol, self.options).hash != self.hashes[0]

    @property
    def is_practice(self) -> bool:
        """Return whether the board's seed is public, so that anybody can make the scored images."""
        return self.hashes is not None and _PUBLIC_SEED.search(self.title) is not None

    @property
    def version(self) -> int | None:
        """Version of the protocol that measured the entries; None for reported entries and unknown versions."""
        if self.hashes is None:
            return None
        protocol = _load_present(self.protocol, self.options)
        if protocol.hash == self.hashes[0]:
            return protocol.version
        former = find_former(self.hashes[0])
        return None if former is None else former.version

    @cached_property
    def ranked_by(self) -> Column:
        """The column that the rows are sorted by."""
        return _select_rank_column(_find_ranking(self.protocol, self.hashes, self.options), self.columns, self.entries)

    @cached_property
    def ranks(self) -> BoardRanks | None:
        """The ranks of the rows; None for reported entries, and if the sorting column does not rank."""
        ranking = _find_ranking(self.protocol, self.hashes, self.options)
        if self.hashes is None or ranking is None or self.ranked_by != ranking.column:
            return None
        values = [
            find_value(entry, self.ranked_by) if ranking.passes_gate(partial(find_value, entry)) else None
            for entry in self.entries
        ]
        better: Literal["higher", "lower"] = "lower" if MEASURES[self.ranked_by[1]].better == "lower" else "higher"
        cluster = "scenario" if load_protocol(self.protocol).task == "safety" else "scene"
        return rank_rows(self.entries, values, better, cluster)

    def best(self, column: Column) -> float | None:
        """Return the best value of a column; None if fewer than two entries have a value.

        A figure that can be forged has none where another figure ranks.
        """
        if MEASURES[column[1]].forgeable and not MEASURES[self.ranked_by[1]].forgeable:
            return None
        values = [value for entry in self.entries if (value := find_value(entry, column)) is not None]
        if len(values) < 2:
            return None
        return max(values) if MEASURES[column[1]].better == "higher" else min(values)


def make_boards(entries: Iterable[Entry]) -> list[Board]:
    """Group entries into boards by protocol: first measured entries, then older versions, then figures from papers."""
    groups: dict[_Key, list[Entry]] = {}
    for entry in entries:
        groups.setdefault(_board_key(entry), []).append(entry)
    order = {name: place for place, name in enumerate(_protocol_order())}

    def sort_key(key: _Key) -> tuple[object, ...]:
        protocol, title, split, hashes, options = key
        is_older = hashes is not None and hashes[0] != _load_present(protocol, options).hash
        return order[protocol], hashes is None, is_older, title, split or "", hashes or (), options

    keys = sorted(groups, key=sort_key)
    return [_make_board(key, groups[key]) for key in keys]


def find_value(entry: Entry, column: Column) -> float | None:
    """Return an entry's value in a column; None if it has none."""
    figure = find_figure(entry, column)
    return None if figure is None else figure.value


def find_figure(entry: Entry, column: Column) -> Figure | None:
    """Return an entry's figure in a column; None if it has none."""
    return next((figure for figure in entry.figures if (figure.group, figure.metric) == column), None)


def seconds_per_image(entry: Entry, entries: Sequence[Entry]) -> float | None:
    """Return a method's render time of an image; None if it is unknown.

    A measured entry states it. For a reported entry it is taken from the runtime table of the same paper, which is
    about the static scene: edited or generated images have none.
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


def _board_key(entry: Entry) -> _Key:
    if isinstance(entry, Reported):
        return (entry.protocol, entry.dataset or "Data set not stated", None, None, ())
    unverified = {} if entry.verified else _UNVERIFIED.get(load_protocol(entry.protocol).task, _OF_RENDERS)
    plan = () if entry.plan_hash is None else (entry.plan_hash,)
    hashes = (entry.protocol_hash, entry.dataset_hash, *plan)
    options = tuple(sorted({**entry.options, **unverified}.items()))
    return (entry.protocol, entry.dataset, entry.split, hashes, options)


def _make_board(key: _Key, entries: list[Entry]) -> Board:
    ranking = _find_ranking(key[0], key[3], key[4])
    columns = _list_columns(key[0], entries)
    rank_column = _select_rank_column(ranking, columns, entries)
    measure = MEASURES[rank_column[1]]

    def sort_key(entry: Entry) -> tuple[bool, bool, float, str]:
        value = find_value(entry, rank_column)
        is_ranked = ranking is None or ranking.passes_gate(lambda column: find_value(entry, column))
        sign = -1.0 if measure.better == "higher" else 1.0
        return (value is None, not is_ranked, 0.0 if value is None else sign * value, entry.method.lower())

    if key[3] is not None:
        columns = _lead_with(rank_column, columns)
    return Board(*key, tuple(sorted(entries, key=sort_key)), columns)


def _lead_with(rank_column: Column, columns: Sequence[Column]) -> tuple[Column, ...]:
    """Order columns so that the group that ranks comes first, and in it the metric that ranks."""
    return tuple(sorted(columns, key=lambda column: (column[0] != rank_column[0], column != rank_column)))


def _load_present(protocol: str, options: _Options) -> Protocol:
    """Load the present version of a protocol; of a test split, with the commitment that its entries state."""
    current, commitment = load_protocol(protocol), dict(options).get(COMMITMENT)
    if commitment is None or current.suite is None or current.suite.draw is None:
        return current
    return commit_to_secret(current, commitment)


def _find_ranking(protocol: str, hashes: tuple[str, ...] | None, options: _Options) -> Ranking | None:
    """Find the ranking key of the version of the protocol that measured the entries."""
    current = _load_present(protocol, options)
    if hashes is None or hashes[0] == current.hash:
        return current.ranking
    former = find_former(hashes[0])
    return None if former is None else former.ranking


def _select_rank_column(ranking: Ranking | None, columns: Sequence[Column], entries: Sequence[Entry]) -> Column:
    """Return the column that ranks, or the first column with the most values if no entry has a value in that."""
    if ranking is not None and any(find_value(entry, ranking.column) is not None for entry in entries):
        return ranking.column
    allowed = [column for column in columns if MEASURES[column[1]].may_rank] or columns
    return max(allowed, key=lambda column: sum(find_value(entry, column) is not None for entry in entries))


def _list_columns(protocol: str, entries: Iterable[Entry]) -> tuple[Column, ...]:
    figures = [figure for entry in entries for figure in entry.figures]
    with_value = [figure for figure in figures if figure.value is not None]
    columns = dict.fromkeys((figure.group, figure.metric) for figure in with_value or figures)
    groups = {group.name: place for place, group in enumerate(load_protocol(protocol).groups)}
    metrics = {name: place for place, name in enumerate(MEASURES)}

    def sort_key(column: Column) -> tuple[int, str, int]:
        return groups.get(column[0], len(groups)), column[0], metrics[column[1]]

    return tuple(sorted(columns, key=sort_key))


def _protocol_order() -> list[str]:
    first = ["static-reconstruction", "lane-shift", "vehicle-translation", "generation", "editing-accuracy"]
    return [*first, *(name for name in protocol_names() if name not in first)]
