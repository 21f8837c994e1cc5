"""Traffic signs on poles, direction signs and gantries over motorways."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.portable import arrays
from mirror.synth.model import Finish, Label, Material, Model, Pieces, polygon
from mirror.synth.street.furniture.lamps import FOOT_M
from mirror.synth.textures.catalogue import DIRECTION_SIGNS, Sign

_POLE: Final = Finish((0.30, 0.31, 0.31), Material.METAL, Label.POLE)
_BACK: Final = Finish((0.34, 0.35, 0.35), Material.METAL, Label.TRAFFIC_SIGN)
_ROUND: Final = frozenset(
    (Sign.SPEED_30, Sign.SPEED_50, Sign.SPEED_80, Sign.SPEED_120, Sign.NO_ENTRY, Sign.NO_PARKING, Sign.CYCLE_PATH,
     Sign.KEEP_RIGHT, Sign.ROUNDABOUT)
)  # fmt: skip
_WARNING: Final = frozenset((Sign.BEND, Sign.CHILDREN, Sign.ROADWORKS, Sign.CROSSING_AHEAD))


def _sign_outline(sign: Sign) -> Float64:
    """Corners (N, 2) of a sign's outline, counter-clockwise, from -1 to 1 on both axes, as in its image."""
    if sign in _ROUND or sign == Sign.STOP:
        count = 8 if sign == Sign.STOP else 16
        angle = 2.0 * np.pi * (np.arange(count) + 0.5) / count
        return np.c_[arrays.cos(angle), arrays.sin(angle)] / arrays.cos(np.pi / count)
    if sign in _WARNING:
        return np.array([(-1.0, -1.0), (1.0, -1.0), (0.0, 1.0)])
    if sign == Sign.YIELD:
        return np.array([(-1.0, 1.0), (0.0, -1.0), (1.0, 1.0)])
    if sign == Sign.PRIORITY:
        return np.array([(0.0, -1.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)])
    return np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])


def traffic_sign(signs: tuple[Sign, ...], *, low_m: float = 2.1, size_m: float = 0.62) -> Model:
    """Build signs one above the other on a pole, the first on top; they face +x.

    Args:
        signs: the signs.
        low_m: height of the lowest sign's lower edge.
        size_m: width and height of each sign.
    """
    pieces = Pieces()
    top = low_m + len(signs) * (size_m + 0.05)
    pieces.tube((0, 0, FOOT_M), (0, 0, top), 0.038, _POLE, cap=True)
    half = 0.5 * size_m
    for number, sign in enumerate(signs):
        middle = top - 0.03 - half - number * (size_m + 0.05)
        add_sign(pieces, sign, middle, half)
    return pieces.model()


def add_sign(pieces: Pieces, sign: Sign, middle_m: float, half_m: float, *, x: float = 0.05) -> None:
    """Add one sign with its grey back, facing +x."""
    outline = _sign_outline(sign)
    front = np.c_[np.full(len(outline), x), half_m * outline[:, 0], middle_m + half_m * outline[:, 1]]
    # The outline is a polygon, so the texture's u axis is set level explicitly.
    pieces.add(polygon(front, (0.5, 0.5, 0.5), Material.IMAGE, Label.TRAFFIC_SIGN, image=int(sign)))
    pieces.face(front[::-1], _BACK)


def direction_sign(rng: np.random.Generator, *, width_m: float = 3.0, low_m: float = 2.3) -> Model:
    """Build a direction board on two posts, facing +x."""
    pieces = Pieces()
    high = 0.5 * width_m
    for y in (-0.32 * width_m, 0.32 * width_m):
        pieces.tube((0, y, FOOT_M), (0, y, low_m + high), 0.055, _POLE, cap=True)
    _add_board(pieces, rng, 0.0, 0.5 * width_m, low_m)
    return pieces.model()


def _add_board(pieces: Pieces, rng: np.random.Generator, y: float, half_m: float, low_m: float) -> None:
    """Add a direction sign that is twice as wide as high."""
    left, right, high = y - half_m, y + half_m, low_m + half_m
    panel = Finish((0.5, 0.5, 0.5), Material.IMAGE, Label.TRAFFIC_SIGN, image=int(rng.choice(DIRECTION_SIGNS)))
    pieces.wall((0.10, left), (0.10, right), low_m, high, panel)
    pieces.wall((0.10, right), (0.10, left), low_m, high, _BACK)


def gantry(rng: np.random.Generator, span_m: float, boards: int = 2) -> Model:
    """Build a gantry over a carriageway, from its foot at the origin to its other foot at y = ``span_m``; it faces +x.

    Args:
        rng: random generator that chooses the boards.
        span_m: y of the other foot, of either sign.
        boards: number of direction signs.
    """
    pieces = Pieces()
    low, high = 6.2, 7.3
    steel = Finish((0.38, 0.39, 0.39), Material.METAL, Label.POLE)
    for y in (0.0, span_m):
        pieces.block((-0.22, y - 0.22, FOOT_M), (0.22, y + 0.22, high), steel, without=("-z",))
    left, right = sorted((0.0, span_m))
    for x in (-0.45, 0.0):
        for z in (low, high - 0.18):
            pieces.block((x, left, z), (x + 0.14, right, z + 0.18), steel, without=("-y", "+y"))
    count = max(int((right - left) / 2.4), 2)
    step = (right - left) / count
    brace = steel._replace(two_sided=True)
    for number in range(count):
        a, b = left + number * step, left + (number + 1) * step
        if number % 2:
            a, b = b, a
        pieces.face(((0.08, a, low), (0.08, a + 0.12, low), (0.08, b, high - 0.1), (0.08, b - 0.12, high - 0.1)), brace)
    for number in range(boards):
        middle = left + (right - left) * (number + 1) / (boards + 1)
        half = min(0.42 * (right - left) / (boards + 1), 2.6)
        _add_board(pieces, rng, middle, half, 0.5 * (low + high) - 0.5 * half + 0.3)
    return pieces.model()
