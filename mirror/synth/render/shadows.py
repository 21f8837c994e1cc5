"""Shadow maps of the sun: the height of the surfaces towards the sun, over the plane perpendicular to its direction."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from mirror.arrays import Float32, Float64, Records
from mirror.compiled import inner_numpy_njit, per_pixel
from mirror.portable import arrays
from mirror.synth.model import FACE, ROUND, Model, flat

CELL_M: Final = 0.125
_NOTHING_M: Final = -1e9


class ShadowMap(NamedTuple):
    """A shadow map of the sun.

    Attributes:
        height: (rows, columns) metres along the sun's direction; very low where there is no surface.
        origin: (2,) middle of the first cell in the plane, metres.
    """

    height: Float32
    origin: Float64

    @classmethod
    def none(cls) -> ShadowMap:
        """Return an empty map: nothing casts a shadow."""
        return cls(np.zeros((0, 0), np.float32), np.zeros(2))


def sun_axes(sun: Float64) -> Float64:
    """Return two unit axes (2, 3) perpendicular to the sun's direction (3,); the first is horizontal."""
    across = np.cross([0.0, 0.0, 1.0], sun)
    size = arrays.norm(across)
    across = across / size if size > 1e-9 else np.array([1.0, 0.0, 0.0])
    return np.stack([across, np.cross(sun, across)])


def render_shadow_map(model: Model, sun: Float64, centre: Float64, reach_m: float) -> ShadowMap:
    """Render the shadow map of a model.

    Args:
        model: the surfaces that cast shadows.
        sun: (3,) unit direction to the sun.
        centre: (3,) centre of the mapped region, metres.
        reach_m: half the width of the mapped region.
    """
    axes = sun_axes(sun)
    if not len(model):
        return ShadowMap.none()
    plane = arrays.matmul(np.concatenate([model.corners, *_extremes(model.rounds, axes)]), axes.T)
    middle = arrays.matmul(axes, centre)
    low, high = np.maximum(plane.min(axis=0), middle - reach_m), np.minimum(plane.max(axis=0), middle + reach_m)
    if (high <= low).any():
        return ShadowMap.none()
    # All maps use the same lattice of cells, so that an object casts the same shadow in every map.
    low = np.floor(low / CELL_M) * CELL_M
    columns, rows = np.ceil((high - low) / CELL_M).astype(int) + 1
    height = np.full((rows, columns), _NOTHING_M, np.float32)
    _fill(model.faces.view(flat(FACE)), model.corners, model.rounds.view(flat(ROUND)), sun, axes, low, height)
    return ShadowMap(height, low)


def _extremes(rounds: Records, axes: Float64) -> tuple[Float64, ...]:
    extremes = []
    for axis in axes:
        reach = np.linalg.norm(np.einsum("nij,j->ni", rounds["axes"], axis) * rounds["half"], axis=1)
        extremes += [rounds["centre"] + reach[:, None] * axis, rounds["centre"] - reach[:, None] * axis]
    return tuple(extremes)


@njit(cache=True, nogil=True, error_model="numpy")
def _fill(
    faces: Records, corners: Float64, rounds: Records, sun: Float64, axes: Float64, low: Float64, height: Float32
) -> None:
    a, b, h = np.empty(32), np.empty(32), np.empty(32)
    for index in range(len(faces)):
        face = faces[index]
        facing = face.normal_0 * sun[0] + face.normal_1 * sun[1] + face.normal_2 * sun[2]
        # Sides that face away from the sun are in the shadow of the other sides.
        if (facing <= 0.0 and not face.two_sided) or abs(facing) < 1e-4:
            continue
        count = face.count
        for k in range(count):
            x, y, z = corners[face.first + k, 0], corners[face.first + k, 1], corners[face.first + k, 2]
            a[k] = (axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z - low[0]) / CELL_M
            b[k] = (axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z - low[1]) / CELL_M
            h[k] = sun[0] * x + sun[1] * y + sun[2] * z
        # The height along the sun's direction is an affine function of (a, b).
        na = (face.normal_0 * axes[0, 0] + face.normal_1 * axes[0, 1] + face.normal_2 * axes[0, 2]) * CELL_M / facing
        nb = (face.normal_0 * axes[1, 0] + face.normal_1 * axes[1, 1] + face.normal_2 * axes[1, 2]) * CELL_M / facing
        _fill_polygon(a, b, h, count, na, nb, height)
    for index in range(len(rounds)):
        _fill_round(rounds[index], sun, axes, low, height)


@inner_numpy_njit
def _fill_polygon(a: Float64, b: Float64, h: Float64, count: int, na: float, nb: float, height: Float32) -> None:
    least, most, highest = b[0], b[0], h[0]
    for k in range(1, count):
        least, most, highest = min(least, b[k]), max(most, b[k]), max(highest, h[k])
    for row in range(max(math.ceil(least), 0), min(math.floor(most), height.shape[0] - 1) + 1):
        left, right = 1e18, -1e18
        for k in range(count):
            j = k + 1 if k + 1 < count else 0
            if (b[k] <= row) != (b[j] <= row):
                at = a[k] + (row - b[k]) / (b[j] - b[k]) * (a[j] - a[k])
                left, right = min(left, at), max(right, at)
        if right < left:
            continue
        base = h[0] + a[0] * na - (row - b[0]) * nb
        for column in range(max(math.ceil(left), 0), min(math.floor(right), height.shape[1] - 1) + 1):
            height[row, column] = max(height[row, column], min(base - column * na, highest))


@inner_numpy_njit
def _fill_round(ellipsoid: Records, sun: Float64, axes: Float64, low: Float64, height: Float32) -> None:
    reach = max(ellipsoid.half_0, ellipsoid.half_1, ellipsoid.half_2)
    x, y, z = ellipsoid.centre_0, ellipsoid.centre_1, ellipsoid.centre_2
    a = axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z - low[0]
    b = axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z - low[1]
    along = sun[0] * x + sun[1] * y + sun[2] * z
    sx = (ellipsoid.axes_00 * sun[0] + ellipsoid.axes_01 * sun[1] + ellipsoid.axes_02 * sun[2]) / ellipsoid.half_0
    sy = (ellipsoid.axes_10 * sun[0] + ellipsoid.axes_11 * sun[1] + ellipsoid.axes_12 * sun[2]) / ellipsoid.half_1
    sz = (ellipsoid.axes_20 * sun[0] + ellipsoid.axes_21 * sun[1] + ellipsoid.axes_22 * sun[2]) / ellipsoid.half_2
    square = sx * sx + sy * sy + sz * sz
    for row in range(
        max(math.ceil((b - reach) / CELL_M), 0), min(math.floor((b + reach) / CELL_M), height.shape[0] - 1) + 1
    ):
        for column in range(
            max(math.ceil((a - reach) / CELL_M), 0), min(math.floor((a + reach) / CELL_M), height.shape[1] - 1) + 1
        ):
            u, v = column * CELL_M - a, row * CELL_M - b
            dx, dy, dz = (
                u * axes[0, 0] + v * axes[1, 0],
                u * axes[0, 1] + v * axes[1, 1],
                u * axes[0, 2] + v * axes[1, 2],
            )
            px = (ellipsoid.axes_00 * dx + ellipsoid.axes_01 * dy + ellipsoid.axes_02 * dz) / ellipsoid.half_0
            py = (ellipsoid.axes_10 * dx + ellipsoid.axes_11 * dy + ellipsoid.axes_12 * dz) / ellipsoid.half_1
            pz = (ellipsoid.axes_20 * dx + ellipsoid.axes_21 * dy + ellipsoid.axes_22 * dz) / ellipsoid.half_2
            middle = px * sx + py * sy + pz * sz
            inside = middle * middle - square * (px * px + py * py + pz * pz - 1.0)
            if inside > 0.0:
                height[row, column] = max(height[row, column], along + (-middle + math.sqrt(inside)) / square)


@per_pixel()
def sun_visibility(height: Float32, column: float, row: float, along: float) -> float:
    """Compute the share of the sun that is visible from a point.

    Args:
        height: heights of a shadow map.
        column: column of the point, in cells.
        row: row of the point, in cells.
        along: height of the point along the sun's direction, metres.

    Returns:
        0 to 1: bilinear over the four nearest cells.
    """
    i, j = math.floor(row), math.floor(column)
    if not (0 <= j < height.shape[1] - 1 and 0 <= i < height.shape[0] - 1):
        return 1.0
    u, v = column - j, row - i
    before = (1.0 - u) * (height[i, j] <= along) + u * (height[i, j + 1] <= along)
    next_row = (1.0 - u) * (height[i + 1, j] <= along) + u * (height[i + 1, j + 1] <= along)
    return (1.0 - v) * before + v * next_row
