"""The known-operator template attack: how many characters of redacted number plates can be read.

The attacker knows the font, the place of every character and the operator, and has four images of each plate. He
redacts every template himself and takes, character by character, the one that fits all images best.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import cv2
import numpy as np

from mirror.arrays import Float64, UInt8
from mirror.privacy.operators import Redaction, redact
from mirror.privacy.regions import Kind, region_at

ALPHABET: Final = "ABCDEFGHJKLMNPQRSTUVWXYZ0123456789"
LENGTH: Final = 7
CHANCE: Final = 1.0 / len(ALPHABET)
_VIEWS: Final = 4
_NOISE: Final = 3.0
_QUALITY: Final = 90
_MARGIN: Final = 0.4
_SCALE: Final = 2

Operator = Callable[[UInt8, tuple[float, float, float, float]], UInt8]


def redacting(kind: Kind, how: Redaction) -> Operator:
    """Return the operator of the toolkit for a kind of region."""
    return lambda image, box: redact(image, [region_at(box, kind)], how)[0]


def mosaic(columns: int, rows: int) -> Operator:
    """Return a mosaic of the box: the control."""

    def work(image: UInt8, box: tuple[float, float, float, float]) -> UInt8:
        left, top, right, bottom = (round(edge) for edge in box)
        result = image.copy()
        part = image[top:bottom, left:right]
        small = cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA)
        result[top:bottom, left:right] = cv2.resize(
            small, (right - left, bottom - top), interpolation=cv2.INTER_NEAREST
        )
        return result

    return work


def read_plates(operator: Operator, width_px: int, plates: int, seed: int = 0) -> float:
    """Return the share of characters that the attack reads.

    Args:
        operator: redacts an image (H, W, 3) in a box.
        width_px: width of a plate.
        plates: number of plates.
        seed: seed of texts, places and noise.
    """
    rng = np.random.default_rng(seed)
    right = 0
    for _ in range(plates):
        text = "".join(rng.choice(list(ALPHABET), LENGTH))
        # The four views differ in size and in where the plate lies on the raster.
        views = [(width_px * rng.uniform(0.9, 1.1), rng.uniform(0.0, 1.0, 2)) for _ in range(_VIEWS)]
        seen = [_photograph(operator, text, size, shift, rng) for size, shift in views]
        guess = "A" * LENGTH
        for _ in range(2):
            for place in range(LENGTH):
                errors = []
                for letter in ALPHABET:
                    candidate = guess[:place] + letter + guess[place + 1 :]
                    errors.append(
                        sum(
                            float(((_redacted(operator, candidate, size, shift) - image) ** 2).mean())
                            for (size, shift), image in zip(views, seen)
                        )
                    )
                guess = guess[:place] + ALPHABET[int(np.argmin(errors))] + guess[place + 1 :]
        right += sum(one == other for one, other in zip(guess, text))
    return right / (plates * LENGTH)


def _photograph(operator: Operator, text: str, size: float, shift: Float64, rng: np.random.Generator) -> Float64:
    """Make what is published: a noisy image, redacted, and encoded as a JPEG."""
    image, box = _draw(text, size, shift)
    noisy = np.clip(image + rng.normal(0.0, _NOISE, image.shape), 0.0, 255.0).astype(np.uint8)
    encoded = cv2.imencode(".jpg", operator(noisy, box), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR), np.float64)


def _redacted(operator: Operator, text: str, size: float, shift: Float64) -> Float64:
    image, box = _draw(text, size, shift)
    return operator(image, box).astype(np.float64)


def _draw(text: str, size: float, shift: Float64) -> tuple[UInt8, tuple[float, float, float, float]]:
    """An image (H, W, 3) of a plate on a grey bumper, and the plate's box."""
    height, margin = size * 0.25, size * _MARGIN
    shape = (int(np.ceil(height + 2 * margin)) + 2, int(np.ceil(size + 2 * margin)) + 2)
    left, top = margin + shift[0], margin + shift[1]
    fine = np.full((shape[0] * _SCALE, shape[1] * _SCALE), 90, np.uint8)
    corner = tuple(round(edge * _SCALE) for edge in (left, top))
    end = tuple(round(edge * _SCALE) for edge in (left + size, top + height))
    cv2.rectangle(fine, corner, end, 235, -1)
    step = size / (LENGTH + 0.6)
    for place, letter in enumerate(text):
        at = round((left + step * (place + 0.4)) * _SCALE), round((top + 0.8 * height) * _SCALE)
        cv2.putText(fine, letter, at, cv2.FONT_HERSHEY_SIMPLEX, height * _SCALE * 0.6 / 21.0, 20, _thickness(height))
    grey = cv2.resize(fine, (shape[1], shape[0]), interpolation=cv2.INTER_AREA)
    return np.repeat(grey[..., None], 3, axis=2), (left, top, left + size, top + height)


def _thickness(height: float) -> int:
    return max(round(height * _SCALE * 0.09), 1)
