"""Which parts of a track come near a region of interest: a hash grid over the ROIs, and one pass over the fixes.

All the rest of a fleet's driving is looked at once, here, and never again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from mirror.arrays import Float64, Int64, UInt8
from mirror.ingest.clean import RESTART
from mirror.ingest.metric import plane_error, scales, unwrap

_CELLS = 32
_NOWHERE = np.iinfo(np.int64).min


@dataclass(frozen=True)
class Grid:
    """A hash grid: cell -> the ROIs whose neighbourhood touches it.

    Attributes:
        origin: coordinates of cell (0, 0)'s corner.
        inverse: cells per unit of each coordinate.
        columns: cells round the globe, or 0 in a plane.
        keys: (H,) cell key of each slot, -1 for none; open addressing.
        begin: (H,) first entry in ``members`` of each slot.
        end: (H,) one behind the last.
        members: ROI numbers.
    """

    origin: tuple[float, float]
    inverse: tuple[float, float]
    columns: int
    keys: Int64
    begin: Int64
    end: Int64
    members: Int64


def build_grid(first: Float64, second: Float64, reach_m: Float64, geodetic: bool) -> Grid:
    """Build the grid.

    Args:
        first: (R,) ROI centres, longitude or x.
        second: (R,) ROI centres, latitude or y.
        reach_m: (R,) radius plus margin.
        geodetic: whether the coordinates are degrees.
    """
    metres = np.array([scales(float(value), geodetic) for value in second])
    half = np.column_stack([reach_m / metres[:, 0], reach_m / metres[:, 1]]) * 1.01
    if geodetic:
        # The circle is widest in longitude at its poleward side; one round the pole spans all longitudes.
        poleward = np.abs(second) + half[:, 1]
        across = np.array([scales(min(float(value), 90.0), True)[0] for value in poleward])
        half[:, 0] = np.where(poleward < 89.999, 1.01 * reach_m / np.maximum(across, 1e-3), 180.0).clip(max=180.0)
    cell = np.maximum(np.maximum(half.min(axis=0) * 0.5, half.max(axis=0) / _CELLS), 1e-9)
    columns = 0
    if geodetic:
        columns = max(1, int(360.0 / cell[0]))
        cell[0] = 360.0 / columns
    origin = (-180.0, -90.0) if geodetic else (float(first.min()), float(second.min()))
    cells: dict[int, list[int]] = {}
    for roi in range(len(first)):
        low = np.floor((np.array([first[roi], second[roi]]) - half[roi] - origin) / cell).astype(np.int64)
        high = np.floor((np.array([first[roi], second[roi]]) + half[roi] - origin) / cell).astype(np.int64)
        for column in range(low[0], min(high[0], low[0] + columns - 1 if columns else high[0]) + 1):
            wrapped = column % columns if columns else column
            for line in range(low[1], high[1] + 1):
                cells.setdefault(_key(wrapped, line), []).append(roi)
    slots = 1 << max(4, (4 * len(cells)).bit_length())
    keys, begin, end = np.full(slots, -1, np.int64), np.zeros(slots, np.int64), np.zeros(slots, np.int64)
    members: list[int] = []
    for key, rois in sorted(cells.items()):
        slot = _slot(key, slots)
        while keys[slot] != -1:
            slot = (slot + 1) & (slots - 1)
        keys[slot], begin[slot], end[slot] = key, len(members), len(members) + len(rois)
        members += rois
    return Grid(origin, (1.0 / cell[0], 1.0 / cell[1]), columns, keys, begin, end, np.array(members, np.int64))


@njit(cache=True, nogil=True, inline="always")
def _key(column: int, line: int) -> int:
    return ((column & 0x7FFFFFFF) << 31) | (line & 0x7FFFFFFF)


@njit(cache=True, nogil=True, inline="always")
def _slot(key: int, slots: int) -> int:
    mixed = (key ^ (key >> 29)) * 0x9E3779B1
    return (mixed ^ (mixed >> 15)) & (slots - 1)


@njit(cache=True, nogil=True)
def near(
    first: Float64,
    second: Float64,
    fate: UInt8,
    geodetic: bool,
    centre_first: Float64,
    centre_second: Float64,
    reach_m: Float64,
    origin: tuple[float, float],
    inverse: tuple[float, float],
    columns: int,
    keys: Int64,
    begin: Int64,
    end: Int64,
    members: Int64,
) -> Int64:
    """Stretches of kept fixes within reach of a ROI.

    Returns:
        (S, 3) ROI, first and last position; each stretch is one kept fix longer at both ends where there is one.
    """
    rois = len(centre_first)
    scale = np.empty((rois, 2))
    for roi in range(rois):
        scale[roi, 0], scale[roi, 1] = scales(centre_second[roi], geodetic)
    reach2 = np.empty(rois)
    for roi in range(rois):
        reach2[roi] = (reach_m[roi] * (1.0 + plane_error(centre_second[roi], reach_m[roi], geodetic))) ** 2
    begun, reached, ordinal_seen = np.empty(rois, np.int64), np.empty(rois, np.int64), np.full(rois, -2, np.int64)
    found = np.empty((256, 3), np.int64)
    count = 0
    slots = len(keys)
    cell_x, cell_y, cell_begin, cell_end = _NOWHERE, _NOWHERE, 0, 0
    ordinal, previous = 0, -1
    for position in range(len(first)):
        if fate[position] > RESTART:
            continue
        # Truncation is a floor but for places before the origin; those only meet ROIs that the next test refuses.
        x = int((first[position] - origin[0]) * inverse[0])
        y = int((second[position] - origin[1]) * inverse[1])
        if x != cell_x or y != cell_y:
            cell_x, cell_y, cell_begin, cell_end = x, y, 0, 0
            column = x - columns if columns and x >= columns else x
            key = _key(column, y)
            slot = _slot(key, slots)
            while keys[slot] != -1:
                if keys[slot] == key:
                    cell_begin, cell_end = begin[slot], end[slot]
                    break
                slot = (slot + 1) & (slots - 1)
        for member in range(cell_begin, cell_end):
            roi = members[member]
            dx = unwrap(first[position] - centre_first[roi], geodetic) * scale[roi, 0]
            dy = (second[position] - centre_second[roi]) * scale[roi, 1]
            if dx * dx + dy * dy > reach2[roi]:
                continue
            if ordinal_seen[roi] != ordinal - 1:
                if ordinal_seen[roi] >= 0:
                    if count == len(found):
                        found = np.concatenate((found, np.empty_like(found)))
                    found[count, 0], found[count, 1], found[count, 2] = roi, begun[roi], reached[roi]
                    count += 1
                begun[roi] = position if previous < 0 else previous
            reached[roi], ordinal_seen[roi] = position, ordinal
        previous = position
        ordinal += 1
    for roi in range(rois):
        if ordinal_seen[roi] >= 0:
            if count == len(found):
                found = np.concatenate((found, np.empty_like(found)))
            found[count, 0], found[count, 1], found[count, 2] = roi, begun[roi], reached[roi]
            count += 1
    for row in range(count):
        after = found[row, 2] + 1
        while after < len(first) and fate[after] > RESTART:
            after += 1
        if after < len(first):
            found[row, 2] = after
    return found[:count].copy()
