"""Rigid motions, batched: compose, invert, transform, logarithm and exponential, and interpolation in time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from mirror.arrays import AnyArray, Bool, Float64, Int64
from mirror.errors import UsageError
from mirror.geometry.blocks import split
from mirror.geometry.quaternions import quaternion_from_matrix, quaternion_normalise
from mirror.geometry.twists import exp_kernel, log_kernel
from mirror.geometry.unit_quaternions import (
    broadcast,
    canonical,
    invert_unit,
    matrix_unit,
    multiply_unit,
    rotate_unit,
)

COLUMNS: Final = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")

_MATRIX_PAYS_FROM: Final = 4


@dataclass(frozen=True, eq=False)
class Poses:
    """N rigid motions. A variable ``dst_SE3_src`` maps points of the frame src into the frame dst.

    Attributes:
        rotation: (N, 4) unit quaternions, scalar first, ``qw >= 0``; given in any length but zero, normalised here.
        translation: (N, 3) metres.

    Raises:
        UsageError: shapes do not fit, a quaternion is zero, or a number is not finite; the row is named.
    """

    rotation: Float64
    translation: Float64

    def __post_init__(self) -> None:
        rotation = np.atleast_2d(np.asarray(self.rotation, dtype=np.float64))
        translation = np.atleast_2d(np.asarray(self.translation, dtype=np.float64))
        if rotation.shape != (len(translation), 4) or translation.shape != (len(rotation), 3):
            raise UsageError(
                f"rotation of shape {rotation.shape} with translation of shape {translation.shape}",
                expected="(N, 4) and (N, 3)",
            )
        finite = np.isfinite(translation)
        if not finite.all():
            row = int(np.argmin(finite.all(axis=1)))
            raise UsageError(
                f"translation {translation[row].tolist()} is not finite",
                place=f"row {row}",
                expected="three finite numbers, in metres",
                remedy="drop that row, or find out why its source has no position",
            )
        object.__setattr__(self, "rotation", np.ascontiguousarray(quaternion_normalise(rotation)))
        object.__setattr__(self, "translation", np.ascontiguousarray(translation))

    @classmethod
    def unchecked(cls, rotation: Float64, translation: Float64) -> Poses:
        """Make poses from arrays that are known to be valid, without a check, which would double the time of a pose."""
        poses = object.__new__(cls)
        # Contiguous: gathering a few rows of a strided array would copy all of it first.
        object.__setattr__(poses, "rotation", np.ascontiguousarray(rotation))
        object.__setattr__(poses, "translation", np.ascontiguousarray(translation))
        return poses

    @classmethod
    def identity(cls, count: int = 1) -> Poses:
        """Return ``count`` identity motions."""
        return cls.unchecked(np.tile((1.0, 0.0, 0.0, 0.0), (count, 1)), np.zeros((count, 3)))

    @classmethod
    def from_matrix(cls, matrix: npt.ArrayLike) -> Poses:
        """Return the poses of homogeneous matrices.

        Args:
            matrix: (N, 4, 4), or one (4, 4).

        Raises:
            UsageError: the shape is another, a bottom row is not 0 0 0 1, a translation is not finite, or an upper left
                part is no rotation; the row is named.
        """
        given = np.asarray(matrix, dtype=np.float64)
        if given.shape[-2:] != (4, 4) or given.ndim not in (2, 3):
            raise UsageError(f"matrices of shape {given.shape}", expected="(N, 4, 4)")
        given = given.reshape(-1, 4, 4)
        affine = (given[:, 3] == (0.0, 0.0, 0.0, 1.0)).all(axis=1)
        if not affine.all():
            row = int(np.argmin(affine))
            raise UsageError(
                f"bottom row {given[row, 3].tolist()} of a rigid motion",
                place=f"row {row}",
                expected="0 0 0 1",
                remedy="transpose the matrix if its translation stands in the bottom row",
            )
        return cls(quaternion_from_matrix(given[:, :3, :3]), given[:, :3, 3])

    @classmethod
    def from_columns(cls, columns: Mapping[str, Any]) -> Poses:
        """Make poses from the columns ``qw qx qy qz tx_m ty_m tz_m`` of a mapping, a data frame or an Arrow table.

        Raises:
            UsageError: a column is missing, or a row is no pose; it is named.
        """
        try:
            values = [np.asarray(columns[name], dtype=np.float64) for name in COLUMNS]
        except KeyError as error:
            raise UsageError(f"no column {error}", expected=f"the columns {' '.join(COLUMNS)}") from error
        return cls(np.stack(values[:4], axis=-1), np.stack(values[4:], axis=-1))

    def to_columns(self) -> dict[str, Float64]:
        """Return the seven columns ``qw qx qy qz tx_m ty_m tz_m``, (N,) each."""
        values = (*self.rotation.T, *self.translation.T)
        return {name: np.ascontiguousarray(column) for name, column in zip(COLUMNS, values)}

    @classmethod
    def exp(cls, twist: npt.ArrayLike) -> Poses:
        """Return the motions after one unit of time at constant twist: the exponential map of SE(3).

        Args:
            twist: (N, 6) rotation vector (rad), then velocity (m), both in the moving frame, as in the
                ``covariance`` of the calibrations. Normwise accurate to rounding at every angle.

        Raises:
            UsageError: a twist is not finite; its row is named.
        """
        given = np.atleast_2d(np.asarray(twist, dtype=np.float64))
        if given.ndim != 2 or given.shape[1] != 6:
            raise UsageError(f"twists of shape {given.shape}", expected="(N, 6): rotation, then translation")
        finite = np.isfinite(given)
        if not finite.all():
            row = int(np.argmin(finite.all(axis=1)))
            raise UsageError(
                f"twist {given[row].tolist()} is not finite", place=f"row {row}", expected="six finite numbers"
            )
        motion = broadcast(exp_kernel, 7, given)
        return cls.unchecked(canonical(motion[:, :4]), motion[:, 4:])

    def log(self) -> Float64:
        """Return the twists (N, 6) whose `exp` gives these motions: rotation of at most pi first, then translation."""
        return broadcast(log_kernel, 6, np.concatenate((self.rotation, self.translation), axis=1))

    def __len__(self) -> int:
        return len(self.rotation)

    def __getitem__(self, index: int | slice | Int64 | Bool) -> Poses:
        return self.unchecked(np.atleast_2d(self.rotation[index]), np.atleast_2d(self.translation[index]))

    def compose(self, other: Poses) -> Poses:
        """Compose motions: ``a_SE3_b.compose(b_SE3_c)`` is ``a_SE3_c``; also written ``a_SE3_b @ b_SE3_c``.

        Args:
            other: as many poses, or one; one here goes with all of ``other``.

        Raises:
            UsageError: the numbers of poses do not fit.

        Example:
            >>> from mirror.geometry import Poses
            >>> world_SE3_ego = Poses([[1.0, 0.0, 0.0, 0.0]], [[10.0, 0.0, 0.0]])
            >>> ego_SE3_camera = Poses([[1.0, 0.0, 0.0, 0.0]], [[1.5, 0.0, 1.6]])
            >>> (world_SE3_ego @ ego_SE3_camera).translation
            array([[11.5,  0. ,  1.6]])
        """
        self._require_matching(len(other), "poses")
        rotation = multiply_unit(self.rotation, other.rotation)
        return self.unchecked(rotation, rotate_unit(self.rotation, other.translation) + self.translation)

    __matmul__ = compose

    def inverse(self) -> Poses:
        """Invert the motions: ``a_SE3_b.inverse()`` is ``b_SE3_a``."""
        rotation = invert_unit(self.rotation)
        return self.unchecked(rotation, -rotate_unit(rotation, self.translation))

    def transform(self, points: npt.ArrayLike) -> Float64:
        """Map points from src to dst.

        Args:
            points: (N, M, 3), M points for each pose; or (M, 3), the same points for every pose. Points that are not
                finite stay so.

        Returns:
            (N, M, 3).

        Raises:
            UsageError: the shape is another.
        """
        given = np.asarray(points, dtype=np.float64)
        if given.ndim not in (2, 3) or given.shape[-1] != 3:
            raise UsageError(f"points of shape {given.shape}", expected="(N, M, 3) or (M, 3)")
        given = given if given.ndim == 3 else given[None]
        self._require_matching(len(given), "sets of points")
        if given.shape[1] < _MATRIX_PAYS_FROM:
            return rotate_unit(self.rotation[:, None], given) + self.translation[:, None]
        motion = np.concatenate((matrix_unit(self.rotation), self.translation), axis=1)
        return broadcast(_transform_kernel, 3, motion[:, None], given)

    def matrix(self) -> Float64:
        """Return the homogeneous matrices (N, 4, 4)."""
        out = np.zeros((len(self), 4, 4))
        out[:, :3, :3] = matrix_unit(self.rotation).reshape(-1, 3, 3)
        out[:, :3, 3] = self.translation
        out[:, 3, 3] = 1.0
        return out

    def one_matrix(self) -> Float64:
        """Return the homogeneous matrix (4, 4) of a single pose.

        Raises:
            UsageError: there are none or several poses.
        """
        if len(self) != 1:
            raise UsageError(f"{len(self)} poses", expected="one pose", remedy="call matrix() for (N, 4, 4)")
        matrix: Float64 = self.matrix()[0]
        return matrix

    def _require_matching(self, count: int, what: str) -> None:
        if len(self) != count and 1 not in (len(self), count):
            raise UsageError(f"{len(self)} poses with {count} {what}", expected="the same number of both, or one")


def to_pose_numbers(pose: Poses) -> tuple[float, ...]:
    """Return the seven numbers ``qw qx qy qz tx_m ty_m tz_m`` of one pose."""
    return (*pose.rotation[0].tolist(), *pose.translation[0].tolist())


def _transform_kernel(out: AnyArray, motion: AnyArray, points: AnyArray) -> None:
    m = split(motion)
    x, y, z = split(points)
    for axis in range(3):
        np.add(m[3 * axis] * x + m[3 * axis + 1] * y + m[3 * axis + 2] * z, m[9 + axis], out=out[..., axis])
