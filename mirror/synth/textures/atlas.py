"""The texture atlas: all images and grains with their levels of detail, in flat arrays for compiled kernels."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Float32, Float64, Int64, UInt8
from mirror.synth.textures.catalogue import PERIOD_M, Grain
from mirror.synth.textures.grains import draw_grain
from mirror.synth.textures.images import draw_images

_LEVELS: Final = 10
_LEAST_CONTRAST: Final = 0.002
"""Levels with a smaller root mean square difference from 1 count as constant 1."""
_LOCK: Final = threading.Lock()
BUILT: Final[list[Atlas]] = []


@dataclass(frozen=True)
class Atlas:
    """All images and grains of the synthetic street's surfaces.

    Attributes:
        grains: (T,) texels of all grains and levels, the finest level first, each row by row; rows run along v.
        grain_index: (G, 4) for each grain: index of the first texel, base-2 logarithm of the side in texels, texels
            per metre, and the first level that is constant 1.
        images: (N, 3) texels: square root of linear reflectance times 255; row 0 is at the top.
        image_index: (P, 3 + L) for each image: width, height, number of levels, and the first texel of each level.
    """

    grains: Float32
    grain_index: Float64
    images: UInt8
    image_index: Int64


def atlas() -> Atlas:
    """Return the atlas, which is built at the first call and shared by all callers."""
    with _LOCK:
        if not BUILT:
            BUILT.append(build_atlas())
        return BUILT[0]


def build_atlas() -> Atlas:
    """Draw all textures into a new atlas; `atlas` calls it once and keeps the result."""
    grains, index = _grains()
    images, image_index = _images(draw_images())
    return Atlas(grains, index, images, image_index)


def _grains() -> tuple[Float32, Float64]:
    chains: list[Float32] = []
    index, first = np.zeros((len(Grain), 4)), 0
    for grain in Grain:
        level = draw_grain(grain)
        size = len(level)
        levels = [level]
        while len(level) > 1:
            # The mean of four texels is exact apart from float32 rounding.
            level = 0.25 * (level[::2, ::2] + level[1::2, ::2] + level[::2, 1::2] + level[1::2, 1::2])
            levels.append(level)
        flat = next(n for n, level in enumerate(levels) if level.std() < _LEAST_CONTRAST)
        index[grain] = first, size.bit_length() - 1, size / PERIOD_M[grain], flat
        chains += [level.ravel() for level in levels]
        first += sum(level.size for level in levels)
    return np.concatenate(chains), index


def _images(images: list[UInt8]) -> tuple[UInt8, Int64]:
    index = np.zeros((len(images), 3 + _LEVELS), np.int64)
    first = 0
    for number, image in enumerate(images):
        high, wide, _ = image.shape
        levels = min(high, wide).bit_length()
        index[number, :3] = wide, high, levels
        for level in range(levels):
            index[number, 3 + level] = first
            first += (high >> level) * (wide >> level)
    texels = np.empty((first, 3), np.uint8)
    for number, image in enumerate(images):
        high, wide, _ = image.shape
        texels[index[number, 3] : index[number, 3] + high * wide] = image.reshape(-1, 3)
        _fill(texels, index[number], image)
    return texels, index


@njit(cache=True, nogil=True)
def _fill(texels: UInt8, index: Int64, image: UInt8) -> None:
    """Write the coarser levels of an image, averaged in linear light; each is rounded only once."""
    high, wide = image.shape[0] // 2, image.shape[1] // 2
    light = np.empty((high, wide, 3), np.float32)
    for level in range(1, index[2]):
        at = index[3 + level]
        for i in range(high):
            for j in range(wide):
                for channel in range(3):
                    if level == 1:
                        a, b = (
                            np.float32(image[2 * i, 2 * j, channel]),
                            np.float32(image[2 * i, 2 * j + 1, channel]),
                        )
                        c = np.float32(image[2 * i + 1, 2 * j, channel])
                        d = np.float32(image[2 * i + 1, 2 * j + 1, channel])
                        mean = np.float32(0.25) * (a * a + b * b + c * c + d * d)
                    else:
                        near = light[2 * i, 2 * j, channel] + light[2 * i, 2 * j + 1, channel]
                        far = light[2 * i + 1, 2 * j, channel] + light[2 * i + 1, 2 * j + 1, channel]
                        mean = np.float32(0.25) * (near + far)
                    light[i, j, channel] = mean
                    texels[at + i * wide + j, channel] = np.uint8(np.sqrt(mean) + np.float32(0.5))
        high, wide = high // 2, wide // 2
