"""Search for known byte strings inside others, wherever they begin: in archives without compression, models, shards."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np

_WINDOW: Final = 8
_AROUND: Final = 32
_SHORTEST: Final = 4 * _AROUND
_DISTINCT: Final = 6
_BITS: Final = 20
_GOLDEN: Final = np.uint64(0x9E3779B97F4A7C15)


class _Anchor(NamedTuple):
    """One window of a byte string: its place there, the check sum of the bytes around it, and who it belongs to."""

    place: int
    around: int
    length: int
    sha256: str


class ByteSearch:
    """A search for byte strings that keeps only the SHA-256 and one window of eight bytes of each in memory.

    A table of one bit for each hash of a window decides for almost every place of the searched bytes; where it does
    not, a check sum of 64 bytes and then the SHA-256 of the whole string decide.
    """

    def __init__(self) -> None:
        self._anchors: dict[int, list[_Anchor]] = {}
        self._table = np.zeros(1 << _BITS, np.bool_)

    def add(self, data: bytes, sha256: str) -> None:
        """Add a byte string; strings below 128 bytes are not searched, as no image is so short."""
        if len(data) < _SHORTEST:
            return
        place = _distinct_place(data)
        window = int.from_bytes(data[place : place + _WINDOW], "little")
        anchor = _Anchor(place, zlib.crc32(data[place - _AROUND : place + _AROUND]), len(data), sha256)
        self._anchors.setdefault(window, []).append(anchor)
        self._table[_hash(np.array([window], np.uint64))] = True

    def find(self, data: bytes) -> Iterator[tuple[int, int, str]]:
        """Yield the first byte, length and SHA-256 of each added string that occurs in the given bytes."""
        if not self._anchors:
            return
        for phase in range(_WINDOW):
            count = (len(data) - phase) // _WINDOW
            if count <= 0:
                return
            windows = np.frombuffer(data, "<u8", count, phase)
            hits = np.flatnonzero(self._table[_hash(windows)])
            for number in hits.tolist():
                at = phase + number * _WINDOW
                for anchor in self._anchors.get(int(windows[number]), ()):
                    start = at - anchor.place
                    if start < 0 or start + anchor.length > len(data):
                        continue
                    if zlib.crc32(data[at - _AROUND : at + _AROUND]) != anchor.around:
                        continue
                    if hashlib.sha256(data[start : start + anchor.length]).hexdigest() == anchor.sha256:
                        yield start, anchor.length, anchor.sha256


def _distinct_place(data: bytes) -> int:
    """A place near the middle whose window has many different bytes, so that it is rare elsewhere."""
    middle = max(len(data) // 2, _AROUND)
    last = len(data) - _AROUND
    places = list(range(middle, last, 2 * _WINDOW)) or [min(middle, last)]
    best, most = places[0], 0
    for place in places[:64]:
        distinct = len(set(data[place : place + _WINDOW]))
        if distinct > most:
            best, most = place, distinct
        if distinct >= _DISTINCT:
            break
    return best


def _hash(windows: Any) -> Any:
    return (windows * _GOLDEN) >> np.uint64(64 - _BITS)
