"""Undoes the filters of the rows of a PNG (ISO 15948, clause 9) whose pixels are bytes or parts of them."""

from __future__ import annotations

from numba import njit

from mirror.arrays import UInt8


@njit(cache=True, nogil=True)
def undo_filters(rows: UInt8) -> bool:
    """Undo the filters of rows of one byte per pixel, in place.

    Args:
        rows: (H, 1 + N) a filter and N bytes in each row; the filters become 0.

    Returns:
        Whether all filters exist.
    """
    for row in range(rows.shape[0]):
        kind = rows[row, 0]
        if kind > 4:
            return False
        for at in range(1, rows.shape[1]):
            left = int(rows[row, at - 1]) if at > 1 else 0
            up = int(rows[row - 1, at]) if row > 0 else 0
            corner = int(rows[row - 1, at - 1]) if row > 0 and at > 1 else 0
            guess = 0
            if kind == 1:
                guess = left
            elif kind == 2:
                guess = up
            elif kind == 3:
                guess = (left + up) // 2
            elif kind == 4:
                to_left, to_up, to_corner = abs(up - corner), abs(left - corner), abs(left + up - 2 * corner)
                guess = left if to_left <= to_up and to_left <= to_corner else up if to_up <= to_corner else corner
            rows[row, at] = (int(rows[row, at]) + guess) & 255
        rows[row, 0] = 0
    return True
