"""Localisation error as drift: how much two tracks of one drive disagree over a distance driven."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.geometry import Poses

LENGTHS_M: Final = (10.0, 20.0, 50.0, 100.0, 200.0)
PAPER_PERCENT: Final = 0.3


def compute_drift(poses: Poses, reference: Poses, length_m: float, every: int = 10) -> Float64:
    """Compute the drift over stretches of a length.

    As in KITTI's odometry benchmark (A. Geiger et al. 2012), without alignment.

    Args:
        poses: N poses to judge.
        reference: N reference poses at the same times.
        length_m: length of a stretch, along the reference.
        every: a stretch begins at every so many poses.

    Returns:
        (K,) distances between the two end positions, seen from the start, in percent of the length; empty if the way
        is shorter.

    Raises:
        UsageError: the numbers of poses differ, or the length is not above 0.
    """
    if len(poses) != len(reference) or not length_m > 0.0:
        raise UsageError(
            f"{len(poses)} and {len(reference)} poses over {length_m} m", expected="as many of both, over more than 0 m"
        )
    steps = np.linalg.norm(np.diff(reference.translation, axis=0), axis=1)
    driven = np.concatenate([[0.0], np.cumsum(steps)])[: len(poses)]
    first = np.arange(0, len(poses), every)
    last = np.searchsorted(driven, driven[first] + length_m)
    first, last = first[last < len(poses)], last[last < len(poses)]
    relative = [track[first].inverse() @ track[last] for track in (poses, reference)]
    apart = np.linalg.norm((relative[1].inverse() @ relative[0]).translation, axis=1)
    return np.asarray(100.0 * apart / (driven[last] - driven[first]), np.float64)
