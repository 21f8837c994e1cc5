"""Draws traffic signs and direction signs."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import UInt8
from mirror.portable import arrays
from mirror.synth.textures.catalogue import Sign
from mirror.synth.textures.images.drawing import (
    Colour,
    disc,
    fill,
    new_image,
    rectangle,
    rounded_rectangle,
    stroke,
    weather,
)
from mirror.synth.textures.images.lettering import number, write

_GREY: Final = (150, 152, 153)
_WHITE: Final = (228, 228, 226)
_BLACK: Final = (28, 28, 30)
_RED: Final = (182, 24, 32)
_BLUE: Final = (26, 78, 158)
_YELLOW: Final = (234, 186, 28)
_GREEN: Final = (22, 110, 70)
_LIMITS: Final = {Sign.SPEED_30: "30", Sign.SPEED_50: "50", Sign.SPEED_80: "80", Sign.SPEED_120: "120"}
_TOWNS: Final = (
    "Altenwied", "Birkstett", "Ostermühl", "Lindwerder", "Hohenrade", "Sankt Jorun", "Wolkenau", "Kaltbronn", "Zentrum",
    "Hafen", "Messe", "Flughafen", "Nordkreuz", "Grünfurt", "Seebrück", "Tannroda",
)  # fmt: skip


def traffic_sign(rng: np.random.Generator, wide: int, high: int, turn: int) -> UInt8:
    """Draw the traffic sign with index ``turn`` in `Sign`."""
    sign = Sign(Sign.SPEED_30 + turn)
    # Drawn on a square of 1 by 1, y down.
    image = new_image(wide, high, _GREY)
    if sign in _LIMITS:
        disc(image, 0.5 * wide, 0.5 * wide, 0.5 * wide, _RED)
        disc(image, 0.5 * wide, 0.5 * wide, 0.385 * wide, _WHITE)
        slim, bold = (0.46, 0.16) if len(_LIMITS[sign]) == 3 else (0.52, 0.17)
        box = (0.17 * wide, 0.30 * wide, 0.83 * wide, 0.70 * wide)
        number(image, _LIMITS[sign], box, _BLACK, slim=slim, bold=bold)
    elif sign in (Sign.BEND, Sign.CHILDREN, Sign.ROADWORKS, Sign.CROSSING_AHEAD):
        _triangle(image, wide, tip=0.0)
        _warning(image, wide, sign)
    elif sign == Sign.YIELD:
        _triangle(image, wide, tip=1.0)
    elif sign in (Sign.CYCLE_PATH, Sign.KEEP_RIGHT, Sign.ROUNDABOUT, Sign.NO_PARKING, Sign.NO_ENTRY):
        _disc(image, wide, sign)
    else:
        _plate(image, wide, sign)
    weather(image, rng, 0.02)
    return image


def _at(size: int, *points: tuple[float, float]) -> list[tuple[float, float]]:
    return [(size * x, size * y) for x, y in points]


def _triangle(image: UInt8, size: int, tip: float) -> None:
    """A white triangle with a red edge, with its tip at the top (0) or at the bottom (1)."""
    foot = 1.0 - tip
    fill(image, _at(size, (0, foot), (0.5, tip), (1, foot)), _RED)
    near, far = abs(foot - 0.085), abs(tip - 0.20)
    fill(image, _at(size, (0.14, near), (0.5, far), (0.86, near)), _WHITE)


def _warning(image: UInt8, size: int, sign: Sign) -> None:
    if sign == Sign.BEND:
        way = _at(size, (0.46, 0.84), (0.46, 0.68), (0.56, 0.58), (0.56, 0.50))
        stroke(image, way, _BLACK, 0.07 * size)
        fill(image, _at(size, (0.47, 0.52), (0.56, 0.37), (0.65, 0.52)), _BLACK)
    elif sign == Sign.CHILDREN:
        for x, grown in ((0.42, 1.0), (0.60, 0.8)):
            _walker(image, size, x, 0.86, 0.42 * grown)
    elif sign == Sign.ROADWORKS:
        _walker(image, size, 0.46, 0.86, 0.44)
        stroke(image, _at(size, (0.44, 0.62), (0.66, 0.76)), _BLACK, 0.03 * size)
        fill(image, _at(size, (0.58, 0.87), (0.68, 0.73), (0.78, 0.87)), _BLACK)
    else:
        stroke(image, _at(size, (0.5, 0.85), (0.5, 0.42)), _BLACK, 0.07 * size)
        stroke(image, _at(size, (0.34, 0.66), (0.66, 0.66)), _BLACK, 0.07 * size)


def _walker(image: UInt8, size: int, x: float, foot: float, tall: float, colour: Colour = _BLACK) -> None:
    """A person walking to the left."""
    at = [
        (x + tall * a, foot - tall * b)
        for a, b in (
            (0.0, 0.78),
            (0.02, 0.42),
            (-0.16, 0.2),
            (-0.3, 0.0),
            (0.14, 0.22),
            (0.2, 0.0),
            (-0.22, 0.5),
            (0.22, 0.52),
        )
    ]
    disc(image, (x - 0.01) * size, (foot - 0.9 * tall) * size, 0.10 * tall * size, colour)
    stroke(image, _at(size, at[0], at[1]), colour, 0.17 * tall * size)
    for limb in ((1, 2, 3), (1, 4, 5)):
        stroke(image, _at(size, *(at[n] for n in limb)), colour, 0.10 * tall * size)
    for hand in (6, 7):
        stroke(image, _at(size, at[0], at[hand]), colour, 0.07 * tall * size)


def _arrow(
    image: UInt8, size: int, tail: tuple[float, float], tip: tuple[float, float], colour: Colour, width: float
) -> None:
    a, b = np.array(tail), np.array(tip)
    ahead = (b - a) / arrays.norm(b - a)
    aside = np.array([-ahead[1], ahead[0]])
    neck = b - 1.7 * width * ahead
    stroke(image, [a * size, neck * size], colour, width * size)
    fill(image, [b * size, (neck + 1.5 * width * aside) * size, (neck - 1.5 * width * aside) * size], colour)


def _disc(image: UInt8, size: int, sign: Sign) -> None:
    middle = 0.5 * size
    if sign == Sign.NO_ENTRY:
        disc(image, middle, middle, middle, _RED)
        rectangle(image, (0.14 * size, 0.40 * size, 0.86 * size, 0.60 * size), _WHITE)
        return
    disc(image, middle, middle, middle, _RED if sign == Sign.NO_PARKING else _WHITE)
    disc(image, middle, middle, (0.40 if sign == Sign.NO_PARKING else 0.475) * size, _BLUE)
    if sign == Sign.NO_PARKING:
        stroke(image, _at(size, (0.22, 0.22), (0.78, 0.78)), _RED, 0.10 * size)
    elif sign == Sign.KEEP_RIGHT:
        _arrow(image, size, (0.30, 0.26), (0.76, 0.74), _WHITE, 0.13)
    elif sign == Sign.ROUNDABOUT:
        for start in (0.3, 2.394, 4.488):
            turn = start + np.linspace(0.0, 1.35, 9)
            arc = np.c_[0.5 + 0.27 * arrays.cos(turn), 0.5 - 0.27 * arrays.sin(turn)]
            stroke(image, arc * size, _WHITE, 0.08 * size)
            tangent = np.array([-arrays.sin(turn[-1]), -arrays.cos(turn[-1])])
            normal = np.array([arrays.cos(turn[-1]), -arrays.sin(turn[-1])])
            head = [arc[-1] + 0.15 * tangent, arc[-1] + 0.10 * normal, arc[-1] - 0.10 * normal]
            fill(image, np.array(head) * size, _WHITE)
    else:
        for x in (0.29, 0.71):
            turn = np.linspace(0, 2 * np.pi, 24)
            stroke(
                image, np.c_[x + 0.14 * arrays.cos(turn), 0.60 + 0.14 * arrays.sin(turn)] * size, _WHITE, 0.03 * size
            )
        for bar in (
            ((0.29, 0.60), (0.40, 0.40), (0.64, 0.40), (0.71, 0.60)),
            ((0.40, 0.40), (0.50, 0.60), (0.64, 0.40)),
            ((0.29, 0.60), (0.50, 0.60)),
        ):
            stroke(image, _at(size, *bar), _WHITE, 0.035 * size)
        stroke(image, _at(size, (0.64, 0.40), (0.62, 0.31), (0.70, 0.30)), _WHITE, 0.035 * size)
        stroke(image, _at(size, (0.34, 0.35), (0.45, 0.35)), _WHITE, 0.045 * size)


def _plate(image: UInt8, size: int, sign: Sign) -> None:
    if sign == Sign.STOP:
        turn = 2 * np.pi * (np.arange(8) + 0.5) / 8
        edge = np.c_[arrays.cos(turn), arrays.sin(turn)] / arrays.cos(np.pi / 8)
        fill(image, (0.5 + 0.5 * edge) * size, _WHITE)
        fill(image, (0.5 + 0.465 * edge) * size, _RED)
        number(image, "STOP", (0.10 * size, 0.34 * size, 0.90 * size, 0.66 * size), _WHITE, slim=0.5, bold=0.15)
    elif sign == Sign.PRIORITY:
        fill(image, _at(size, (0.5, 0), (1, 0.5), (0.5, 1), (0, 0.5)), _BLACK)
        fill(image, _at(size, (0.5, 0.03), (0.97, 0.5), (0.5, 0.97), (0.03, 0.5)), _WHITE)
        fill(image, _at(size, (0.5, 0.20), (0.80, 0.5), (0.5, 0.80), (0.20, 0.5)), _YELLOW)
    elif sign == Sign.BUS_STOP:
        rectangle(image, (0, 0, size, size), _YELLOW)
        disc(image, 0.5 * size, 0.5 * size, 0.46 * size, _GREEN)
        disc(image, 0.5 * size, 0.5 * size, 0.38 * size, _YELLOW)
        number(image, "H", (0.28 * size, 0.24 * size, 0.72 * size, 0.76 * size), _GREEN, slim=0.7, bold=0.2)
    else:
        rectangle(image, (0, 0, size, size), _WHITE)
        rounded_rectangle(image, (0.03 * size, 0.03 * size, 0.97 * size, 0.97 * size), 0.07 * size, _BLUE)
        if sign == Sign.PARKING:
            number(image, "P", (0.25 * size, 0.16 * size, 0.75 * size, 0.84 * size), _WHITE, slim=0.6, bold=0.2)
        elif sign == Sign.CROSSWALK:
            fill(image, _at(size, (0.10, 0.86), (0.5, 0.12), (0.90, 0.86)), _WHITE)
            _walker(image, size, 0.50, 0.76, 0.44)
            for x in (0.24, 0.36, 0.48, 0.60, 0.72):
                fill(image, _at(size, (x, 0.84), (x + 0.02, 0.78), (x + 0.08, 0.78), (x + 0.06, 0.84)), _BLACK)
        else:
            _arrow(image, size, (0.12, 0.5), (0.90, 0.5), _WHITE, 0.16)


def direction_sign(rng: np.random.Generator, wide: int, high: int, turn: int) -> UInt8:
    """Draw towns, their distances, arrows and the road's number; blue for motorways, yellow or white for others."""
    blue = turn % 2 == 0
    ground, ink = (_BLUE, _WHITE) if blue else ((_YELLOW, _BLACK) if turn % 4 == 1 else (_WHITE, _BLACK))
    image = new_image(wide, high, ink)
    rounded_rectangle(image, (5, 5, wide - 5, high - 5), 18, ground)
    towns = rng.permutation(len(_TOWNS))[:3]
    for line, town in enumerate(towns):
        top = (0.10 + 0.225 * line) * high
        left = 0.18 * wide
        write(image, _TOWNS[int(town)], (left, top, 0.72 * wide, top + 0.155 * high), ink, weight=600, align=0.0)
        far = str(rng.integers(2, 90))
        box = (0.76 * wide, top + 0.015 * high, 0.95 * wide, top + 0.145 * high)
        number(image, far, box, ink, slim=0.58, bold=0.13)
        side = int(rng.integers(3))
        x, y = 0.10, (top + 0.08 * high) / high
        tips = ((-0.035, 0.0), (0.0, -0.07), (0.035, 0.0))
        dx, dy = tips[side]
        ends = np.array([(x - dx, y - dy), (x + dx, y + dy)]) * (wide, high)
        size = high
        _arrow(image, size, tuple(ends[0] / size), tuple(ends[1] / size), ink, 0.035)
    shield = (0.18 * wide, 0.80 * high, 0.34 * wide, 0.93 * high)
    if blue:
        rounded_rectangle(image, shield, 10, _WHITE)
        rounded_rectangle(image, (shield[0] + 2, shield[1] + 2, shield[2] - 2, shield[3] - 2), 9, _BLUE)
    else:
        rectangle(image, shield, _BLACK)
        rectangle(image, (shield[0] + 2, shield[1] + 2, shield[2] - 2, shield[3] - 2), _YELLOW)
    road = ("A" if blue else "B") + str(int(rng.integers(2, 99)))
    number(
        image, road, (shield[0] + 8, shield[1] + 6, shield[2] - 8, shield[3] - 6), _WHITE if blue else _BLACK, bold=0.13
    )
    weather(image, rng, 0.015)
    return image
