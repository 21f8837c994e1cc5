"""Pictures of the catalogue."""

from __future__ import annotations

import numpy as np

from mirror.arrays import UInt8
from mirror.synth.textures.catalogue import (
    BILLBOARDS,
    COUNT,
    DIRECTION_SIGNS,
    DOORS,
    FACES,
    GRAFFITI,
    LIVERIES,
    PLATES,
    POSTERS,
    SHOP_SIGNS,
    SHOP_WINDOWS,
    TRAFFIC_SIGNS,
)

SIZES = {
    SHOP_SIGNS: (512, 128),
    BILLBOARDS: (512, 256),
    POSTERS: (256, 256),
    TRAFFIC_SIGNS: (128, 128),
    DIRECTION_SIGNS: (512, 256),
    SHOP_WINDOWS: (512, 256),
    DOORS: (128, 256),
    GRAFFITI: (256, 128),
    LIVERIES: (512, 256),
    FACES: (128, 128),
    PLATES: (256, 64),
}
"""Texels across and down."""


def draw_pictures() -> list[UInt8]:
    """All pictures by number: (H, W, 3) red, green and blue, the square root of linear reflectance times 255."""
    pictures: list[UInt8] = [np.zeros((1, 1, 3), np.uint8)] * COUNT
    for numbers, (wide, high) in SIZES.items():
        for number in numbers:
            rng = np.random.default_rng([number, 3141])
            picture = np.empty((high, wide, 3), np.uint8)
            picture[:] = rng.integers(90, 230, 3)
            picture[high // 4 : high // 2, wide // 8 : wide // 2] = rng.integers(30, 240, 3)
            pictures[number] = picture
    return pictures
