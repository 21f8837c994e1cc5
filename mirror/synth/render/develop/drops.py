"""Rain on a lens: drops out of focus, each of which shows an inverted image of the street."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Float32, Records
from mirror.portable import arrays
from mirror.synth.render.develop.glare import QUARTER, quarter_excess

DROP: Final = np.dtype([(name, np.float64) for name in ("x", "y", "half_x", "half_y", "reach", "depth")])
"""A drop: centre, half axes and half the width of the image region that it shows, in image widths; and its opacity."""

_DRY: Final = 0.4
_MOST: Final = 26
_SOFT: Final = 0.8
_DARK_RIM: Final = 0.45


def draw_lens_drops(seed: int | Sequence[int] | np.random.SeedSequence, aspect: float) -> Records:
    """Draw the drops (N,) DROP on a lens; two lenses in five have none.

    Args:
        seed: seed of the drive and the camera; drops do not move during a drive.
        aspect: height of the image divided by its width.
    """
    rng = np.random.default_rng(seed)
    count = 0 if rng.random() < _DRY else int(rng.integers(4, _MOST))
    drops = np.zeros(count, DROP)
    drops["x"], drops["y"] = rng.uniform(0.0, 1.0, count), rng.uniform(0.0, aspect, count)
    # Most drops are small, few are large.
    size = 0.007 + 0.034 * arrays.power(rng.random(count), 3.0)
    drops["half_x"], drops["half_y"] = size, size * rng.uniform(0.95, 1.5, count)
    drops["reach"], drops["depth"] = size * rng.uniform(2.5, 5.0, count), rng.uniform(0.6, 0.95, count)
    return drops


def refract_drops(image: Float32, drops: Records) -> Float32:
    """Refract an image (H, W, 3) of radiance through drops (N,) DROP; pixels outside the drops do not change."""
    import cv2

    small, _ = quarter_excess(image, np.ones(3), 0.0, np.inf)
    out = image.copy()
    soft = cv2.GaussianBlur(small, (0, 0), max(image.shape[1] / 640.0, 0.5))
    _refract(np.asarray(soft, np.float32), drops, out)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _refract(small: Float32, drops: Records, out: Float32) -> None:
    height, width = out.shape[:2]
    for index in range(len(drops)):
        drop = drops[index]
        x, y, wide, high = drop.x * width, drop.y * width, drop.half_x * width, drop.half_y * width
        reach = drop.reach * width
        for row in range(max(int(y - high), 0), min(int(y + high) + 1, height)):
            down = (row + 0.5 - y) / high
            for column in range(max(int(x - wide), 0), min(int(x + wide) + 1, width)):
                right = (column + 0.5 - x) / wide
                square = right * right + down * down
                if square >= 1.0:
                    continue
                edge = min((1.0 - square) / _SOFT, 1.0)
                cover = drop.depth * edge * edge * (3.0 - 2.0 * edge)
                bend = reach * (1.0 + square)
                i = min(max(int((y - down * bend) / QUARTER), 0), small.shape[0] - 1)
                j = min(max(int((x - right * bend) / QUARTER), 0), small.shape[1] - 1)
                shade = 1.0 - _DARK_RIM * square * square
                for channel in range(3):
                    here = out[row, column, channel]
                    out[row, column, channel] = here + cover * (shade * small[i, j, channel] - here)
