"""Sorts by depth: a stable radix sort of float32 keys."""

from __future__ import annotations

from typing import Final

import numpy as np

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.threads import in_parallel, spans
from mirror.arrays import AnyArray, Float32, Int32, Int64

_BITS: Final = 11
_BINS: Final = 1 << _BITS
_NUMPY_BELOW: Final = 4096


def depth_order(depths: Float32) -> Int32:
    """Compute the order (M,) of depths (M,) of at least 0, without NaN; equal depths are ordered by index."""
    count = len(depths)
    if count < _NUMPY_BELOW:
        return np.argsort(depths, kind="stable").astype(np.int32)
    keys, order = depths.view(np.uint32), np.arange(count, dtype=np.int32)
    edges = spans(count)
    for shift in range(0, 32, _BITS):
        keys, order = _sort_by_digit(keys, order, edges, shift)
    return order


def _sort_by_digit(keys: AnyArray, order: Int32, edges: Int64, shift: int) -> tuple[AnyArray, Int32]:
    """Sort by one digit, stably."""
    parts = len(edges) - 1
    counts = np.zeros((parts, _BINS), np.int64)
    in_parallel(lambda part: _count(keys, edges[part], edges[part + 1], shift, counts[part]), parts)
    if counts.sum(axis=0).max() == len(keys):
        return keys, order
    by_bin = counts.T.ravel()
    places = np.ascontiguousarray((np.cumsum(by_bin) - by_bin).reshape(_BINS, parts).T)
    sorted_keys, sorted_order = np.empty_like(keys), np.empty_like(order)

    def scatter(part: int) -> None:
        _scatter(keys, order, edges[part], edges[part + 1], shift, places[part], sorted_keys, sorted_order)

    in_parallel(scatter, parts)
    return sorted_keys, sorted_order


@kernel()
def _count(keys: AnyArray, begin: int, end: int, shift: int, counts: AnyArray) -> None:
    """Count the keys of each digit value."""
    for i in range(begin, end):
        counts[(keys[i] >> np.uint32(shift)) & np.uint32(_BINS - 1)] += 1


@kernel()
def _scatter(
    keys: AnyArray,
    order: Int32,
    begin: int,
    end: int,
    shift: int,
    places: AnyArray,
    sorted_keys: AnyArray,
    sorted_order: Int32,
) -> None:
    """Move keys to their sorted places."""
    for i in range(begin, end):
        bucket = (keys[i] >> np.uint32(shift)) & np.uint32(_BINS - 1)
        place = places[bucket]
        places[bucket] = place + 1
        sorted_keys[place], sorted_order[place] = keys[i], order[i]
