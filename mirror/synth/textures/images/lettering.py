"""Writes words on images, and defines a plain stroke alphabet for plates and road signs."""

from __future__ import annotations

from functools import cache
from typing import Final, Literal

import cv2
import numpy as np

from mirror.arrays import Float64, UInt8
from mirror.portable import arrays
from mirror.synth.textures.images.drawing import Box, Colour, to_fixed_point

Style = Literal["sans", "italic", "uni"]
_TRIAL: Final = 96


@cache
def _font(style: Style) -> cv2.FontFace:
    """A typeface that is part of OpenCV, so that no font files are read."""
    return cv2.FontFace(style)


def write(
    image: UInt8,
    words: str,
    box: Box,
    colour: Colour,
    *,
    style: Style = "sans",
    weight: int = 500,
    align: float = 0.5,
    outline: tuple[Colour, int] | None = None,
) -> Box:
    """Write words in one line, as large as fits into a box.

    Args:
        image: image to draw on.
        words: text.
        box: box that limits the text.
        colour: colour of the letters.
        style: typeface; ``uni`` has Chinese characters.
        weight: 100 thin to 900 black.
        align: 0 left, 0.5 centred, 1 right.
        outline: colour and width in pixels of an outline around the letters.

    Returns:
        The box that the text fills.
    """
    # The zero of the typeface has a slash, so the letter O replaces it.
    words = words.replace("0", "O")
    font = _font(style)
    left, top, right, bottom = box
    _, _, wide, high = cv2.getTextSize((0, 0), words, (0, 0), font, _TRIAL, weight)
    size = max(int(_TRIAL * min((right - left) / wide, (bottom - top) / high)), 4)
    x, y, wide, high = cv2.getTextSize((0, 0), words, (0, 0), font, size, weight)
    at_x, at_y = left + align * (right - left - wide) - x, 0.5 * (top + bottom - high) - y
    if outline is not None:
        edge, width = outline
        for dx, dy in ((-1, 0), (1, 0), (0, -1), (0, 1), (-0.7, -0.7), (0.7, 0.7), (-0.7, 0.7), (0.7, -0.7)):
            place = (round(at_x + dx * width), round(at_y + dy * width))
            cv2.putText(image, words, place, edge, font, size, weight)
    cv2.putText(image, words, (round(at_x), round(at_y)), colour, font, size, weight)
    return at_x + x, at_y + y, at_x + x + wide, at_y + y + high


_STROKES: Final = {
    "A": "|0,0 .5,1 1,0|.17,.3 .83,.3",
    "B": "|0,0 0,1|~0,1 .92,1 .92,.53 0,.53|~0,.53 1,.53 1,0 0,0",
    "C": "~1,.7 1,1 0,1 0,0 1,0 1,.3",
    "D": "|0,0 0,1|~0,1 1,1 1,0 0,0",
    "E": "|1,1 0,1 0,0 1,0|0,.52 .85,.52",
    "F": "|1,1 0,1 0,0|0,.52 .85,.52",
    "G": "~1,.7 1,1 0,1 0,0 1,0 1,.46|1,.46 .55,.46",
    "H": "|0,0 0,1|1,0 1,1|0,.52 1,.52",
    "I": "|.5,0 .5,1",
    "J": "~.9,1 .9,0 0,0 0,.3",
    "K": "|0,0 0,1|1,1 0,.38|.36,.58 1,0",
    "L": "|0,1 0,0 .95,0",
    "M": "|0,0 0,1 .5,.38 1,1 1,0",
    "N": "|0,0 0,1 1,0 1,1",
    "O": "~.5,1 0,1 0,0 1,0 1,1 .5,1",
    "P": "|0,0 0,1|~0,1 1,1 1,.44 0,.44",
    "Q": "~.5,1 0,1 0,0 1,0 1,1 .5,1|.58,.27 1.02,-.04",
    "R": "|0,0 0,1|~0,1 1,1 1,.46 0,.46|.52,.46 1,0",
    "S": "~1,.74 1,1 0,1 0,.53 1,.53 1,0 0,0 0,.26",
    "T": "|0,1 1,1|.5,1 .5,0",
    "U": "~0,1 0,0 1,0 1,1",
    "V": "|0,1 .5,0 1,1",
    "W": "|0,1 .24,0 .5,.7 .76,0 1,1",
    "X": "|0,1 1,0|0,0 1,1",
    "Y": "|0,1 .5,.45 1,1|.5,.45 .5,0",
    "Z": "|0,1 1,1 0,0 1,0",
    "0": "~.5,1 .04,1 .04,0 .96,0 .96,1 .5,1",
    "1": "|.12,.76 .62,1 .62,0",
    "2": "~0,.7 0,1 1,1 1,.56 0,0|0,0 1,0",
    "3": "~0,.76 0,1 .96,1 .96,.54 .42,.54|~.42,.54 1,.54 1,0 0,0 0,.26",
    "4": "|.6,1 0,.26 1.02,.26|.76,.56 .76,0",
    "5": "|.95,1 .1,1 .06,.57|~.06,.57 1,.62 1,0 0,0 0,.24",
    "6": "~.96,.8 .96,1 0,1 0,0 1,0 1,.58 0,.58",
    "7": "|0,1 1,1 .36,0",
    "8": "~.5,1 .06,1 .06,.54 .94,.54 .94,1 .5,1|~.5,.54 0,.54 0,0 1,0 1,.54 .5,.54",
    "9": "~.04,.2 .04,0 1,0 1,1 0,1 0,.42 1,.42",
    "-": "|.1,.45 .9,.45",
}
"""Centre lines of strokes in a box of 1 by 1, x to the right, y up; ``~`` rounds the corners of a stroke."""


def _rounded(corners: Float64, radius: float) -> Float64:
    """Round the corners of a polyline with arcs."""
    points = [corners[:1]]
    for before, corner, after in zip(corners[:-2], corners[1:-1], corners[2:]):
        back, ahead = before - corner, after - corner
        far, near = float(arrays.norm(back)), float(arrays.norm(ahead))
        reach = min(radius, 0.5 * far, 0.5 * near) if len(corners) > 3 else min(radius, far, near)
        start, end = corner + back * (reach / far), corner + ahead * (reach / near)
        share = np.linspace(0.0, 1.0, 9)[:, None]
        # A cubic curve approximates the arc.
        pull = 0.55
        a, b = start + pull * (corner - start), end + pull * (corner - end)
        points.append(
            (1 - share) ** 2 * (1 - share) * start
            + 3 * share * (1 - share) ** 2 * a
            + 3 * share**2 * (1 - share) * b
            + share**2 * share * end
        )
    return np.concatenate([*points, corners[-1:]])


@cache
def glyph(letter: str, wide: float) -> tuple[Float64, ...]:
    """Return the centre lines (N, 2) of a capital letter or digit of height 1, y down from its top."""
    lines = []
    round_next = False
    for part in _STROKES[letter].replace("~", "|~").split("|"):
        if not part:
            continue
        round_next = part.startswith("~")
        corners = np.array([[float(n) for n in point.split(",")] for point in part.lstrip("~").split()])
        corners = np.c_[corners[:, 0] * wide, 1.0 - corners[:, 1]]
        lines.append(_rounded(corners, 0.5 * wide) if round_next else corners)
    return tuple(lines)


def letter(image: UInt8, sign: str, box: Box, colour: Colour, width: float) -> None:
    """Draw a capital letter or digit inside a box, with strokes ``width`` pixels wide."""
    left, top, right, bottom = box
    inner = 0.5 * width
    high = bottom - top - width
    for line in glyph(sign, (right - left - width) / high):
        points = to_fixed_point(line * high + (left + inner, top + inner))
        cv2.polylines(image, [points], False, colour, round(width), cv2.LINE_AA, 4)


def number(image: UInt8, signs: str, box: Box, colour: Colour, *, slim: float = 0.55, bold: float = 0.16) -> None:
    """Draw capital letters and digits in one line, in the middle of a box.

    Args:
        image: image to draw on.
        signs: text.
        box: box that limits the text.
        colour: colour of the letters.
        slim: width of a letter divided by its height.
        bold: width of a stroke divided by the height of a letter.
    """
    left, top, right, bottom = box
    gap = 0.18
    units = len(signs) * slim + (len(signs) - 1) * gap
    high = min(bottom - top, (right - left) / units)
    at, upper = 0.5 * (left + right - units * high), 0.5 * (top + bottom - high)
    for sign in signs:
        if sign != " ":
            letter(image, sign, (at, upper, at + slim * high, upper + high), colour, bold * high)
        at += (slim + gap) * high
