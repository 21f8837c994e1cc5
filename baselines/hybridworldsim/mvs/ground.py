"""A robust ground: a smooth height field through where the vehicles drove and what was seen of the road.

The origin of the ego frame is on the ground under the rear axle, so each drive is a strip of the ground. The field is a
cubic B-spline surface over a regular grid (its height is linear in the knots), fitted by least squares with a
thin-plate penalty (Eilers and Marx, "Flexible smoothing with B-splines and penalties", Statistical Science 1996), and
by iteratively reweighted least squares with Huber's weights for points, which may not be of the ground at all.
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
_MOST_KNOTS: Final = 250_000
_LINE_SIGMA_M: Final = 0.03
_POINT_SIGMA_M: Final = 0.15
_SMOOTH: Final = 0.4
_LEVEL: Final = 1.0
_TRACK_M: Final = 1.6
_ROUNDS: Final = 8
_GATE_M: Final = 0.3
_ABOVE: Final = 0.5


@dataclass(frozen=True, eq=False)
class Ground:
    """A height field; beyond its grid it goes on level, from the nearest place of the grid.

    Attributes:
        origin_m: (2,) place of the first knot.
        spacing_m: between knots.
        knots_m: (NX, NY) coefficients.
        sigma_m: robust deviation of the driven lines from the surface.
    """

    origin_m: Float64
    spacing_m: float
    knots_m: Float64
    sigma_m: float

    def height(self, xy_m: Float64) -> Float64:
        """Heights (N,) at places (N, 2) of the world; finite everywhere."""
        return self._evaluate(xy_m, (0, 0))

    def normal(self, xy_m: Float64) -> Float64:
        """Unit normals (N, 3) at places (N, 2), upwards."""
        slope = np.stack([self._evaluate(xy_m, (1, 0)), self._evaluate(xy_m, (0, 1))], axis=1)
        normal = np.column_stack([-slope, np.ones(len(slope))])
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))

    def _evaluate(self, xy_m: Float64, order: tuple[int, int]) -> Float64:
        cell, weights, inside = _basis(xy_m, self.origin_m, self.spacing_m, self.knots_m.shape, order)
        x, y = cell[:, 0, None, None] + np.arange(4)[:, None], cell[:, 1, None, None] + np.arange(4)
        values = (self.knots_m[x, y] * weights).sum(axis=(1, 2))
        # Level beyond the grid: no slope across its border.
        for axis in range(2):
            if order[axis]:
                values = np.where(inside[:, axis], values, 0.0)
        return np.asarray(values)


def read_driven_poses(dataset: Dataset) -> Poses:
    """``world_SE3_ego`` of the traversals of a view, one after the other, of its pose layer."""
    frames = [dataset.where(traversal=name).frames() for name in dataset.traversals()]
    tracks = [Poses.identity(0), *(own[0].track[1] for own in frames if len(own))]
    return Poses.unchecked(
        *(np.concatenate([getattr(one, part) for one in tracks]) for part in ("rotation", "translation"))
    )


def compute_wheel_contacts(world_SE3_ego: Poses) -> Float64:
    """Where vehicles touch the ground: (3 N, 3) the middle and the ends of the rear axle, projected onto it.

    The ego frame stands on the ground as the vehicle does, so its attitude tells the road's cross slope.
    """
    matrix = world_SE3_ego.matrix()
    middle, aside = matrix[:, :3, 3], 0.5 * _TRACK_M * matrix[:, :3, 1]
    return np.concatenate([middle, middle + aside, middle - aside])


def fit_ground(driven_m: Float64, points_m: Float64 | None = None) -> Ground:
    """Fit the ground of a scene.

    Args:
        driven_m: (N, 3) places on the ground: see `compute_wheel_contacts`.
        points_m: (M, 3) points that may be of the ground; those far from it lose their weight. None: the driven lines
            alone.

    Raises:
        UsageError: no finite place is left, or the scene is too wide for a grid of 4 m.
    """
    driven = driven_m[np.isfinite(driven_m).all(axis=1)]
    if not len(driven):
        raise UsageError(f"{len(driven_m)} driven places, none of them finite", expected="at least one pose")
    low, high = driven[:, :2].min(axis=0) - _MARGIN_M, driven[:, :2].max(axis=0) + _MARGIN_M
    shape = tuple((np.ceil((high - low) / _SPACING_M).astype(int) + 3).tolist())
    if shape[0] * shape[1] > _MOST_KNOTS:
        raise UsageError(
            f"the drives span {' x '.join(f'{side:.0f} m' for side in high - low)}",
            expected=f"at most {_MOST_KNOTS} knots {_SPACING_M:g} m apart",
            remedy="reconstruct a smaller region: ingest it with a smaller radius_m",
        )
    driven = _thinned(driven)
    # Far from all that is known the plane through the driven lines goes on.
    middle = np.median(driven, axis=0)
    ground = _solve(driven, np.full(len(driven), 1.0 / _LINE_SIGMA_M), low, shape, middle[2])
    points = np.empty((0, 3)) if points_m is None else points_m[np.isfinite(points_m).all(axis=1)]
    points = points[((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)]
    for _ in range(_ROUNDS if len(points) else 0):
        off = points[:, 2] - ground.height(points[:, :2])
        near = np.abs(off) < _GATE_M
        # What stands on the ground is above it; what is below it is noise alone.
        share = np.minimum(1.0, _POINT_SIGMA_M / np.maximum(np.abs(off[near]), 1e-9))
        share *= np.where(off[near] > 0.0, _ABOVE, 1.0)
        both = np.concatenate([driven, points[near]])
        weight = np.concatenate([np.full(len(driven), 1.0 / _LINE_SIGMA_M), np.sqrt(share) / _POINT_SIGMA_M])
        ground = _solve(both, weight, low, shape, middle[2])
    off = driven[:, 2] - ground.height(driven[:, :2])
    sigma = float(1.4826 * np.median(np.abs(off)))
    return Ground(ground.origin_m, ground.spacing_m, ground.knots_m, sigma)


def _thinned(places: Float64) -> Float64:
    """One place a quarter of a metre square and drive height: the mean, so that a standstill counts as one place."""
    key = np.floor(places[:, :2] / 0.25).astype(np.int64)
    _, inverse, counts = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    total = np.zeros((len(counts), 3))
    np.add.at(total, inverse.reshape(-1), places)
    return np.asarray(total / counts[:, None])


def _solve(places: Float64, weight: Float64, low: Float64, shape: tuple[int, ...], level: float) -> Ground:
    """Weighted least squares over the knots, with second differences held small."""
    from scipy.sparse import coo_matrix, diags, identity, kron
    from scipy.sparse.linalg import spsolve

    cell, weights, _ = _basis(places[:, :2], low, _SPACING_M, (shape[0], shape[1]), (0, 0))
    column = (cell[:, 0, None, None] + np.arange(4)[:, None]) * shape[1] + cell[:, 1, None, None] + np.arange(4)
    row = np.broadcast_to(np.arange(len(places))[:, None, None], column.shape)
    values = weights * weight[:, None, None]
    count = shape[0] * shape[1]
    design = coo_matrix((values.ravel(), (row.ravel(), column.ravel())), shape=(len(places), count)).tocsr()

    def second(size: int) -> object:
        return diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(size - 2, size))

    def first(size: int) -> object:
        return diags([-1.0, 1.0], [0, 1], shape=(size - 1, size))

    bends = [
        kron(second(shape[0]), identity(shape[1])),
        kron(identity(shape[0]), second(shape[1])),
        np.sqrt(2.0) * kron(first(shape[0]), first(shape[1])),
    ]
    # A bend of one part in a hundred between knots counts as much as one sigma of a driven place.
    matrix = design.T @ design + (_SMOOTH / _LINE_SIGMA_M) ** 2 * sum(bend.T @ bend for bend in bends)
    # Without a pull towards level the camber of the road would go on through pavements and houses.
    tilts = [kron(first(shape[0]), identity(shape[1])), kron(identity(shape[0]), first(shape[1]))]
    matrix = matrix + (_LEVEL / _LINE_SIGMA_M) ** 2 * sum(tilt.T @ tilt for tilt in tilts)
    knots = spsolve(matrix.tocsc(), design.T @ (weight * (places[:, 2] - level)))
    return Ground(low, _SPACING_M, knots.reshape(shape[0], shape[1]) + level, np.nan)


def _basis(
    xy: Float64, origin: Float64, spacing: float, shape: tuple[int, ...], order: tuple[int, int]
) -> tuple[Int64, Float64, Bool]:
    """First knot (N, 2), weights (N, 4, 4) of the 16 knots of a place, and whether (N, 2) it is within the grid."""
    most = np.array(shape[:2]) - 3.0
    place = (np.asarray(xy, np.float64) - origin) / spacing
    inside = (place >= 0.0) & (place <= most)
    place = np.clip(place, 0.0, most)
    cell = np.minimum(np.floor(place), most - 1.0).astype(np.int64)
    t = place - cell
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
