"""Convex polygons in an image: their part within it, their area, and how much of them is seen.

`mirror.geometry.project_boxes(...).hull(row)` gives the polygon of a box, cut at the near plane.
"""

from __future__ import annotations

import numpy as np

from mirror.arrays import Float64
from mirror.metrics.boxes.raster import as_polygon
from mirror.metrics.inputs import Numbers


def clip_to_image(polygon_px: Numbers, width_px: int, height_px: int) -> Float64:
    """Return the part of a convex polygon within an image (Sutherland and Hodgman, Comm. ACM 17(1), 1974).

    Args:
        polygon_px: (K, 2) corners in order.
        width_px: of the image.
        height_px: of the image.

    Returns:
        (L, 2) corners in the same order; (0, 2) where nothing is within.

    Raises:
        UsageError: the shape is another, or a corner is not finite; its row is named.
    """
    polygon = as_polygon(polygon_px)
    for axis, line, beyond in ((0, 0.0, -1.0), (0, width_px, 1.0), (1, 0.0, -1.0), (1, height_px, 1.0)):
        outside = beyond * (polygon[:, axis] - line)
        kept: list[Float64] = []
        for index in range(len(polygon)):
            here, there = outside[index - 1], outside[index]
            start, end = polygon[index - 1], polygon[index]
            if (here > 0.0) != (there > 0.0):
                crossing = start + here / (here - there) * (end - start)
                crossing[axis] = line
                kept.append(crossing)
            if there <= 0.0:
                kept.append(end)
        polygon = np.array(kept).reshape(-1, 2)
    return polygon


def polygon_area(polygon_px: Numbers) -> float:
    """Return the area that a simple polygon encloses (shoelace, about its first corner), in square pixels.

    Raises:
        UsageError: the shape is another, or a corner is not finite; its row is named.
    """
    polygon = as_polygon(polygon_px)
    if len(polygon) < 3:
        return 0.0
    x, y = (polygon[1:] - polygon[0]).T
    return float(abs(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])) / 2.0)


def visible_share(polygon_px: Numbers, width_px: int, height_px: int) -> float:
    """Return the share of a convex polygon's area that lies within an image; NaN for a polygon without area.

    Raises:
        UsageError: the shape is another, or a corner is not finite; its row is named.
    """
    whole = polygon_area(polygon_px)
    if whole == 0.0:
        return float("nan")
    return min(polygon_area(clip_to_image(polygon_px, width_px, height_px)) / whole, 1.0)
