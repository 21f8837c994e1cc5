"""Follows the entropy-coded data of a JPEG (ITU T.81, F.2 and G.2) block by block, to find where the image ends in it.

Nothing is transformed: codes are decoded only to know how many bits belong to them. What lies between the last block of
a restart interval and the marker after it is no part of the image.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Int64, UInt8
from mirror.compiled import inner_njit

CUT, WRONG_CODE, WRONG_MARKER = -1, -2, -3
"""Reasons why a scan cannot be followed: it ends before its last block, has an impossible code, or another marker."""

_SEQUENTIAL, _DC_FIRST, _DC_NEXT, _AC_FIRST, _AC_NEXT = range(5)
# Positions in the state of the bit reader: next byte, current byte, its bits that are left, end-of-band run, error.
_AT, _BYTE, _LEFT, _RUN, _ERROR = range(5)
_LONGEST: Final = 16


@inner_njit
def _read_bit(data: UInt8, state: Int64) -> int:
    """The next bit; a marker in its place is an error."""
    if state[_LEFT] == 0:
        at = state[_AT]
        if at >= len(data):
            state[_ERROR] = CUT
            return 0
        step = 1
        if data[at] == 0xFF:
            if at + 1 >= len(data) or data[at + 1] != 0:
                state[_ERROR] = CUT
                return 0
            step = 2
        state[_AT], state[_BYTE], state[_LEFT] = at + step, data[at], 8
    state[_LEFT] -= 1
    return (state[_BYTE] >> state[_LEFT]) & 1


@inner_njit
def _read_bits(data: UInt8, state: Int64, count: int) -> int:
    value = 0
    for _ in range(count):
        value = 2 * value + _read_bit(data, state)
    return value


@inner_njit
def _read_symbol(data: UInt8, state: Int64, table: Int64, values: UInt8, used: UInt8) -> int:
    """Decode a code; ``table`` has the number of codes, the first code and its position, by length."""
    code = 0
    for length in range(1, _LONGEST + 1):
        code = 2 * code + _read_bit(data, state)
        if state[_ERROR] != 0:
            return 0
        offset = code - table[1, length]
        if offset >= 0 and offset < table[0, length]:
            place = table[2, length] + offset
            used[place] = 1
            return values[place]
    state[_ERROR] = WRONG_CODE
    return 0


@inner_njit
def _skip_block(
    data: UInt8,
    state: Int64,
    kind: int,
    first: int,
    last: int,
    tables: Int64,
    values: UInt8,
    used: UInt8,
    dc: int,
    ac: int,
    known: UInt8,
) -> None:
    """Pass over one block; ``known`` (64,) tells which of its coefficients are not zero, for progressive scans."""
    if kind == _DC_NEXT:
        _read_bit(data, state)
        return
    if kind in (_SEQUENTIAL, _DC_FIRST):
        size = _read_symbol(data, state, tables[dc], values[dc], used[dc])
        if size > 15:
            state[_ERROR] = WRONG_CODE
        _read_bits(data, state, size)
        if kind == _DC_FIRST:
            return
    k = max(first, 1)
    if kind == _AC_FIRST and state[_RUN] > 0:
        state[_RUN] -= 1
        return
    if kind != _AC_NEXT or state[_RUN] == 0:
        while k <= last and state[_ERROR] == 0:
            symbol = _read_symbol(data, state, tables[ac], values[ac], used[ac])
            zeros, size = symbol >> 4, symbol & 15
            if size == 0 and zeros < 15:
                if kind == _SEQUENTIAL:
                    return
                state[_RUN] = (1 << zeros) + _read_bits(data, state, zeros)
                if kind == _AC_FIRST:
                    state[_RUN] -= 1
                    return
                break
            if kind == _AC_NEXT:
                if size > 1:
                    state[_ERROR] = WRONG_CODE
                    return
                _read_bits(data, state, size)
                while k <= last:
                    if known[k] != 0:
                        _read_bit(data, state)
                    else:
                        zeros -= 1
                        if zeros < 0:
                            break
                    k += 1
                if size > 0:
                    if k > last:
                        state[_ERROR] = WRONG_CODE
                        return
                    known[k] = 1
                k += 1
                continue
            k += zeros
            if k > last:
                # A run of 16 zeros may end with the block, not beyond it.
                state[_ERROR] = WRONG_CODE
                return
            if size > 0:
                _read_bits(data, state, size)
                if kind == _AC_FIRST:
                    known[k] = 1
            k += 1
    if kind == _AC_NEXT and state[_RUN] > 0:
        while k <= last:
            if known[k] != 0:
                _read_bit(data, state)
            k += 1
        state[_RUN] -= 1


@njit(cache=True, nogil=True)
def follow_scan(
    data: UInt8,
    start: int,
    kind: int,
    first: int,
    last: int,
    units: int,
    interval: int,
    blocks: Int64,
    tables: Int64,
    values: UInt8,
    used: UInt8,
    known: UInt8,
    out: UInt8,
) -> tuple[int, int, int, int]:
    """Follow a scan of a JPEG, and copy the bytes that belong to the image.

    Args:
        data: the bytes of the file.
        start: position of the entropy-coded data.
        kind: 0 sequential; 1, 2 first and further bits of DC; 3, 4 first and further bits of AC coefficients.
        first: first coefficient of the scan.
        last: last coefficient of the scan.
        units: number of minimum coded units.
        interval: units from one restart marker to the next; 0: there are none.
        blocks: (B, 2) tables of DC and of AC of the blocks of a unit.
        tables: (T, 3, 17) number of codes, first code and its position, by length of the code.
        values: (T, 256) symbols by position.
        used: (T, 256) set to 1 where a symbol occurs.
        known: (units, 64) coefficients of the component that are not zero; for AC scans.
        out: takes the copied bytes; as long as ``data`` with 2 more for each interval.

    Returns:
        The position after the last byte that belongs to the image, or a reason why it cannot be followed; the number of
        copied bytes; the number of foreign bytes before restart markers; and whether the bits that fill up the last
        byte of an interval are neither all 0 nor all 1.
    """
    state = np.zeros(5, np.int64)
    state[_AT] = start
    begin, length, foreign, filled, number = start, 0, 0, 0, 0
    for unit in range(units):
        if interval > 0 and unit > 0 and unit % interval == 0:
            length, dirty = _copy_interval(data, begin, state, out, length)
            filled = max(filled, dirty)
            at = state[_AT]
            while at + 1 < len(data) and (data[at] != 0xFF or data[at + 1] == 0 or data[at + 1] == 0xFF):
                foreign += 1 if data[at] != 0xFF or data[at + 1] == 0 else 0
                at += 1
            if at + 1 >= len(data) or data[at + 1] != 0xD0 + number:
                return WRONG_MARKER, length, foreign, filled
            out[length], out[length + 1] = 0xFF, 0xD0 + number
            length += 2
            number = (number + 1) % 8
            state[:] = 0
            begin = at + 2
            state[_AT] = begin
        for block in range(len(blocks)):
            row = unit if kind >= _AC_FIRST else 0
            _skip_block(
                data, state, kind, first, last, tables, values, used, blocks[block, 0], blocks[block, 1], known[row]
            )
            if state[_ERROR] != 0:
                return state[_ERROR], length, foreign, filled
    length, dirty = _copy_interval(data, begin, state, out, length)
    return state[_AT], length, foreign, max(filled, dirty)


@inner_njit
def _copy_interval(data: UInt8, begin: int, state: Int64, out: UInt8, length: int) -> tuple[int, int]:
    """Copy an interval; the bits that fill up its last byte become 1, as T.81 has it."""
    end = state[_AT]
    count = end - begin
    # Not a slice: the error of shapes that differ takes three seconds to compile.
    for byte in range(count):
        out[length + byte] = data[begin + byte]
    length += count
    left = state[_LEFT]
    if left == 0 or count == 0:
        return length, 0
    mask = (1 << left) - 1
    is_stuffed = state[_BYTE] == 0xFF
    place = length - (2 if is_stuffed else 1)
    bits = out[place] & mask
    out[place] |= mask
    if out[place] == 0xFF and not is_stuffed:
        out[length] = 0
        length += 1
    return length, 0 if bits in (0, mask) else 1
