"""Packs the data of each Gaussian for blending into one row, in one or two cache lines."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.memory import empty_aligned
from hybridworldsim.kernels.threads import in_parallel, spans
from hybridworldsim.rasterizer.cpu.blending.canvas import TILE_PX
from hybridworldsim.rasterizer.presets import ALPHA_MIN
from mirror.arrays import AnyArray, Float32, Float64, Int32

MEAN: Final = 0
MEAN_LOW: Final = 2
FACTORS: Final = 4
LEVEL: Final = 7
REACH: Final = 8
F12_LOW: Final = 10
FEATURES: Final = 12
"""Columns of a row: the mean (2), the rounding error of the mean (2), the factors (3), log2 of the opacity, the squared
greatest distances of the centre of a block that the ellipse may touch (2: in (u, v), and in v), the rounding error of
the second factor, one unused column, and the features."""

FLOOR: Final = np.float32(math.log2(ALPHA_MIN))
"""log2 of the least alpha that is blended. Factors are scaled so that alpha = 2 ** (level - u^2 - v^2)."""

_SCALE: Final = math.sqrt(0.5 * math.log2(math.e))
_SLACK_PX: Final = 0.02
_SLACK: Final = np.float32(1e-3)


class Splats(NamedTuple):
    """Gaussians as the blending kernels read them.

    Attributes:
        rows: (M * stride,) rows with the columns above.
        stride: length of a row.
        channels: number of feature channels, at least 4.
        boxes: (M, 4) tiles of each Gaussian: first column, one past the last column, and the same for rows.
    """

    rows: Float32
    stride: int
    channels: int
    boxes: AnyArray


def pack_splats(
    means: Float32,
    means_low: Float32,
    factors: Float64,
    opacities: Float32,
    features: Float32,
    radii: Int32,
    tiles_x: int,
    tiles_y: int,
) -> Splats:
    """Pack Gaussians for blending.

    Args:
        means: (M, 2) pixels.
        means_low: (M, 2) rounding errors of the means.
        factors: (M, 3).
        opacities: (M,).
        features: (M, D).
        radii: (M, 2) half extents, pixels.
        tiles_x: columns of tiles.
        tiles_y: rows of tiles.
    """
    count, channels = features.shape
    padded_channels = max(4, channels)
    stride = 4 * ((FEATURES + padded_channels + 3) // 4)
    rows, boxes = empty_aligned(count * stride), np.empty((count, 4), np.uint16)
    with np.errstate(divide="ignore", invalid="ignore"):
        levels = np.log2(opacities)
    edges = spans(count)

    def pack(part: int) -> None:
        _pack(
            edges[part], edges[part + 1], means, means_low, factors, levels, features, radii, tiles_x, tiles_y,
            rows, stride, boxes,
        )  # fmt: skip

    in_parallel(pack, len(edges) - 1)
    return Splats(rows, stride, padded_channels, boxes)


@kernel(inline="always")
def load_factors(rows: Float32, row: Any) -> Any:
    """Load the three factors of a row as float64."""
    f12_exact = np.float64(rows[row + FACTORS + 1]) + rows[row + F12_LOW]
    return np.float64(rows[row + FACTORS]), f12_exact, np.float64(rows[row + FACTORS + 2])


@kernel(inline="always")
def to_unit_space(rows: Float32, row: Any, x: Any, y: Any) -> Any:
    """Transform a point of the image to (u, v), the space in which a Gaussian is round.

    The computation is in float64: far along a needle both terms of u are much larger than its width.
    """
    f11, f12, f22 = load_factors(rows, row)
    dx = (np.float64(x) - rows[row + MEAN]) - rows[row + MEAN_LOW]
    dy = (np.float64(y) - rows[row + MEAN + 1]) - rows[row + MEAN_LOW + 1]
    return np.float32(f11 * dx + f12 * dy), np.float32(f22 * dy)


@kernel(inline="always")
def _tile(pixel: Any, tiles: int) -> int:
    """Compute the tile index of a coordinate, from 0 to the number of tiles."""
    return int(min(max(pixel * np.float32(1.0 / TILE_PX), np.float32(0.0)), np.float32(tiles)))


@kernel()
def _pack(
    begin: int,
    end: int,
    means: Float32,
    means_low: Float32,
    factors: Float64,
    levels: Float32,
    features: Float32,
    radii: Int32,
    tiles_x: int,
    tiles_y: int,
    rows: Float32,
    stride: int,
    boxes: AnyArray,
) -> None:
    """Pack the Gaussians from begin to end."""
    channels, one = features.shape[1], np.float32(1.0)
    slack, up = np.float32(_SLACK_PX), np.float32(TILE_PX)
    for i in range(begin, end):
        row = np.uint64(i * stride)
        x, y, level = means[i, 0], means[i, 1], levels[i]
        f11, f22 = np.float32(factors[i, 0] * _SCALE), np.float32(factors[i, 2] * _SCALE)
        # rounding f11 or f22 slightly changes a needle's width or length; its direction f12 / f11 has to stay exact
        f12_exact = factors[i, 1] / factors[i, 0] * f11
        f12 = np.float32(f12_exact)
        rows[row], rows[row + np.uint64(1)] = x, y
        rows[row + np.uint64(2)], rows[row + np.uint64(3)] = means_low[i, 0], means_low[i, 1]
        rows[row + np.uint64(4)], rows[row + np.uint64(5)], rows[row + np.uint64(6)] = f11, f12, f22
        rows[row + np.uint64(7)] = level
        reach = math.sqrt(max(level - FLOOR, np.float32(0.0)))
        block_u, block_v = np.float32(1.5) * (f11 + abs(f12)), np.float32(1.5) * f22
        near, near_v = reach + math.sqrt(block_u * block_u + block_v * block_v), reach + block_v
        rows[row + np.uint64(8)] = near * near * (one + _SLACK)
        rows[row + np.uint64(9)] = near_v * near_v * (one + _SLACK)
        rows[row + np.uint64(10)] = np.float32(f12_exact - f12)
        for channel in range(channels):
            rows[row + np.uint64(FEATURES + channel)] = features[i, channel]
        for channel in range(channels, stride - FEATURES):
            rows[row + np.uint64(FEATURES + channel)] = np.float32(0.0)
        shear = f12 / f22
        half_x = min(reach * math.sqrt(one + shear * shear) / f11 + slack, np.float32(radii[i, 0]))
        half_y = min(reach / f22 + slack, np.float32(radii[i, 1]))
        x0, x1 = _tile(x - half_x, tiles_x), _tile(x + half_x + up, tiles_x)
        y0, y1 = _tile(y - half_y, tiles_y), _tile(y + half_y + up, tiles_y)
        if not level >= FLOOR:
            x0, y0, x1, y1 = 0, 0, 0, 0
        boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3] = x0, x1, y0, y1
