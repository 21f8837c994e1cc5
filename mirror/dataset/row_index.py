"""Rows of a table by an integer column: a search for each key, in place of a scan of the table."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from mirror.arrays import AnyArray, Int64


class RowIndex:
    """The rows of each value of a column.

    It keeps two integers for each row: a traversal has so many rows that a dictionary of lists would take more memory
    than the table.

    Args:
        values: (N,) the column.
    """

    def __init__(self, values: AnyArray) -> None:
        # Of another type, the column would be converted in each search.
        values = values.astype(np.int64, copy=False)
        self._order = np.argsort(values, kind="stable")
        self._sorted = values[self._order]

    def rows(self, value: int) -> Int64:
        """Return the rows (K,) of a value in ascending order; (0,) if the value does not occur."""
        first, end = np.searchsorted(self._sorted, value, "left"), np.searchsorted(self._sorted, value, "right")
        return self._order[first:end]

    @cached_property
    def distinct(self) -> Int64:
        """The values (M,) that occur, ascending."""
        return np.unique(self._sorted)

    @cached_property
    def step(self) -> float:
        """The median difference of neighbouring values; 0 with fewer than two values."""
        return float(np.median(np.diff(self.distinct))) if len(self.distinct) > 1 else 0.0

    def nearest(self, value: int) -> int | None:
        """Return the value that is nearest to a number, the smaller one on a tie; None if there are no values."""
        place = int(np.searchsorted(self.distinct, value))
        near = self.distinct[max(place - 1, 0) : place + 1]
        return int(near[np.argmin(np.abs(near - value))]) if len(near) else None
