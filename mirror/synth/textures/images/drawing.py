"""Draws anti-aliased shapes on images.

Images are (H, W, 3) red, green and blue, each 255 times the square root of linear reflectance.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

from mirror.arrays import Float32, UInt8
from mirror.portable import arrays

Colour = tuple[int, int, int]
Box = tuple[float, float, float, float]
"""Left, top, right, bottom, pixels."""
_SHIFT = 4


def new_image(wide: int, high: int, colour: Colour) -> UInt8:
    """Return an image of one colour."""
    image = np.empty((high, wide, 3), np.uint8)
    cv2.rectangle(image, (0, 0), (wide, high), colour, -1)
    return image


def part(image: UInt8, box: Box) -> UInt8:
    """Return a view of a part of an image; drawings on it are clipped."""
    left, top, right, bottom = (max(round(edge), 0) for edge in box)
    return image[top:bottom, left:right]


def to_fixed_point(points: npt.ArrayLike) -> npt.NDArray[np.int32]:
    """Convert points to OpenCV's fixed-point coordinates in sixteenths of pixels; pixel centres are at halves."""
    return ((np.asarray(points, np.float64) - 0.5) * 2**_SHIFT).round().astype(np.int32)


def fill(image: UInt8, points: npt.ArrayLike, colour: Colour) -> None:
    """Draw a filled polygon of (N, 2) corners."""
    cv2.fillPoly(image, [to_fixed_point(points)], colour, cv2.LINE_AA, _SHIFT)


def stroke(image: UInt8, points: npt.ArrayLike, colour: Colour, width: float, closed: bool = False) -> None:
    """Draw a line through (N, 2) points, with round ends."""
    cv2.polylines(image, [to_fixed_point(points)], closed, colour, max(round(width), 1), cv2.LINE_AA, _SHIFT)


def rectangle(image: UInt8, box: Box, colour: Colour) -> None:
    """Draw a filled rectangle."""
    left, top, right, bottom = box
    fill(image, [(left, top), (right, top), (right, bottom), (left, bottom)], colour)


def rounded_rectangle(image: UInt8, box: Box, radius: float, colour: Colour) -> None:
    """Draw a filled rectangle with round corners."""
    left, top, right, bottom = box
    radius = min(radius, 0.5 * (right - left), 0.5 * (bottom - top))
    turn = np.linspace(0.0, 0.5 * np.pi, 7)
    corner = radius * np.c_[arrays.cos(turn), -arrays.sin(turn)]
    spots = [(right - radius, top + radius), (left + radius, top + radius)]
    spots += [(left + radius, bottom - radius), (right - radius, bottom - radius)]
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    outline = []
    for spot in spots:
        outline.append(corner + spot)
        corner = arrays.matmul(corner, quarter)
    fill(image, np.concatenate(outline), colour)


def disc(image: UInt8, x: float, y: float, radius: float, colour: Colour, tall: float = 1.0) -> None:
    """Draw a filled circle, or an ellipse that is ``tall`` times as high as wide."""
    centre = to_fixed_point((x, y))
    axes = (max(round(radius * 2**_SHIFT), 1), max(round(radius * tall * 2**_SHIFT), 1))
    cv2.ellipse(image, centre.tolist(), axes, 0, 0, 360, colour, -1, cv2.LINE_AA, _SHIFT)


def star(x: float, y: float, radius: float, points: int, inner: float, turn: float = 0.0) -> npt.NDArray[np.float64]:
    """Return the corners of a star."""
    angle = np.arange(2 * points) * np.pi / points + turn
    reach = np.where(np.arange(2 * points) % 2 == 0, radius, radius * inner)
    return np.c_[x + reach * arrays.sin(angle), y - reach * arrays.cos(angle)]


def gradient(image: UInt8, top: Colour, bottom: Colour) -> None:
    """Fill an image with a vertical gradient."""
    high, wide = image.shape[:2]
    share = np.linspace(0.0, 1.0, high)[:, None, None]
    shades = np.asarray(top) * (1.0 - share) + np.asarray(bottom) * share
    image[:] = cv2.resize(shades.round().astype(np.uint8), (wide, high), interpolation=cv2.INTER_NEAREST)


def glow(image: UInt8, x: float, y: float, radius: float, strength: float, colour: Colour = (255, 240, 205)) -> None:
    """Add light that falls off around a point."""
    near = part(image, (x - 1.7 * radius, y - 1.7 * radius, x + 1.7 * radius, y + 1.7 * radius))
    high, wide = near.shape[:2]
    if high == 0 or wide == 0:
        return
    left, top = max(round(x - 1.7 * radius), 0), max(round(y - 1.7 * radius), 0)
    across = arrays.exp(-2.0 * np.square((np.arange(wide) + left - x) / radius))
    down = arrays.exp(-2.0 * np.square((np.arange(high) + top - y) / radius))
    share = (strength * down[:, None] * across).astype(np.float32)
    near[:] = cv2.blendLinear(np.ascontiguousarray(near), new_image(wide, high, colour), 1.0 - share, share)


def mix(one: Colour, other: Colour, share: float) -> Colour:
    """Interpolate two colours."""
    red, green, blue = (round(a * (1.0 - share) + b * share) for a, b in zip(one, other))
    return red, green, blue


def shade(colour: Colour, factor: float) -> Colour:
    """Scale the brightness of a colour."""
    red, green, blue = (min(max(round(part * factor), 0), 255) for part in colour)
    return red, green, blue


def choose_colour(rng: np.random.Generator, colours: Sequence[Colour]) -> Colour:
    """Choose one of several colours."""
    return colours[int(rng.integers(len(colours)))]


@cache
def _fine() -> Float32:
    return np.random.default_rng(7).standard_normal((512, 768), np.float32)


def weather(image: UInt8, rng: np.random.Generator, amount: float) -> None:
    """Add wear: soft patches, a fine grain, and streaks of dirt from the upper edge."""
    high, wide = image.shape[:2]
    soft = cv2.resize(rng.normal(0.0, 0.5, (high // 24 + 3, wide // 24 + 3)).astype(np.float32), (wide, high))
    runs = cv2.resize(rng.normal(0.0, 1.0, (1, wide // 5 + 3)).astype(np.float32), (wide, 1))
    down = np.linspace(0.8, 0.16, high)[:, None]
    row, column = rng.integers(513 - high), rng.integers(769 - wide)
    fine = _fine()[row : row + high, column : column + wide]
    dirt = soft + 0.3 * fine - (np.maximum(runs - 0.6, 0.0) * down).astype(np.float32)
    factor = (1.0 + amount * dirt).astype(np.float32)
    cv2.multiply(image, cv2.merge([factor] * 3), image, 1.0, cv2.CV_8U)
