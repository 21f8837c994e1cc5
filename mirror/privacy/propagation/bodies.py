"""What the bodies of vehicles hide from a camera: fewer points than their boxes would."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.geometry.poses import Poses
from mirror.privacy.propagation.mounts import category_words

_SOLID: Final = frozenset(("car", "van", "bus", "taxi"))
"""Trucks, trailers and pickups may be empty above their frames, and two-wheelers hide little."""
_ROUNDED_M: Final = 0.20
"""Corners are rounded, and widths of boxes hold the mirrors: the body is so much smaller at each side."""
_LOWER: Final = ((-0.5, -0.5, -0.40), (0.5, 0.5, 0.05))
"""Bounds of the body below the windows, in lengths, widths and heights of the box from its middle."""
_CABIN: Final = ((-0.30, -0.45, 0.0), (0.15, 0.45, 0.40))
"""Bounds of the cabin. Its windows count as opaque: a plate behind two panes is hard to read."""


def find_hidden(
    points: Float64, camera_SE3_box: Poses, size_m: Float64, category: Sequence[str], *, margin_m: float = 0.0
) -> Bool:
    """Mark the points that are behind the body of a vehicle.

    Args:
        points: (P, 3) in the camera frame.
        camera_SE3_box: N poses of boxes in the camera frame.
        size_m: (N, 3) length, width and height.
        category: N categories; only cars, vans, taxis and buses count as solid.
        margin_m: error of the boxes: bodies are smaller by it on each side.

    Returns:
        (P,) true where the line from the camera to a point passes through a body.
    """
    solid = np.flatnonzero([bool(category_words(name) & _SOLID) for name in category])
    if not len(solid):
        return np.zeros(len(points), np.bool_)
    box_SE3_camera = camera_SE3_box[solid].inverse()
    eye = box_SE3_camera.translation[:, None]
    line = box_SE3_camera.transform(points) - eye
    hidden = np.zeros(len(points), np.bool_)
    for bounds in (_LOWER, _CABIN):
        low, high = (np.array(edge) * size_m[solid] for edge in bounds)
        smaller = np.array([_ROUNDED_M + margin_m, _ROUNDED_M + margin_m, margin_m])
        hidden |= _crosses(eye, line, (low + smaller)[:, None], (high - smaller)[:, None]).any(axis=0)
    return hidden


def _crosses(start: Float64, line: Float64, low: Float64, high: Float64) -> Bool:
    """Return whether lines (N, P, 3) from starts (N, 1, 3) have passed cuboids with edges (N, 1, 3) before they end.

    The slab method (T. Kay and J. Kajiya, SIGGRAPH 1986). A line that ends in a cuboid has not passed it: two boxes of
    one vehicle hide nothing of each other.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (low - start) / line, (high - start) / line
    # Where a line runs along a slab, 0 / 0 is NaN: on its face; it then counts as beside it.
    enter = np.minimum(first, second).max(axis=-1)
    leave = np.maximum(first, second).min(axis=-1)
    crosses: Bool = (low < high).all(axis=-1) & (enter <= leave) & (leave > 0.0) & (leave < 1.0)
    return crosses
