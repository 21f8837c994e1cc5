"""Draws grains: periodic grey patterns with mean 1."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from mirror.arrays import Float32
from mirror.synth.textures.catalogue import PERIOD_M, Grain
from mirror.synth.textures.grains import growth, masonry, mineral

_DrawFunction = Callable[[np.random.Generator, int, float], Float32]
_GRAINS: Final[dict[Grain, tuple[_DrawFunction, int]]] = {
    Grain.ASPHALT: (mineral.asphalt, 512),
    Grain.PAVING: (masonry.paving, 512),
    Grain.BRICK: (masonry.brick, 512),
    Grain.PLASTER: (mineral.plaster, 512),
    Grain.CONCRETE: (mineral.concrete, 512),
    Grain.GRASS: (growth.grass, 512),
    Grain.GRAVEL: (mineral.gravel, 512),
    Grain.ROOF: (masonry.roof, 512),
    Grain.WOOD: (masonry.wood, 512),
    Grain.BARK: (growth.bark, 256),
    Grain.LEAVES: (growth.leaves, 512),
    Grain.CLOTH: (growth.cloth, 256),
    Grain.METAL: (growth.metal, 512),
    Grain.STAINS: (mineral.stains, 512),
}
"""The function that draws each grain, and the number of texels along a side: a power of two."""
_DARKEST: Final = 0.08


def draw_grain(grain: Grain) -> Float32:
    """Draw one period of a grain.

    Returns:
        (N, N) factors of the reflectance, mean 1; rows run along v.
    """
    draw, size = _GRAINS[grain]
    pattern = draw(np.random.default_rng([int(grain), 2718]), size, PERIOD_M[grain]).astype(np.float64)
    pattern = np.maximum(pattern, _DARKEST)
    # In float32 the mean is 1 within a few times 1e-8.
    return (pattern / pattern.mean()).astype(np.float32)
