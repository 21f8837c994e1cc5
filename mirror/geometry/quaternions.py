"""Rotations as unit quaternions, scalar first, ``qw >= 0``: batched, float64.

Every function checks that its quaternions are unit quaternions (`quaternion_normalise` makes them so) and returns
canonical ones: unit, ``qw >= 0``; where ``qw`` is zero, the first component that is not is positive. Batch axes
broadcast. Angles are formed from sines and chords, never from an arc cosine, so that they are accurate near 0 and
180 degrees alike.

Source: J. Sola, "Quaternion kinematics for the error-state Kalman filter", arXiv:1711.02508 (Hamilton convention).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from mirror.arrays import AnyArray, Float64
from mirror.errors import UsageError
from mirror.geometry.blocks import split
from mirror.geometry.unit_quaternions import (
    broadcast,
    canonical,
    invert_unit,
    log_unit,
    matrix_unit,
    multiply_unit,
    rotate_unit,
    sinc,
    slerp_unit,
)

UNIT_TOLERANCE: Final = 1e-12
ROTATION_TOLERANCE: Final = 1e-3


def quaternion_normalise(quaternion: npt.ArrayLike) -> Float64:
    """Scale quaternions to unit length and canonical sign; quaternions that have both stay bit for bit.

    Args:
        quaternion: (..., 4), of any length but zero.

    Returns:
        (..., 4) canonical unit quaternions.

    Raises:
        UsageError: a quaternion is zero, NaN or infinite; its row is named.
    """
    given = _components(quaternion, 4, "quaternions")
    squared = np.einsum("...i,...i->...", given, given)
    if not np.all(np.abs(squared - 1.0) <= 4 * np.finfo(np.float64).eps):
        largest = np.max(np.abs(given), axis=-1, initial=0.0, keepdims=True)
        valid = (largest > 0) & np.isfinite(largest)
        if not valid.all():
            row = _first(~valid[..., 0])
            raise UsageError(
                f"quaternion {given[row].tolist()} is no rotation",
                place=f"row {_place(row)}",
                expected="four finite numbers, qw qx qy qz, not all zero",
                remedy="drop that row, or find out why its source has no orientation",
            )
        # Scaled by the largest component first, so that the squares neither overflow nor vanish.
        scaled = given / largest
        unit = scaled / np.sqrt(np.einsum("...i,...i->...", scaled, scaled))[..., None]
        keep = np.abs(squared - 1.0) <= 4 * np.finfo(np.float64).eps
        given = np.where(keep[..., None], given, unit)
    return canonical(given)


def quaternion_multiply(first: npt.ArrayLike, second: npt.ArrayLike) -> Float64:
    """Return the Hamilton product: the rotation that turns by ``second``, then by ``first``.

    Args:
        first: (..., 4) unit quaternions.
        second: (..., 4) unit quaternions.

    Returns:
        (..., 4), renormalised, so that long chains of products stay unit.

    Raises:
        UsageError: a quaternion is not of unit length; its row is named.
    """
    return multiply_unit(_unit(first), _unit(second))


def quaternion_inverse(quaternion: npt.ArrayLike) -> Float64:
    """Return the inverse rotation.

    Args:
        quaternion: (..., 4) unit quaternions.

    Raises:
        UsageError: a quaternion is not of unit length; its row is named.
    """
    return invert_unit(_unit(quaternion))


def rotate(quaternion: npt.ArrayLike, points: npt.ArrayLike) -> Float64:
    """Rotate points.

    Args:
        quaternion: (..., 4) unit quaternions.
        points: (..., 3); a point that is not finite gives one that is not finite.

    Returns:
        (..., 3), the batch axes of both broadcast together.

    Raises:
        UsageError: a quaternion is not of unit length; its row is named.
    """
    return rotate_unit(_unit(quaternion), _components(points, 3, "points"))


def matrix_from_quaternion(quaternion: npt.ArrayLike) -> Float64:
    """Return the rotation matrices.

    Args:
        quaternion: (..., 4) unit quaternions.

    Returns:
        (..., 3, 3).

    Raises:
        UsageError: a quaternion is not of unit length; its row is named.
    """
    given = _unit(quaternion)
    return matrix_unit(given).reshape(*given.shape[:-1], 3, 3)


def quaternion_from_matrix(matrix: npt.ArrayLike) -> Float64:
    """Convert rotation matrices to quaternions, accurately for every rotation.

    The method is that of Shepperd, J. Guidance and Control 1(3), 1978.

    A matrix that is a rotation only up to the rounding of a file is replaced by the rotation nearest to it.

    Args:
        matrix: (..., 3, 3).

    Returns:
        (..., 4) canonical unit quaternions.

    Raises:
        UsageError: a matrix has no unit columns at right angles (to 1e-3), or is a reflection; its row is named.
    """
    given = np.asarray(matrix, dtype=np.float64)
    if given.ndim < 2 or given.shape[-2:] != (3, 3):
        raise UsageError(f"rotation matrices of shape {given.shape}", expected="shape (..., 3, 3)")
    rows = given.reshape(*given.shape[:-2], 9)
    deviation = broadcast(_deviation_kernel, 1, rows)[..., 0]
    if not np.all(deviation <= ROTATION_TOLERANCE):
        row = _first(~(deviation <= ROTATION_TOLERANCE))
        raise UsageError(
            f"matrix {given[row].tolist()} is no rotation",
            place=f"row {_place(row)}",
            expected=f"unit columns at right angles and determinant +1, to {ROTATION_TOLERANCE:g}",
            remedy="divide a scaled matrix by its scale; swap or negate an axis of a reflected one",
        )
    inexact = deviation > UNIT_TOLERANCE
    if inexact.any():
        left, _, right = np.linalg.svd(given[inexact])
        rows = rows.copy()
        rows[inexact] = (left @ right).reshape(-1, 9)
    return canonical(broadcast(_matrix_kernel, 4, rows))


def quaternion_exp(rotation_vector: npt.ArrayLike) -> Float64:
    """Convert rotation vectors (axis times angle, radians) to unit quaternions, accurate for the smallest angles too.

    Args:
        rotation_vector: (..., 3).

    Raises:
        UsageError: a vector is not finite; its row is named.
    """
    vector = _components(rotation_vector, 3, "rotation vectors")
    if not np.isfinite(vector).all():
        row = _first(~np.isfinite(vector).all(axis=-1))
        raise UsageError(
            f"rotation vector {vector[row].tolist()} is not finite",
            place=f"row {_place(row)}",
            expected="three finite numbers, in radians",
        )
    half = 0.5 * np.sqrt(np.einsum("...i,...i->...", vector, vector))
    out = np.empty((*vector.shape[:-1], 4))
    out[..., 0] = np.cos(half)
    out[..., 1:] = (0.5 * sinc(half))[..., None] * vector
    return canonical(out)


def quaternion_log(quaternion: npt.ArrayLike) -> Float64:
    """Convert unit quaternions to rotation vectors (axis times angle in [0, pi], radians).

    The vectors of the smallest angles are exact too.

    Args:
        quaternion: (..., 4) unit quaternions.

    Returns:
        (..., 3).

    Raises:
        UsageError: a quaternion is not of unit length; its row is named.
    """
    return log_unit(canonical(_unit(quaternion)))


def slerp(first: npt.ArrayLike, second: npt.ArrayLike, fraction: npt.ArrayLike) -> Float64:
    """Interpolate at constant rate along the shorter way from one rotation to another (Shoemake, SIGGRAPH 1985).

    Args:
        first: (..., 4) unit quaternions, reached at fraction 0.
        second: (..., 4) unit quaternions, reached at fraction 1.
        fraction: (...); below 0 and above 1 the turn goes on at the same rate.

    Returns:
        (..., 4) canonical unit quaternions.

    Raises:
        UsageError: a quaternion is not of unit length; its row is named.
    """
    return slerp_unit(_unit(first), _unit(second), np.asarray(fraction, dtype=np.float64))


def angle_between_deg(first: npt.ArrayLike, second: npt.ArrayLike) -> Float64:
    """Return the angle in [0, 180] degrees between two rotations, accurate to 1e-14 degrees.

    Args:
        first: (..., 4) unit quaternions.
        second: (..., 4) unit quaternions.

    Raises:
        UsageError: a quaternion is not of unit length; its row is named.
    """
    difference = multiply_unit(invert_unit(_unit(first)), _unit(second))
    sine = np.sqrt(np.einsum("...i,...i->...", difference[..., 1:], difference[..., 1:]))
    return np.asarray(np.degrees(2.0 * np.arctan2(sine, difference[..., 0])))


def quaternion_from_heading_pitch_roll(
    heading_deg: npt.ArrayLike, pitch_deg: npt.ArrayLike = 0.0, roll_deg: npt.ArrayLike = 0.0
) -> Float64:
    """Return ``enu_SE3_ego`` rotations from the angles that an inertial unit reports (ego: x forward, y left, z up).

    Args:
        heading_deg: (...) clockwise from north, of the forward axis.
        pitch_deg: (...) positive with the nose up.
        roll_deg: (...) positive with the right side down.

    Returns:
        (..., 4): yaw, then pitch, then roll, each about the axis as already turned.

    Raises:
        UsageError: an angle is not finite; its row is named.
    """
    half = np.stack(
        np.broadcast_arrays(
            *(np.asarray(angle, dtype=np.float64) for angle in (heading_deg, pitch_deg, roll_deg)),
        ),
        axis=-1,
    )
    if not np.isfinite(half).all():
        row = _first(~np.isfinite(half).all(axis=-1))
        raise UsageError(
            f"heading, pitch and roll {half[row].tolist()} are not finite",
            place=f"row {_place(row)}",
            expected="three finite angles, in degrees",
        )
    half = np.radians(half * (-0.5, -0.5, 0.5) + (45.0, 0.0, 0.0))
    cz, cy, cx = np.moveaxis(np.cos(half), -1, 0)
    sz, sy, sx = np.moveaxis(np.sin(half), -1, 0)
    components = (
        cz * cy * cx + sz * sy * sx,
        cz * cy * sx - sz * sy * cx,
        cz * sy * cx + sz * cy * sx,
        sz * cy * cx - cz * sy * sx,
    )
    return canonical(np.stack(components, axis=-1))


def heading_deg(quaternion: npt.ArrayLike) -> Float64:
    """Return the heading of ``enu_SE3_ego`` rotations in [0, 360), clockwise from north.

    It is 0 where forward is straight up or down.

    Args:
        quaternion: (..., 4) unit quaternions.

    Raises:
        UsageError: a quaternion is not of unit length; its row is named.
    """
    w, x, y, z = np.moveaxis(_unit(quaternion), -1, 0)
    degrees = np.degrees(np.arctan2(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)))
    # A heading a hair west of north is -1e-15, and -1e-15 % 360 rounds to 360 itself.
    wrapped = np.asarray(degrees % 360.0)
    return np.where(wrapped >= 360.0, 0.0, wrapped)


def _matrix_kernel(out: AnyArray, matrix: AnyArray) -> None:
    """Write the quaternions of rotations (..., 9) into ``out`` (..., 4); NaN where a matrix is no rotation."""
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = split(matrix)
    trace = m00 + m11 + m22
    w, x, y, z = 1.0 + trace, 1.0 + m00 - m11 - m22, 1.0 - m00 + m11 - m22, 1.0 - m00 - m11 + m22
    # Row k holds 4 * q[k] * q: the row of the largest component has no cancellation.
    rows = (
        (w, m21 - m12, m02 - m20, m10 - m01),
        (m21 - m12, x, m10 + m01, m02 + m20),
        (m02 - m20, m10 + m01, y, m21 + m12),
        (m10 - m01, m02 + m20, m21 + m12, z),
    )
    largest = np.argmax((w, x, y, z), axis=0)
    a, b, c, d = (np.choose(largest, [row[component] for row in rows]) for component in range(4))
    scale = 1.0 / np.sqrt(a * a + b * b + c * c + d * d)
    for component, value in enumerate((a, b, c, d)):
        np.multiply(value, scale, out=out[..., component])


def _deviation_kernel(out: AnyArray, matrix: AnyArray) -> None:
    """Write how far matrices (..., 9) are from rotations into ``out`` (..., 1): of columns and of determinant."""
    a, b, c = np.moveaxis(split(matrix).reshape(3, 3, *matrix.shape[:-1]), 1, 0)
    normal = (b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0])
    entries = [
        _dot(p, q) - target for p, q, target in ((a, a, 1), (b, b, 1), (c, c, 1), (a, b, 0), (a, c, 0), (b, c, 0))
    ]
    out[..., 0] = np.max(np.abs([*entries, _dot(a, normal) - 1.0]), axis=0)


def _dot(a: Sequence[AnyArray] | AnyArray, b: Sequence[AnyArray] | AnyArray) -> AnyArray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _components(array: npt.ArrayLike, count: int, what: str) -> Float64:
    given = np.asarray(array, dtype=np.float64)
    if given.ndim == 0 or given.shape[-1] != count:
        raise UsageError(f"{what} of shape {given.shape}", expected=f"shape (..., {count})")
    return given


def _unit(quaternion: npt.ArrayLike) -> Float64:
    given = _components(quaternion, 4, "quaternions")
    off = np.abs(np.einsum("...i,...i->...", given, given) - 1.0)
    if not np.all(off <= UNIT_TOLERANCE):
        row = _first(~(off <= UNIT_TOLERANCE))
        raise UsageError(
            f"quaternion {given[row].tolist()} is not of unit length",
            place=f"row {_place(row)}",
            remedy="pass it through quaternion_normalise first",
        )
    return given


def _first(mask: npt.ArrayLike) -> tuple[int, ...]:
    return tuple(int(index) for index in np.argwhere(mask)[0])


def _place(row: tuple[int, ...]) -> str:
    return ", ".join(str(index) for index in row) or "0"
