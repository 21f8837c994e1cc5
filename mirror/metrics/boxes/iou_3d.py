"""Intersection over union of oriented boxes in space, exact for every orientation."""

from __future__ import annotations

import numpy as np

from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.geometry.boxes import sizes
from mirror.geometry.poses import Poses
from mirror.metrics.inputs import Numbers, as_numbers


def box_iou_3d(first: Poses, first_lwh_m: Numbers, second: Poses, second_lwh_m: Numbers) -> Float64:
    """Return the intersection over union of the volumes of pairs of boxes.

    Boxes whose z axes agree, whatever the frame they share, overlap in a prism: its base is integrated along the sides
    of one rectangle, held within the other (Green's theorem). Others are cut into tetrahedra. Both are exact up to
    rounding, relative to the pair's position and size, so that boxes far from the origin, tiny boxes and thin ones keep
    their digits; a box has exactly 1 with itself.

    Args:
        first: N poses ``dst_SE3_box``, x along the length, y along the width, z along the height.
        first_lwh_m: (N, 3) length, width, height in metres.
        second: N poses in the same frame.
        second_lwh_m: (N, 3).

    Returns:
        (N,) in [0, 1]; 0 for boxes that touch or have no volume beside one that has; NaN where neither has a volume.

    Raises:
        UsageError: there are not as many poses as sizes or as second ones, or a size is negative or not finite; its row
            is named.
    """
    from mirror.metrics.boxes.overlap_kernels import overlaps

    if len(first) != len(second):
        raise UsageError(f"{len(first)} boxes with {len(second)}", expected="pairs, row by row")
    intersection, union = overlaps(
        first.rotation,
        first.translation,
        np.ascontiguousarray(sizes(first, as_numbers(first_lwh_m, "first sizes", np.float64))),
        second.rotation,
        second.translation,
        np.ascontiguousarray(sizes(second, as_numbers(second_lwh_m, "second sizes", np.float64))),
    )
    with np.errstate(invalid="ignore"):
        return np.asarray(intersection / union)


def box_iou_3d_matrix(first: Poses, first_lwh_m: Numbers, second: Poses, second_lwh_m: Numbers) -> Float64:
    """Compute `box_iou_3d` of each of N boxes with each of M boxes.

    Args:
        first: N poses.
        first_lwh_m: (N, 3) length, width, height in metres.
        second: M poses in the same frame.
        second_lwh_m: (M, 3).

    Returns:
        (N, M).

    Raises:
        UsageError: there are not as many sizes as poses, or a size is negative or not finite; its row is named.
    """
    lwh, lwh2 = (
        sizes(first, as_numbers(first_lwh_m, "first sizes", np.float64)),
        sizes(second, as_numbers(second_lwh_m, "second sizes", np.float64)),
    )
    row, column = (index.ravel() for index in np.indices((len(first), len(second))))
    return box_iou_3d(first[row], lwh[row], second[column], lwh2[column]).reshape(len(first), len(second))
