"""Poses as datasets store them: quaternions, matrices, and their rows at the stamps of other data.

A bad pose costs its row of a track, but is an error in a table of boxes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64, Int64
from mirror.errors import RecordingError
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import quaternion_from_matrix
from mirror.recordings.coordinates import mark_invalid_rotations
from mirror.recordings.row_faults import RowFaults

_EXPECTED: Final = "a unit quaternion, scalar first"
REMEDY: Final = "download the file again"


def is_no_rigid_motion(matrix: Float64, tolerance: float = 1e-3) -> Bool:
    """Mark matrices that are no rigid motion.

    Args:
        matrix: (N, 4, 4) or (N, 3, 4).
        tolerance: largest deviation of an element of ``R^T R`` from the identity.

    Returns:
        (N,) True where the rotation is none, a bottom row is not 0 0 0 1, or a translation is beyond 10^9 m.
    """
    with np.errstate(all="ignore"):
        rotation = matrix[:, :3, :3]
        off = np.abs(np.swapaxes(rotation, 1, 2) @ rotation - np.eye(3)).max(axis=(1, 2), initial=0.0)
        good = (off < tolerance) & (np.linalg.det(np.nan_to_num(rotation, posinf=0.0, neginf=0.0)) > 0.5)
        good &= (np.abs(matrix[:, :3, 3]) < 1e9).all(axis=1)
        good &= (matrix[:, 3:] == (0.0, 0.0, 0.0, 1.0)).all(axis=(1, 2))
    return ~good


def to_poses(matrix: Float64) -> Poses:
    """Convert rigid matrices (N, 4, 4) or (N, 3, 4), possibly rounded to float32, to poses."""
    return Poses(quaternion_from_matrix(matrix[:, :3, :3]), matrix[:, :3, 3])


def mark_matrices(matrix: Float64, tolerance: float = 1e-3) -> tuple[Poses, Bool]:
    """Convert the matrices of a track to poses, and mark the matrices that are no rigid motion.

    Args:
        matrix: (N, 4, 4) or (N, 3, 4), as read.
        tolerance: as of `is_no_rigid_motion`.

    Returns:
        N poses, the identity where a row is marked; and (N,) True where a matrix is no rigid motion.
    """
    bad = is_no_rigid_motion(matrix, tolerance)
    return to_poses(np.where(bad[:, None, None], np.eye(4)[: matrix.shape[1]], matrix)), bad


def mark_rotations(quaternion: Float64, *, file: Path, place: Callable[[int], str]) -> tuple[RowFaults, Float64]:
    """Mark the rows of a track whose quaternion is not a rotation.

    Args:
        quaternion: (N, 4) scalar first, as read.
        file: the file, for the message.
        place: the place of a row in it.

    Returns:
        The marks, and (N, 4) unit quaternions; the identity in marked rows.
    """

    def error(row: int) -> RecordingError:
        return _error(quaternion[row], file, place(row))

    faults = RowFaults(len(quaternion))
    unit, bad = mark_invalid_rotations(quaternion)
    faults.add(bad, "rotation", error)
    return faults, unit


def require_poses(quaternion: Float64, position: Float64, *, file: Path, place: Callable[[int], str]) -> Poses:
    """Return the poses of a table in which every row is needed.

    Args:
        quaternion: (N, 4) scalar first, as read.
        position: (N, 3) metres.
        file: the file, for the message.
        place: the place of a row in it.

    Raises:
        RecordingError: a quaternion is no rotation, or a position is not finite; the row is named.
    """
    unit, bad = mark_invalid_rotations(quaternion)
    if bad.any():
        row = int(np.argmax(bad))
        raise _error(quaternion[row], file, place(row))
    finite = np.isfinite(position).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise RecordingError(
            f"the position {position[row].tolist()} is not finite",
            file=file,
            place=place(row),
            expected="metres",
            remedy=REMEDY,
        )
    return Poses(unit, position)


def join_poses(poses: Sequence[Poses]) -> Poses:
    """Join poses in their order; an empty list gives zero poses."""
    rotation = [one.rotation for one in poses]
    translation = [one.translation for one in poses]
    return Poses.unchecked(
        np.concatenate([np.empty((0, 4)), *rotation]), np.concatenate([np.empty((0, 3)), *translation])
    )


def select_poses(stamps: Int64, good: Bool, file: Path) -> tuple[Int64, Int64]:
    """Select the valid poses of a trajectory, one at each stamp, for `interpolate`.

    Args:
        stamps: (N,) stamps of the poses, in any order.
        good: (N,) whether a pose can be used.
        file: the file of the poses, for the message.

    Returns:
        (M,) the different stamps of good poses, ascending, and (M,) the first row of each.

    Raises:
        RecordingError: no pose is good.
    """
    times, first = np.unique(stamps[good], return_index=True)
    if not len(times):
        raise RecordingError("no pose is valid", file=file, remedy=REMEDY)
    return times, np.flatnonzero(good)[first]


def poses_at(stamps: Int64, times: Int64, poses: Poses) -> Poses:
    """Interpolate a trajectory; before the first and after the last pose, that pose holds.

    Args:
        stamps: (K,) stamps that are asked for.
        times: (M,) ascending stamps of the poses.
        poses: the M poses.
    """
    return interpolate(times, poses, np.clip(stamps, times[0], times[-1]))


def _error(quaternion: Float64, file: Path, place: str) -> RecordingError:
    return RecordingError(
        f"{quaternion.tolist()} is no rotation", file=file, place=place, expected=_EXPECTED, remedy=REMEDY
    )
