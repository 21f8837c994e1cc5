"""Draws the images of the catalogue."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from mirror.arrays import UInt8
from mirror.synth.textures import catalogue
from mirror.synth.textures.faces import face_image
from mirror.synth.textures.images.adverts import billboard, livery, poster
from mirror.synth.textures.images.plates import plate_image
from mirror.synth.textures.images.shops import shop_sign
from mirror.synth.textures.images.signs import direction_sign, traffic_sign
from mirror.synth.textures.images.walls import door, graffiti
from mirror.synth.textures.images.windows import shop_window


class _Kind(NamedTuple):
    """One kind of images.

    Attributes:
        numbers: numbers in the catalogue.
        wide: width in texels.
        high: height in texels.
        draw: function that draws one image from a generator, its size, and its index among the images of its kind.
    """

    numbers: range
    wide: int
    high: int
    draw: Callable[[np.random.Generator, int, int, int], UInt8]


_KINDS: Final = (
    _Kind(catalogue.SHOP_SIGNS, 640, 128, shop_sign),
    _Kind(catalogue.BILLBOARDS, 384, 256, billboard),
    _Kind(catalogue.POSTERS, 256, 384, poster),
    _Kind(catalogue.TRAFFIC_SIGNS, 128, 128, traffic_sign),
    _Kind(catalogue.DIRECTION_SIGNS, 512, 256, direction_sign),
    _Kind(catalogue.SHOP_WINDOWS, 384, 256, shop_window),
    _Kind(catalogue.DOORS, 128, 256, door),
    _Kind(catalogue.GRAFFITI, 512, 256, graffiti),
    _Kind(catalogue.LIVERIES, 512, 256, livery),
)
_FACE_PX: Final = 128


def draw_image(number: int) -> UInt8:
    """Draw an image of the catalogue.

    Returns:
        (H, W, 3) red, green and blue, 255 times the square root of linear reflectance; row 0 is at the top.
    """
    if number in catalogue.PLATES:
        return plate_image(number)
    if number in catalogue.FACES:
        root = np.sqrt(np.clip(face_image(number, _FACE_PX), 0.0, 1.0))
        return (255.0 * root + 0.5).astype(np.uint8)
    kind = next(kind for kind in _KINDS if number in kind.numbers)
    rng = np.random.default_rng([number, 3141])
    return kind.draw(rng, kind.wide, kind.high, number - kind.numbers.start)


def draw_images() -> list[UInt8]:
    """Draw all images of the catalogue, in order of their numbers."""
    return [draw_image(number) for number in range(catalogue.COUNT)]
