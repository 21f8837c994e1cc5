"""Rotations as datasets store them: a bad one costs its row of the track, but is an error in a table of boxes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.errors import RecordingError
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import quaternion_normalise
from mirror.recordings.coordinates import is_invalid_rotation
from mirror.recordings.row_faults import RowFaults

_IDENTITY: Final = (1.0, 0.0, 0.0, 0.0)
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


def mark_rotations(quaternion: Float64, *, file: Path, place: Callable[[int], str]) -> tuple[RowFaults, Float64]:
    """Mark the rows of a track whose quaternion is no rotation.

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
    bad = is_invalid_rotation(quaternion)
    faults.add(bad, "rotation", error)
    return faults, quaternion_normalise(np.where(bad[:, None], _IDENTITY, quaternion))


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
    bad = is_invalid_rotation(quaternion)
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
    return Poses(quaternion_normalise(quaternion), position)


def _error(quaternion: Float64, file: Path, place: str) -> RecordingError:
    return RecordingError(
        f"{quaternion.tolist()} is no rotation", file=file, place=place, expected=_EXPECTED, remedy=REMEDY
    )
