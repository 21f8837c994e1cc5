"""Compiled search for the parts of a track near a region of interest (ROI): a hash grid and one loop over the fixes.

Later steps read only the parts that this search returns.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.compiled import compiled_above
from mirror.ingest.fix_status import RESTART, Fixes
from mirror.ingest.metric import PLAIN_ELEMENTS, plane_error, scales, unwrap

_CELLS = 32
_NOWHERE = np.iinfo(np.int64).min


class Circles(NamedTuple):
    """R circles: the ROIs of one coordinate frame.

    Attributes:
        lon_or_x: (R,) longitudes of the centres in degrees, or x in metres.
        lat_or_y: (R,) latitudes of the centres in degrees, or y in metres.
        radius_m: (R,) radii.
    """

    lon_or_x: Float64
    lat_or_y: Float64
    radius_m: Float64


class Grid(NamedTuple):
    """A hash grid that maps each cell to the circles that may touch it.

    Attributes:
        origin: coordinates of the corner of cell (0, 0).
        inverse: cells per unit of each coordinate.
        columns: number of cells round the globe; 0 in a plane.
        keys: (H,) key of the cell in each slot of the hash table, -1 for an empty slot; open addressing.
        begin: (H,) index in ``members`` of the first circle of each slot.
        end: (H,) index after the last circle of each slot.
        members: numbers of circles.
    """

    origin: tuple[float, float]
    inverse: tuple[float, float]
    columns: int
    keys: Int64
    begin: Int64
    end: Int64
    members: Int64


def build_grid(circles: Circles, geodetic: bool) -> Grid:
    """Build the grid.

    Args:
        circles: at least one.
        geodetic: whether the coordinates are degrees.
    """
    lon_or_x, lat_or_y, reach_m = circles
    metres = np.array([scales(float(value), geodetic) for value in lat_or_y])
    half = np.column_stack([reach_m / metres[:, 0], reach_m / metres[:, 1]]) * 1.01
    if geodetic:
        # A circle is widest in longitude on its poleward side; a circle that contains a pole spans all longitudes.
        poleward = np.abs(lat_or_y) + half[:, 1]
        across = np.array([scales(min(float(value), 90.0), True)[0] for value in poleward])
        half[:, 0] = np.where(poleward < 89.999, 1.01 * reach_m / np.maximum(across, 1e-3), 180.0).clip(max=180.0)
    cell = np.maximum(np.maximum(half.min(axis=0) * 0.5, half.max(axis=0) / _CELLS), 1e-9)
    columns = 0
    if geodetic:
        columns = max(1, int(360.0 / cell[0]))
        cell[0] = 360.0 / columns
    origin = (-180.0, -90.0) if geodetic else (float(lon_or_x.min()), float(lat_or_y.min()))
    cells: dict[int, list[int]] = {}
    for roi in range(len(lon_or_x)):
        low = np.floor((np.array([lon_or_x[roi], lat_or_y[roi]]) - half[roi] - origin) / cell).astype(np.int64)
        high = np.floor((np.array([lon_or_x[roi], lat_or_y[roi]]) + half[roi] - origin) / cell).astype(np.int64)
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


@compiled_above(PLAIN_ELEMENTS, inline="always")
def _key(column: int, line: int) -> int:
    return ((column & 0x7FFFFFFF) << 31) | (line & 0x7FFFFFFF)


@compiled_above(PLAIN_ELEMENTS, inline="always")
def _slot(key: int, slots: int) -> int:
    mixed = (key ^ (key >> 29)) * 0x9E3779B1
    return (mixed ^ (mixed >> 15)) & (slots - 1)


@compiled_above(PLAIN_ELEMENTS)
def candidate_stretches(fixes: Fixes, circles: Circles, grid: Grid) -> Int64:
    """Find the stretches of kept fixes within circles.

    Args:
        fixes: N fixes.
        circles: ROIs; the radii include a margin.
        grid: built from the same circles.

    Returns:
        (S, 3) number of the circle, first and last position. A stretch includes the kept fix before it and the kept
        fix after it where they exist.
    """
    _, lon_or_x, lat_or_y, status, geodetic = fixes
    centre_lon_or_x, centre_lat_or_y, reach_m = circles
    origin, inverse, columns, keys, begin, end, members = grid
    rois = len(centre_lon_or_x)
    scale = np.empty((rois, 2))
    for roi in range(rois):
        scale[roi, 0], scale[roi, 1] = scales(centre_lat_or_y[roi], geodetic)
    reach2 = np.empty(rois)
    for roi in range(rois):
        reach = reach_m[roi] * (1.0 + plane_error(centre_lat_or_y[roi], reach_m[roi], geodetic))
        reach2[roi] = reach * reach
    begun, reached, last_ordinal = np.empty(rois, np.int64), np.empty(rois, np.int64), np.full(rois, -2, np.int64)
    stretches = np.empty((256, 3), np.int64)
    count = 0
    slots = len(keys)
    cell_x, cell_y, cell_begin, cell_end = _NOWHERE, _NOWHERE, 0, 0
    ordinal, previous = 0, -1
    for position in range(len(lon_or_x)):
        if status[position] > RESTART:
            continue
        # Truncation differs from the floor only before the origin; circles found there fail the distance test below.
        x = int((lon_or_x[position] - origin[0]) * inverse[0])
        y = int((lat_or_y[position] - origin[1]) * inverse[1])
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
            dx = unwrap(lon_or_x[position] - centre_lon_or_x[roi], geodetic) * scale[roi, 0]
            dy = (lat_or_y[position] - centre_lat_or_y[roi]) * scale[roi, 1]
            if dx * dx + dy * dy > reach2[roi]:
                continue
            if last_ordinal[roi] != ordinal - 1:
                if last_ordinal[roi] >= 0:
                    if count == len(stretches):
                        stretches = np.concatenate((stretches, np.empty_like(stretches)))
                    stretches[count, 0], stretches[count, 1], stretches[count, 2] = roi, begun[roi], reached[roi]
                    count += 1
                begun[roi] = position if previous < 0 else previous
            reached[roi], last_ordinal[roi] = position, ordinal
        previous = position
        ordinal += 1
    for roi in range(rois):
        if last_ordinal[roi] >= 0:
            if count == len(stretches):
                stretches = np.concatenate((stretches, np.empty_like(stretches)))
            stretches[count, 0], stretches[count, 1], stretches[count, 2] = roi, begun[roi], reached[roi]
            count += 1
    for row in range(count):
        after = stretches[row, 2] + 1
        while after < len(lon_or_x) and status[after] > RESTART:
            after += 1
        if after < len(lon_or_x):
            stretches[row, 2] = after
    return stretches[:count].copy()
