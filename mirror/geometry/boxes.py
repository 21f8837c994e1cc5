"""Oriented boxes: their corners, their edges, and which points they hold."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from mirror.arrays import Bool, Float64
from mirror.errors import UsageError
from mirror.geometry.poses import Poses
from mirror.geometry.unit_quaternions import invert_unit, rotate_unit

# Corner k lies at half the size times these signs, x forward, y left, z up: the front face, then the rear one; each
# from its upper left corner, seen from behind, round by the upper right one.
CORNER_SIGNS: Final = np.array(
    [
        [1.0, 1.0, 1.0],
        [1.0, -1.0, 1.0],
        [1.0, -1.0, -1.0],
        [1.0, 1.0, -1.0],
        [-1.0, 1.0, 1.0],
        [-1.0, -1.0, 1.0],
        [-1.0, -1.0, -1.0],
        [-1.0, 1.0, -1.0],
    ]
)
# Front face, rear face, and the four edges between them, as pairs of corners.
EDGES: Final = np.array(
    [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]]
)
# The edges of the front, rear, upper, right, lower and left face.
FACES: Final = np.array([[0, 1, 2, 3], [4, 5, 6, 7], [0, 9, 4, 8], [1, 10, 5, 9], [2, 11, 6, 10], [3, 8, 7, 11]])


def corners(poses: Poses, lwh_m: npt.ArrayLike) -> Float64:
    """Return the corners of boxes, in the order of `CORNER_SIGNS`.

    Args:
        poses: N poses ``dst_SE3_box``: the box's centre, x along its length, y along its width, z along its height.
        lwh_m: (N, 3) length, width, height in metres.

    Returns:
        (N, 8, 3) in the frame dst.

    Raises:
        UsageError: there are not as many sizes as poses, or a size is negative or not finite; its row is named.

    Example:
        >>> from mirror.geometry import Poses, corners
        >>> corners(Poses.identity(), [[4.0, 2.0, 1.6]])[0, 0]
        array([2. , 1. , 0.8])
    """
    return poses.transform(0.5 * sizes(poses, lwh_m)[:, None] * CORNER_SIGNS)


def points_in_boxes(points: npt.ArrayLike, poses: Poses, lwh_m: npt.ArrayLike) -> Bool:
    """Mark the points that lie in or on each box.

    Args:
        points: (M, 3) in the frame dst; a point that is not finite is in no box.
        poses: N poses ``dst_SE3_box``.
        lwh_m: (N, 3) length, width, height in metres.

    Returns:
        (N, M).

    Raises:
        UsageError: a shape is another, or a size is negative or not finite; its row is named.
    """
    given = np.asarray(points, dtype=np.float64)
    if given.ndim != 2 or given.shape[1] != 3:
        raise UsageError(f"points of shape {given.shape}", expected="(M, 3)")
    half = 0.5 * sizes(poses, lwh_m)
    box_from_dst = invert_unit(poses.rotation)
    # Only the points whose x can be in a box are turned into its frame.
    order = np.argsort(given[:, 0])
    x = given[order, 0]
    axis = rotate_unit(box_from_dst, np.array([1.0, 0.0, 0.0]))
    centre, reach = poses.translation[:, 0], np.einsum("ni,ni->n", np.abs(axis), half)
    slack = 1e-12 * (1.0 + np.abs(centre) + reach)
    first = np.searchsorted(x, centre - reach - slack, side="left")
    last = np.searchsorted(x, centre + reach + slack, side="right")
    inside = np.zeros((len(poses), len(given)), dtype=np.bool_)
    for box in np.flatnonzero(first < last):
        near = order[first[box] : last[box]]
        with np.errstate(invalid="ignore"):
            local = rotate_unit(box_from_dst[box], given[near] - poses.translation[box])
        inside[box, near] = (np.abs(local) <= half[box]).all(axis=1)
    return inside


def sizes(poses: Poses, lwh_m: npt.ArrayLike) -> Float64:
    """Return the sizes (N, 3) of N boxes, checked.

    Raises:
        UsageError: there are not as many sizes as poses, or a size is negative or not finite; its row is named.
    """
    given = np.atleast_2d(np.asarray(lwh_m, dtype=np.float64))
    if given.size == 0:
        given = given.reshape(0, 3)
    if given.shape != (len(poses), 3):
        raise UsageError(f"sizes of shape {given.shape} for {len(poses)} boxes", expected=f"({len(poses)}, 3)")
    valid = (given >= 0.0) & np.isfinite(given)
    if not valid.all():
        row = int(np.argmin(valid.all(axis=1)))
        raise UsageError(
            f"size {given[row].tolist()} of a box",
            place=f"row {row}",
            expected="length, width and height in metres, finite and not negative",
        )
    return given


def edge_points(poses: Poses, lwh_m: npt.ArrayLike, count: int = 5) -> Float64:
    """Return points on the edges of boxes, evenly spaced from corner to corner.

    Args:
        poses: N poses ``dst_SE3_box``.
        lwh_m: (N, 3) length, width, height in metres.
        count: points of an edge, at least 2.

    Returns:
        (N, 12 count, 3) in the frame dst.

    Raises:
        UsageError: sizes do not fit.
    """
    ends = corners(poses, lwh_m)[:, EDGES]  # (N, 12, 2, 3)
    share = np.linspace(0.0, 1.0, count)[:, None]
    points = ends[:, :, :1] + share * (ends[:, :, 1:] - ends[:, :, :1])
    return np.asarray(points.reshape(len(ends), -1, 3))
