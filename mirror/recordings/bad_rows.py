"""Rows of a recording that make no pose: dropped, and counted by reason, by every reader in the same way.

A reader marks such rows while it reads a table of poses, puts any value in their place, and takes them out of the track
at its end. How many of them a drive may have is for ingest to decide (`mirror.ingest.usable`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np

from mirror.arrays import Bool, Int64, UInt8
from mirror.errors import RecordingError

if TYPE_CHECKING:
    from mirror.recordings.protocol import Track

Reason = Literal["cells", "number", "time", "rotation", "sigma"]
"""A line with too few or too many cells; a cell that is no number; no stamp; no rotation; no standard deviation."""
REASONS: Final[tuple[Reason, ...]] = get_args(Reason)


@dataclass(frozen=True)
class BadRows:
    """The K rows that were dropped from a track.

    Attributes:
        before: (K,) ascending; how many rows of the track come before each.
        reason: (K,) index into `REASONS`.
        first: the error of the first of them, which names its file and line.
    """

    before: Int64
    reason: UInt8
    first: RecordingError

    def __len__(self) -> int:
        return len(self.before)

    def counts(self) -> dict[str, int]:
        """How many, by reason."""
        return {REASONS[code]: count for code, count in sorted(Counter(self.reason.tolist()).items())}


class RowFaults:
    """Marks the rows of a table that make no pose; the first reason found for a row stands.

    Args:
        count: rows of the table.
        torn: rows of the file that are not in the table: how many rows of the table come before each, and its error.
        reason: why they are not.
    """

    def __init__(self, count: int, torn: Sequence[tuple[int, RecordingError]] = (), reason: Reason = "cells") -> None:
        self._code: UInt8 = np.zeros(count, np.uint8)
        self._torn: Int64 = np.array([before for before, _ in torn], np.int64)
        self._torn_code: UInt8 = np.full(len(torn), REASONS.index(reason), np.uint8)
        self._first = torn[0] if torn else None

    @property
    def good(self) -> Bool:
        """(N,) rows that are not marked."""
        return self._code == 0

    def add(self, bad: Bool, reason: Reason, error: Callable[[int], RecordingError]) -> None:
        """Mark rows.

        Args:
            bad: (N,) rows that make no pose.
            reason: why.
            error: the error of a row, asked for once.
        """
        new = bad & self.good
        if not new.any():
            return
        row = int(np.argmax(new))
        if self._first is None or row < self._first[0]:
            self._first = row, error(row)
        self._code[new] = 1 + REASONS.index(reason)

    def drop_from(self, track: Track) -> Track:
        """The track without the marked rows, which stand in its ``bad`` beside those dropped before.

        Args:
            track: one row for each row of the table.
        """
        if self._first is None:
            return track
        good = self.good
        kept = np.concatenate([[0], np.cumsum(good)])
        marked = np.flatnonzero(~good)
        before, reason, first = [marked, self._torn], [self._code[marked] - 1, self._torn_code], None
        if track.bad is not None:
            before, reason, first = [*before, track.bad.before], [*reason, track.bad.reason], track.bad.first
        places = kept[np.concatenate(before)]
        order = np.argsort(places, kind="stable")
        bad = BadRows(places[order], np.concatenate(reason)[order], first or self._first[1])
        columns: dict[str, Any] = {
            field.name: value[good]
            for field in fields(track)
            if isinstance(value := getattr(track, field.name), np.ndarray)
        }
        return replace(track, **columns, bad=bad)
