"""Number plates: white, with a blue band on their left and bold dark characters."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from mirror.arrays import UInt8
from mirror.errors import UsageError
from mirror.synth.textures.catalogue import PLATES
from mirror.synth.textures.pictures.drawing import disc, plain, rounded
from mirror.synth.textures.pictures.lettering import letter

_LETTERS: Final = "ABCDEFGHJKLMNPRSTUVWXYZ"
_DIGITS: Final = "0123456789"
_COUNTRIES: Final = "DFIABE"
_WHITE: Final = (226, 226, 221)
_BLACK: Final = (26, 26, 28)
_BLUE: Final = (22, 58, 140)
_YELLOW: Final = (236, 196, 40)
_WIDE_MM: Final = 520.0
_HIGH_MM: Final = 110.0


def plate_text(number: int) -> str:
    """What a number plate says.

    Args:
        number: picture of the catalogue, one of PLATES.

    Returns:
        Two letters, two letters and three digits, parted by spaces, such as ``KB TR 482``; all plates differ.

    Raises:
        UsageError: another picture.
    """
    if number not in PLATES:
        raise UsageError(f"plate {number}", expected=f"{PLATES.start} to {PLATES.stop - 1}")
    rng = np.random.default_rng([number, 520])
    letters = "".join(rng.choice(list(_LETTERS), 4))
    # The number itself takes part, so that no two plates are alike.
    digits = f"{(number - PLATES.start) * 3 + 137:03d}"
    return f"{letters[:2]} {letters[2:]} {digits}"


def plate_image(number: int, wide: int = 256, high: int = 64) -> UInt8:
    """Picture of a number plate.

    Args:
        number: picture of the catalogue, one of PLATES.
        wide: pixels; the plate fills the picture, whatever its shape.
        high: pixels.

    Returns:
        (H, W, 3) red, green and blue, 255 times the square root of linear reflectance.

    Raises:
        UsageError: another picture.
    """
    text = plate_text(number)
    # Drawn twice as large in the right proportion: letters keep their shape when the picture is squeezed.
    scale = 2 * wide / _WIDE_MM
    image = plain(2 * wide, round(_HIGH_MM * scale), _BLACK)
    rounded(image, (3 * scale, 3 * scale, 517 * scale, 107 * scale), 7 * scale, _WHITE)
    rounded(image, (4 * scale, 4 * scale, 43 * scale, 106 * scale), 6 * scale, _BLUE)
    for angle in np.arange(12) * (np.pi / 6):
        disc(image, (23.5 + 12 * np.sin(angle)) * scale, (32 + 12 * np.cos(angle)) * scale, 2.2 * scale, _YELLOW)
    country = _COUNTRIES[number % len(_COUNTRIES)]
    letter(image, country, (15 * scale, 62 * scale, 33 * scale, 92 * scale), _WHITE, 5.0 * scale)
    at = 60.0
    for sign in text:
        if sign == " ":
            at += 27.0
            continue
        width = 45.0 if sign.isalpha() else 42.5
        letter(image, sign, (at * scale, 18 * scale, (at + width) * scale, 92 * scale), _BLACK, 9.5 * scale)
        at += width + 8.5
    small: UInt8 = cv2.resize(image, (wide, high), interpolation=cv2.INTER_AREA)
    return small
