"""Compiled signed distance of points from the edge of an area."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mirror.arrays import Float64

# Segments in one bounding box: a box that is farther than the nearest segment so far is passed over whole.
_GROUP = 16


@njit(cache=True, nogil=True)
def _bounds(begins: Float64, ends: Float64) -> Float64:
    """Bounding boxes (G, 4) of groups of segments: least x, least y, largest x, largest y."""
    groups = (len(begins) + _GROUP - 1) // _GROUP
    bounds = np.empty((groups, 4))
    bounds[:, :2], bounds[:, 2:] = math.inf, -math.inf
    for segment in range(len(begins)):
        box = bounds[segment // _GROUP]
        for axis in range(2):
            box[axis] = min(box[axis], begins[segment, axis], ends[segment, axis])
            box[axis + 2] = max(box[axis + 2], begins[segment, axis], ends[segment, axis])
    return bounds


@njit(cache=True, nogil=True)
def signed_distances(points: Float64, begins: Float64, ends: Float64) -> Float64:
    """Distance (P,) of points (P, 2) from segments (S, 2) to (S, 2): positive inside (even-odd rule), else negative."""
    bounds = _bounds(begins, ends)
    found = np.empty(len(points))
    for point in range(len(points)):
        x, y = points[point, 0], points[point, 1]
        least, inside = math.inf, False
        for group in range(len(bounds)):
            box = bounds[group]
            gap_x, gap_y = max(box[0] - x, x - box[2], 0.0), max(box[1] - y, y - box[3], 0.0)
            # The ray of the even-odd rule goes from the point along x.
            if gap_x * gap_x + gap_y * gap_y >= least and not (box[1] <= y <= box[3] and box[2] >= x):
                continue
            for segment in range(group * _GROUP, min((group + 1) * _GROUP, len(begins))):
                ax, ay = begins[segment, 0] - x, begins[segment, 1] - y
                bx, by = ends[segment, 0] - x, ends[segment, 1] - y
                ux, uy = bx - ax, by - ay
                square = ux * ux + uy * uy
                share = min(max(-(ax * ux + ay * uy) / square, 0.0), 1.0) if square > 0.0 else 0.0
                nearest_x, nearest_y = ax + share * ux, ay + share * uy
                least = min(least, nearest_x * nearest_x + nearest_y * nearest_y)
                if (ay > 0.0) != (by > 0.0) and (ax * by - ay * bx > 0.0) == (by > ay):
                    inside = not inside
        found[point] = math.sqrt(least) if inside else -math.sqrt(least)
    return found
