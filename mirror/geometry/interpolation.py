"""Poses at any time between recorded ones."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.arrays import AnyArray, Int64
from mirror.errors import UsageError
from mirror.geometry.blocks import fill, split
from mirror.geometry.poses import Poses
from mirror.geometry.unit_quaternions import canonical, slerp_kernel


def interpolate(
    timestamps_ns: npt.ArrayLike, poses: Poses, query_ns: npt.ArrayLike, *, extrapolate: bool = False
) -> Poses:
    """Interpolate poses at given times: rotation at constant rate (slerp), translation on a straight line.

    Stamps are subtracted as integers, so that the epoch costs no digits; at a recorded stamp the recorded pose comes
    back bit for bit.

    Args:
        timestamps_ns: (N,) integers, strictly increasing.
        poses: the N poses at these times.
        query_ns: (M,) integers in any order, or one.
        extrapolate: beyond the ends, go on at the velocity and turn rate of the first or last interval.

    Returns:
        M poses.

    Raises:
        UsageError: a time lies outside the recorded ones (and ``extrapolate`` is false); stamps are not integers, not
            increasing, or not as many as poses; there are no poses, or there is one and ``extrapolate`` needs two.

    Example:
        >>> from mirror.geometry import Poses, interpolate
        >>> poses = Poses(np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)), [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
        >>> interpolate([0, 100], poses, [25]).translation
        array([[1., 0., 0.]])
    """
    stamps = _stamps(timestamps_ns, "timestamps_ns")
    query = _stamps(query_ns, "query_ns")
    _require_track(stamps, poses)
    if not len(query):
        return poses[:0]
    if not len(stamps):
        raise UsageError("no poses to interpolate between", expected="at least one")
    if not extrapolate or len(stamps) == 1:
        _require_covered(stamps, query, extrapolate)
    if len(stamps) == 1:
        return poses[np.zeros(len(query), dtype=np.int64)]

    rotation, translation = np.empty((len(query), 4)), np.empty((len(query), 3))

    def kernel(rotation: AnyArray, translation: AnyArray, query: AnyArray) -> None:
        # `take` gathers rows ten times as fast as indexing does.
        query = query[:, 0]
        start = np.searchsorted(stamps[1:-1], query, side="right")
        end = start + 1
        before = stamps.take(start)
        fraction = (query - before) / (stamps.take(end) - before)
        slerp_kernel(rotation, poses.rotation.take(start, axis=0), poses.rotation.take(end, axis=0), fraction[:, None])
        first = split(poses.translation.take(start, axis=0))
        way = split(poses.translation.take(end, axis=0)) - first
        np.add(first, fraction * way, out=translation.T)

    fill(kernel, rotation, translation, query[:, None])
    # The only stamp that ends an interval and starts none: first + (last - first) may differ from last by rounding.
    translation[query == stamps[-1]] = poses.translation[-1]
    return Poses.unchecked(canonical(rotation), translation)


def _stamps(values: npt.ArrayLike, name: str) -> Int64:
    given = np.atleast_1d(np.asarray(values))
    if given.ndim != 1 or (given.dtype.kind not in "iu" and given.size):
        raise UsageError(
            f"{name} of type {given.dtype} and shape {given.shape}",
            expected="one axis of integers: a float has no room for nanoseconds since 1970",
        )
    return given.astype(np.int64, copy=False)


def _require_track(stamps: Int64, poses: Poses) -> None:
    if len(stamps) != len(poses):
        raise UsageError(f"{len(stamps)} timestamps for {len(poses)} poses", expected="as many of both")
    increasing = stamps[1:] > stamps[:-1]
    if not increasing.all():
        row = int(np.argmin(increasing))
        raise UsageError(
            f"timestamp {stamps[row + 1]} follows {stamps[row]}",
            place=f"row {row + 1}",
            expected="strictly increasing timestamps_ns",
            remedy="sort the poses by time and drop repeated stamps",
        )


def _require_covered(stamps: Int64, query: Int64, extrapolate: bool) -> None:
    if stamps[0] <= query.min() and query.max() <= stamps[-1]:
        return
    row = int(np.argmax((query < stamps[0]) | (query > stamps[-1])))
    distance = max(int(stamps[0]) - int(query[row]), int(query[row]) - int(stamps[-1]))
    raise UsageError(
        f"no pose at {query[row]} ns: {distance * 1e-9:g} s outside the recorded poses",
        place=f"query row {row}",
        expected=f"a time from {stamps[0]} to {stamps[-1]}",
        remedy="a single pose has no velocity to go on with: give two"
        if extrapolate
        else "leave that time out, or extrapolate at constant velocity",
    )
