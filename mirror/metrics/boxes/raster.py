"""Polygons as pixels: a pixel belongs to a polygon if its centre does."""

from __future__ import annotations

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.errors import UsageError
from mirror.metrics.inputs import Numbers, as_numbers


def polygon_mask(polygon_px: Numbers, width_px: int, height_px: int) -> Bool:
    """Return the pixels whose centres a polygon holds.

    The pixel in column ``c`` and row ``r`` has its centre at ``(c + 0.5, r + 0.5)``. Centres on an upper or left side
    are in, those on a lower or right one are not, so that polygons which share a side share no pixel and leave none
    out. The count of pixels is therefore an unbiased estimate of the area, unlike that of fillers which draw the
    outline too.

    Args:
        polygon_px: (K, 2) corners in order, in pixels, not necessarily within the raster or convex; where the outline
            crosses itself the even-odd rule holds. Fewer than three corners hold nothing.
        width_px: of the raster.
        height_px: of the raster.

    Returns:
        (height_px, width_px).

    Raises:
        UsageError: the shape is another, a corner is not finite (its row is named), or the raster's size is negative.
    """
    polygon = as_polygon(polygon_px)
    if width_px < 0 or height_px < 0:
        raise UsageError(f"raster of {width_px} x {height_px} pixels", expected="a size that is not negative")
    mask = np.zeros((height_px, width_px), dtype=np.bool_)
    if len(polygon) < 3:
        return mask
    from mirror.metrics.boxes.raster_kernels import fill

    fill(mask, np.ascontiguousarray(polygon))
    return mask


def as_polygon(polygon_px: Numbers) -> Float64:
    """Check the corners (K, 2) of a polygon, and return them.

    Raises:
        UsageError: the shape is another, or a corner is not finite; its row is named.
    """
    polygon = as_numbers(polygon_px, "polygon", np.float64)
    if polygon.size == 0:
        return polygon.reshape(0, 2)
    if polygon.ndim != 2 or polygon.shape[1] != 2:
        raise UsageError(f"polygon of shape {polygon.shape}", expected="(K, 2)")
    finite = np.isfinite(polygon).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise UsageError(
            f"corner {polygon[row].tolist()} of a polygon",
            place=f"row {row}",
            expected="two finite numbers, in pixels",
            remedy="clip the box at the near plane before it is projected, as mirror.geometry.project_boxes does",
        )
    return polygon
