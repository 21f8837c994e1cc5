"""Orientations in tables of poses: columns of a quaternion, or of heading, pitch and roll."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.geometry.quaternions import quaternion_from_heading_pitch_roll
from mirror.recordings.coordinates import normalise_rotations
from mirror.recordings.tabular import RecordingRows

QUATERNION: Final = ("qw", "qx", "qy", "qz")
ANGLES: Final = ("heading_deg", "pitch_deg", "roll_deg")


def read_orientation(rows: RecordingRows) -> tuple[Float64 | None, bool]:
    """Read the orientation of every row.

    Args:
        rows: the table; rows without an orientation are marked as bad.

    Returns:
        Unit quaternions (N, 4), scalar first (None: the table has no such columns), and whether they come from angles,
        which refer to the horizon and to north.

    Raises:
        RecordingError: a part of the columns is missing, or a value is bad and the table needs every row.
    """
    if any(name in rows for name in QUATERNION):
        quaternion = np.stack([rows.floats(name) for name in QUATERNION], axis=1)
        return normalise_rotations(quaternion, rows, "qw"), False
    if not any(name in rows for name in ANGLES):
        return None, False
    angles = []
    for name in ANGLES:
        angle = rows.floats(name) if name in rows or name == "heading_deg" else np.zeros(len(rows))
        bad = ~np.isfinite(angle)
        rows.refuse(
            bad,
            name,
            "no angle",
            expected="degrees",
            remedy="remove the row, or leave the orientation columns out of the whole drive",
            reason="rotation",
        )
        angles.append(np.where(bad, 0.0, angle))
    return quaternion_from_heading_pitch_roll(*angles), True
