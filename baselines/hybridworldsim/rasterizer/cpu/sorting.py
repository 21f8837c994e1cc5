"""Order by depth: a stable radix sort of float32 keys."""

from __future__ import annotations

from typing import Final

import numpy as np
from mirror.arrays import AnyArray, Float32, Int32

from hybridworldsim.rasterizer.cpu.kernels import kernel
from hybridworldsim.rasterizer.cpu.threads import in_parallel

_BITS: Final = 11
_BINS: Final = 1 << _BITS
_PARTS: Final = 8
_FEW: Final = 4096


def depth_order(depths: Float32) -> Int32:
    """The order (M,) of depths (M,), equal ones by index; 0 and above, not NaN."""
    count = len(depths)
    if count < _FEW:
        return np.argsort(depths, kind="stable").astype(np.int32)
    keys, order = depths.view(np.uint32), np.arange(count, dtype=np.int32)
    edges = np.linspace(0, count, _PARTS + 1).astype(np.int64)
    for shift in range(0, 32, _BITS):
        places = np.zeros((_PARTS, _BINS), np.int64)
        in_parallel(lambda part: _count(keys, edges[part], edges[part + 1], shift, places[part]), _PARTS)  # noqa: B023
        if places.sum(axis=0).max() == count:
            continue
        by_bin = np.cumsum(places.T.ravel()) - places.T.ravel()
        places = np.ascontiguousarray(by_bin.reshape(_BINS, _PARTS).T)
        sorted_keys, sorted_order = np.empty_like(keys), np.empty_like(order)
        in_parallel(
            lambda part: _scatter(  # noqa: B023
                keys, order, edges[part], edges[part + 1], shift, places[part], sorted_keys, sorted_order  # noqa: B023
            ),
            _PARTS,
        )
        keys, order = sorted_keys, sorted_order
    return order


@kernel()
def _count(keys: AnyArray, begin: int, end: int, shift: int, counts: AnyArray) -> None:
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
    for i in range(begin, end):
        bucket = (keys[i] >> np.uint32(shift)) & np.uint32(_BINS - 1)
        place = places[bucket]
        places[bucket] = place + 1
        sorted_keys[place], sorted_order[place] = keys[i], order[i]
