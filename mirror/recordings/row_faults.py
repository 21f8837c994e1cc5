"""Marks the rows of a recording that make no pose, and drops them from its track.

Every reader does this in the same way: it marks such rows while it reads a table of poses, puts any value in their
place, and takes them out of the track at the end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from mirror.arrays import Bool, Int64, UInt8
from mirror.errors import RecordingError
from mirror.recordings.bad_rows import REASONS, BadRows, Reason
from mirror.recordings.protocol import Track


class RowFaults:
    """Marks of the rows of a table that give no pose; the first reason found for a row is kept.

    Args:
        count: number of rows of the table.
        torn: rows of the file that are not in the table: the number of table rows that precede each, and its error.
        reason: the reason of the torn rows.
        repeats: (count,) number of rows of the file that equal each row and are not in the table; None: there are none.
    """

    def __init__(
        self,
        count: int,
        torn: Sequence[tuple[int, RecordingError]] = (),
        reason: Reason = "cells",
        repeats: Int64 | None = None,
    ) -> None:
        self._code: UInt8 = np.zeros(count, np.uint8)
        self._torn: Int64 = np.array([before for before, _ in torn], np.int64)
        self._torn_code: UInt8 = np.full(len(torn), REASONS.index(reason), np.uint8)
        self._first = torn[0] if torn else None
        self._repeats = repeats

    @property
    def good(self) -> Bool:
        """(N,) True where a row is not marked."""
        return self._code == 0

    def add(self, bad: Bool, reason: Reason, error: Callable[[int], RecordingError]) -> None:
        """Mark rows.

        Args:
            bad: (N,) rows that make no pose.
            reason: why they make none.
            error: gives the error of a row; called at most once.
        """
        new = bad & self.good
        if not new.any():
            return
        row = int(np.argmax(new))
        if self._first is None or row < self._first[0]:
            self._first = row, error(row)
        self._code[new] = 1 + REASONS.index(reason)

    def drop_from(self, track: Track) -> Track:
        """Remove marked rows and repeated rows from a track; add them to its ``bad`` and ``repeats``.

        Args:
            track: one row for each row of the table.
        """
        good = self.good
        if self._repeats is not None:
            track = replace(track, repeats=track.repeats + int(self._repeats[good].sum()))
        if self._first is None:
            return track
        kept = np.concatenate([[0], np.cumsum(good)])
        marked = np.flatnonzero(~good)
        if self._repeats is not None:
            marked = np.repeat(marked, 1 + self._repeats[marked])
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
