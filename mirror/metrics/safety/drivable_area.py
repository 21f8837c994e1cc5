"""Drivable-area compliance of the ego, and its margin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mirror.arrays import Bool, Float64
from mirror.errors import UsageError
from mirror.metrics.safety.state_log import StateLog

NUPLAN_TOLERANCE_M = 0.3
"""Distance outside at which a corner may be (nuPlan, ``drivable_area_compliance``)."""
_ACCURACY_M = 1e-3
_SIGNS = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)])


@dataclass(frozen=True, eq=False)
class DrivableAreaCompliance:
    """The result of a test of the ego against the drivable area.

    Args:
        is_compliant: no corner is ever farther outside than the tolerance.
        margin_m: (T,) signed distance of the worst corner from the edge of the area at each stamp; negative: outside.
        least_margin_m: the least margin at the stamps and between them.
        stamp_ns: when it is least.
    """

    is_compliant: bool
    margin_m: Float64
    least_margin_m: float
    stamp_ns: int


def drivable_area_compliance(
    log: StateLog, rings: Sequence[npt.ArrayLike], *, tolerance_m: float = NUPLAN_TOLERANCE_M
) -> DrivableAreaCompliance:
    """Test all four corners of the ego against the drivable area, at the stamps and between them.

    Between two stamps position and heading change linearly, as `find_collisions` has it; the least margin there is
    found to 1 mm.

    Args:
        log: states; only the ego is read.
        rings: closed rings (K, 2) in the frame of the log: outlines and holes of the area. A point is inside if a ray
            from it crosses the rings an odd number of times; outlines must not overlap each other.
        tolerance_m: how far outside a corner may be.

    Raises:
        UsageError: there is no ring, a ring has fewer than three points or a coordinate that is not finite, or the
            tolerance is negative.
    """
    from mirror.metrics.safety.drivable_area_kernels import least_margin, signed_distances

    if not tolerance_m >= 0.0:
        raise UsageError(f"tolerance_m is {tolerance_m}", expected="a number of metres, 0 or more")
    origin = np.array([log.x_m[0, 0], log.y_m[0, 0]])
    segments = _segments(rings, origin)
    margins = signed_distances(_corners(log, origin), *segments).reshape(-1, 4)
    states = np.stack([log.x_m[:, 0] - origin[0], log.y_m[:, 0] - origin[1], np.unwrap(log.yaw_rad[:, 0])], axis=1)
    half = 0.5 * np.array([log.length_m[0], log.width_m[0]])
    least, row, share = least_margin(states, half * _SIGNS, margins, *segments, _ACCURACY_M)
    step_ns = int(log.stamps_ns[row + 1] - log.stamps_ns[row]) if row + 1 < len(margins) else 0
    return DrivableAreaCompliance(
        is_compliant=bool(least >= -tolerance_m),
        margin_m=margins.min(axis=1),
        least_margin_m=float(least),
        stamp_ns=int(log.stamps_ns[row]) + round(share * step_ns),
    )


def _corners(log: StateLog, origin: Float64) -> Float64:
    """Corners (4 T, 2) of the ego, four a stamp."""
    forward = 0.5 * log.length_m[0] * np.stack([np.cos(log.yaw_rad[:, 0]), np.sin(log.yaw_rad[:, 0])], axis=1)
    left = 0.5 * log.width_m[0] * np.stack([-np.sin(log.yaw_rad[:, 0]), np.cos(log.yaw_rad[:, 0])], axis=1)
    center = np.stack([log.x_m[:, 0], log.y_m[:, 0]], axis=1) - origin
    return np.stack(
        [center + forward + left, center + forward - left, center - forward - left, center - forward + left], axis=1
    ).reshape(-1, 2)


def _segments(rings: Sequence[npt.ArrayLike], origin: Float64) -> tuple[Float64, Float64]:
    """Begins and ends (S, 2) of the segments of all rings."""
    if not rings:
        raise UsageError("the drivable area has no ring", expected="at least one outline (K, 2)")
    begins, ends = [], []
    for number, ring in enumerate(rings):
        points = np.asarray(ring, np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3 or not np.isfinite(points).all():
            raise UsageError(
                f"a ring of shape {points.shape}",
                place=f"ring {number}",
                expected="(K, 2) finite coordinates of three points or more",
            )
        begins.append(points - origin)
        ends.append(np.roll(points, -1, axis=0) - origin)
    return np.concatenate(begins), np.concatenate(ends)


def inside_area(points_m: npt.ArrayLike, rings: Sequence[npt.ArrayLike]) -> Bool:
    """Mark the points (P, 2) that lie in an area; see `drivable_area_compliance` for the rings."""
    from mirror.metrics.safety.drivable_area_kernels import signed_distances

    points = np.asarray(points_m, np.float64)
    origin = points[0] if len(points) else np.zeros(2)
    return np.asarray(signed_distances(points - origin, *_segments(rings, origin)) >= 0.0)
