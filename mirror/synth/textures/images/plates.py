"""Draws number plates: white, with a blue band on the left and bold dark characters."""

from __future__ import annotations

from functools import cache
from typing import Final

import cv2
import numpy as np

from mirror.arrays import UInt8
from mirror.errors import UsageError
from mirror.portable import arrays
from mirror.synth.textures.catalogue import PLATES
from mirror.synth.textures.images.drawing import disc, new_image, rounded_rectangle
from mirror.synth.textures.images.lettering import letter

_LETTERS: Final = "ABCDEFGHJKLMNPRSTUVWXYZ"
_UNUSED: Final = ("SS", "SA", "NS", "HJ", "KZ", "HH", "AH")
"""Pairs of letters that authorities do not issue."""
_COUNTRIES: Final = "DFIABE"
_WHITE: Final = (226, 226, 221)
_BLACK: Final = (26, 26, 28)
_BLUE: Final = (22, 58, 140)
_YELLOW: Final = (236, 196, 40)
_SCALE: Final = 1.0
"""Pixels per millimetre of a drawn plate."""
_WIDE_MM: Final = 520.0
_HIGH_MM: Final = 110.0
_FIRST_MM: Final = 58.0
_TOP_MM: Final = 18.0
_TALL_MM: Final = 74.0
_LETTER_MM: Final = 45.0
_DIGIT_MM: Final = 42.5
_GAP_MM: Final = 8.0
_SPACE_MM: Final = 30.0
_STROKE_MM: Final = 10.0


def plate_text(number: int) -> str:
    """Return the text of a number plate.

    Args:
        number: image of the catalogue, one of PLATES.

    Returns:
        Two letters, two letters and three digits, separated by spaces, such as ``KB TR 482``; all plates differ.

    Raises:
        UsageError: the image is not one of PLATES.
    """
    if number not in PLATES:
        raise UsageError(f"plate {number}", expected=f"{PLATES.start} to {PLATES.stop - 1}")
    rng = np.random.default_rng([number, 520])
    while True:
        letters = "".join(rng.choice(list(_LETTERS), 4))
        if letters[:2] not in _UNUSED and letters[2:] not in _UNUSED:
            break
    # The number is part of the text, so that all plates differ.
    digits = f"{(number - PLATES.start) * 3 + 137:03d}"
    return f"{letters[:2]} {letters[2:]} {digits}"


def plate_image(number: int, wide: int = 256, high: int = 64) -> UInt8:
    """Draw the image of a number plate.

    Args:
        number: image of the catalogue, one of PLATES.
        wide: width in pixels; the plate fills the image for any aspect.
        high: height in pixels.

    Returns:
        (H, W, 3) red, green and blue: 255 times the square root of linear reflectance.

    Raises:
        UsageError: the image is not one of PLATES.
    """
    text = plate_text(number)
    image = _blank(_COUNTRIES[number % len(_COUNTRIES)]).copy()
    at = _FIRST_MM
    for sign in text:
        if sign == " ":
            at += _SPACE_MM
            continue
        stamp = _character(sign)
        left, top = round(at * _SCALE), round(_TOP_MM * _SCALE)
        image[top : top + stamp.shape[0], left : left + stamp.shape[1]] = stamp
        at += (_LETTER_MM if sign.isalpha() else _DIGIT_MM) + _GAP_MM
    # Area averaging keeps the edges of letters smooth when the image is scaled.
    return cv2.resize(image, (wide, high), interpolation=cv2.INTER_AREA).astype(np.uint8)


@cache
def _blank(country: str) -> UInt8:
    """Draw a plate without characters."""
    image = new_image(round(_WIDE_MM * _SCALE), round(_HIGH_MM * _SCALE), _BLACK)
    rounded_rectangle(image, (3 * _SCALE, 3 * _SCALE, 517 * _SCALE, 107 * _SCALE), 7 * _SCALE, _WHITE)
    rounded_rectangle(image, (4 * _SCALE, 4 * _SCALE, 43 * _SCALE, 106 * _SCALE), 6 * _SCALE, _BLUE)
    for angle in np.arange(12) * (np.pi / 6):
        x, y = (23.5 + 12 * arrays.sin(angle)) * _SCALE, (32 + 12 * arrays.cos(angle)) * _SCALE
        disc(image, x, y, 2.2 * _SCALE, _YELLOW)
    letter(image, country, (15 * _SCALE, 62 * _SCALE, 33 * _SCALE, 92 * _SCALE), _WHITE, 5.0 * _SCALE)
    return image


@cache
def _character(sign: str) -> UInt8:
    """Draw a letter or a digit on white."""
    width = (_LETTER_MM if sign.isalpha() else _DIGIT_MM) * _SCALE
    image = new_image(round(width), round(_TALL_MM * _SCALE), _WHITE)
    letter(image, sign, (0.0, 0.0, width, _TALL_MM * _SCALE), _BLACK, _STROKE_MM * _SCALE)
    return image
