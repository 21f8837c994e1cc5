"""Fits a smooth height field of the ground to driven positions and to points on the road.

The origin of the ego frame is on the ground under the rear axle, so that each drive measures a strip of the ground. The
field is a cubic B-spline surface over a regular grid; its height is linear in the coefficients. It is fitted by least
squares with a thin-plate penalty (Eilers and Marx, "Flexible smoothing with B-splines and penalties", Statistical
Science 1996), and by iteratively reweighted least squares with Huber's weights for points, because points may belong to
other surfaces.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64, Int64
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.geometry.poses import Poses

_SPACING_M: Final = 4.0
_MARGIN_M: Final = 60.0
_MAX_KNOTS: Final = 250_000
_LINE_SIGMA_M: Final = 0.03
_POINT_SIGMA_M: Final = 0.15
_SMOOTH: Final = 0.4
_LEVEL: Final = 1.0
_TRACK_M: Final = 1.6
_ROUNDS: Final = 8
_GATE_M: Final = 0.3
_ABOVE: Final = 0.5


@dataclass(frozen=True, eq=False)
class FittedGround:
    """A height field; outside its grid the height is constant, equal to the nearest height of the grid.

    Attributes:
        origin_m: (2,) x and y of the first knot in the world.
        spacing_m: distance between knots.
        knots_m: (NX, NY) coefficients of the surface.
        sigma_m: robust standard deviation of the driven positions from the surface.
    """

    origin_m: Float64
    spacing_m: float
    knots_m: Float64
    sigma_m: float

    def height(self, xy_m: Float64) -> Float64:
        """Compute heights (N,) at positions (N, 2) in the world; finite everywhere."""
        return self._evaluate(xy_m, (0, 0))

    def normal(self, xy_m: Float64) -> Float64:
        """Compute unit normals (N, 3), pointing up, at positions (N, 2)."""
        slope = np.stack([self._evaluate(xy_m, (1, 0)), self._evaluate(xy_m, (0, 1))], axis=1)
        normal = np.column_stack([-slope, np.ones(len(slope))])
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))

    def _evaluate(self, xy_m: Float64, order: tuple[int, int]) -> Float64:
        """Evaluate the surface (N,), or its derivative by x or y if that order is 1."""
        cell, weights, inside = _basis(xy_m, self.origin_m, self.spacing_m, self.knots_m.shape, order)
        x, y = cell[:, 0, None, None] + np.arange(4)[:, None], cell[:, 1, None, None] + np.arange(4)
        values = (self.knots_m[x, y] * weights).sum(axis=(1, 2))
        # Outside the grid the surface is level: its slope across the border is zero.
        for axis in range(2):
            if order[axis]:
                values = np.where(inside[:, axis], values, 0.0)
        return np.asarray(values)


def read_driven_poses(dataset: Dataset) -> Poses:
    """Read ``world_SE3_ego`` of all traversals of a dataset view, concatenated, from its pose layer."""
    frames = [dataset.where(traversal=name).frames() for name in dataset.traversals()]
    tracks = [Poses.identity(0), *(frames_of_one[0].track[1] for frames_of_one in frames if len(frames_of_one))]
    return Poses.unchecked(
        *(np.concatenate([getattr(track, part) for track in tracks]) for part in ("rotation", "translation"))
    )


def compute_wheel_contacts(world_SE3_ego: Poses) -> Float64:
    """Compute ground contacts (3 N, 3): the middle and both ends of the rear axle, projected onto the ground.

    The ego frame first_differences with the vehicle, so that its attitude gives the cross slope of the road.
    """
    matrix = world_SE3_ego.matrix()
    middle, aside = matrix[:, :3, 3], 0.5 * _TRACK_M * matrix[:, :3, 1]
    return np.concatenate([middle, middle + aside, middle - aside])


def fit_ground(driven_m: Float64, points_m: Float64 | None = None) -> FittedGround:
    """Fit the ground of a scene.

    Args:
        driven_m: (N, 3) positions on the ground, see `compute_wheel_contacts`.
        points_m: (M, 3) points that may lie on the ground; points far from it get little weight. None: the fit uses
            the driven positions only.

    Raises:
        UsageError: no driven position is finite, or the scene is too wide for a grid of 4 m.
    """
    driven = driven_m[np.isfinite(driven_m).all(axis=1)]
    if not len(driven):
        raise UsageError(f"none of {len(driven_m)} driven positions is finite", expected="at least one pose")
    low, high = driven[:, :2].min(axis=0) - _MARGIN_M, driven[:, :2].max(axis=0) + _MARGIN_M
    shape = tuple((np.ceil((high - low) / _SPACING_M).astype(int) + 3).tolist())
    if shape[0] * shape[1] > _MAX_KNOTS:
        raise UsageError(
            f"the drives span {' x '.join(f'{side:.0f} m' for side in high - low)}",
            expected=f"at most {_MAX_KNOTS} knots {_SPACING_M:g} m apart",
            remedy="reconstruct a smaller region: ingest it with a smaller radius_m",
        )
    driven = _thin(driven)
    # Without measurements the surface tends to the median height.
    middle = np.median(driven, axis=0)
    ground = _solve(driven, np.full(len(driven), 1.0 / _LINE_SIGMA_M), low, shape, middle[2])
    points = np.empty((0, 3)) if points_m is None else points_m[np.isfinite(points_m).all(axis=1)]
    points = points[((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)]
    for _ in range(_ROUNDS if len(points) else 0):
        off = points[:, 2] - ground.height(points[:, :2])
        near = np.abs(off) < _GATE_M
        # Objects lie above the ground, noise on both sides: points above get less weight.
        share = np.minimum(1.0, _POINT_SIGMA_M / np.maximum(np.abs(off[near]), 1e-9))
        share *= np.where(off[near] > 0.0, _ABOVE, 1.0)
        both = np.concatenate([driven, points[near]])
        weight = np.concatenate([np.full(len(driven), 1.0 / _LINE_SIGMA_M), np.sqrt(share) / _POINT_SIGMA_M])
        ground = _solve(both, weight, low, shape, middle[2])
    off = driven[:, 2] - ground.height(driven[:, :2])
    sigma = float(1.4826 * np.median(np.abs(off)))
    return FittedGround(ground.origin_m, ground.spacing_m, ground.knots_m, sigma)


def _thin(positions: Float64) -> Float64:
    """Average the positions (N, 3) in each cell of 0.25 x 0.25 m, so that a standstill counts as one position."""
    key = np.floor(positions[:, :2] / 0.25).astype(np.int64)
    _, inverse, counts = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    total = np.zeros((len(counts), 3))
    np.add.at(total, inverse.reshape(-1), positions)
    return np.asarray(total / counts[:, None])


def _solve(positions: Float64, weight: Float64, low: Float64, shape: tuple[int, ...], level: float) -> FittedGround:
    """Solve the weighted least squares for the knots, with a penalty on second differences and on slopes."""
    from scipy.sparse import coo_matrix, diags, identity, kron
    from scipy.sparse.linalg import spsolve

    cell, weights, _ = _basis(positions[:, :2], low, _SPACING_M, (shape[0], shape[1]), (0, 0))
    column = (cell[:, 0, None, None] + np.arange(4)[:, None]) * shape[1] + cell[:, 1, None, None] + np.arange(4)
    row = np.broadcast_to(np.arange(len(positions))[:, None, None], column.shape)
    values = weights * weight[:, None, None]
    count = shape[0] * shape[1]
    design = coo_matrix((values.ravel(), (row.ravel(), column.ravel())), shape=(len(positions), count)).tocsr()

    def second(size: int) -> object:
        return diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(size - 2, size))

    def first(size: int) -> object:
        return diags([-1.0, 1.0], [0, 1], shape=(size - 1, size))

    second_differences = [
        kron(second(shape[0]), identity(shape[1])),
        kron(identity(shape[0]), second(shape[1])),
        np.sqrt(2.0) * kron(first(shape[0]), first(shape[1])),
    ]
    # A second difference of _LINE_SIGMA_M / _SMOOTH between knots counts as one sigma of a driven position.
    matrix = design.T @ design + (_SMOOTH / _LINE_SIGMA_M) ** 2 * sum(part.T @ part for part in second_differences)
    # Without a penalty on slopes the camber of the road would continue through pavements and houses.
    first_differences = [kron(first(shape[0]), identity(shape[1])), kron(identity(shape[0]), first(shape[1]))]
    matrix = matrix + (_LEVEL / _LINE_SIGMA_M) ** 2 * sum(part.T @ part for part in first_differences)
    knots = spsolve(matrix.tocsc(), design.T @ (weight * (positions[:, 2] - level)))
    return FittedGround(low, _SPACING_M, knots.reshape(shape[0], shape[1]) + level, np.nan)


def _basis(
    xy: Float64, origin: Float64, spacing: float, shape: tuple[int, ...], order: tuple[int, int]
) -> tuple[Int64, Float64, Bool]:
    """Compute first knots (N, 2), weights of 16 knots (N, 4, 4), and whether x and y are inside the grid (N, 2)."""
    last = np.array(shape[:2]) - 3.0
    position = (np.asarray(xy, np.float64) - origin) / spacing
    inside = (position >= 0.0) & (position <= last)
    position = np.clip(position, 0.0, last)
    cell = np.minimum(np.floor(position), last - 1.0).astype(np.int64)
    t = position - cell
    sides = []
    for axis in range(2):
        s = t[:, axis]
        if order[axis]:
            side = [-((1 - s) ** 2) / 2, (3 * s**2 - 4 * s) / 2, (-3 * s**2 + 2 * s + 1) / 2, s**2 / 2]
            sides.append(np.stack(side, axis=1) / spacing)
        else:
            side = [(1 - s) ** 3, 3 * s**3 - 6 * s**2 + 4, -3 * s**3 + 3 * s**2 + 3 * s + 1, s**3]
            sides.append(np.stack(side, axis=1) / 6.0)
    return cell, sides[0][:, :, None] * sides[1][:, None, :], inside
