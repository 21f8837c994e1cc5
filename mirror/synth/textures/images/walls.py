"""Draws doors, and graffiti on walls."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import UInt8
from mirror.portable import arrays
from mirror.synth.textures.images.drawing import (
    Box,
    Colour,
    choose_colour,
    disc,
    gradient,
    mix,
    new_image,
    part,
    rectangle,
    rounded_rectangle,
    shade,
    stroke,
    weather,
)
from mirror.synth.textures.images.lettering import glyph, number
from mirror.synth.textures.images.motifs import BRIGHT, PALE

_DOORS: Final[tuple[Colour, ...]] = (
    (110, 70, 42), (60, 92, 74), (44, 62, 96), (122, 36, 34), (84, 82, 80), (200, 196, 188), (74, 48, 32), (40, 44, 46),
)  # fmt: skip
_NAMES: Final = ("RAZE", "KOJO", "ZEN9", "FLUX", "MONK", "ASTR", "BOLO", "VEX2")


def door(rng: np.random.Generator, wide: int, high: int, turn: int) -> UInt8:
    """Draw a house door with panels or panes, a handle, a letter slot and a number."""
    leaf = _DOORS[turn % len(_DOORS)]
    image = new_image(wide, high, shade(leaf, 0.62))
    rectangle(image, (0.06 * wide, 0.03 * high, 0.94 * wide, high), leaf)
    kind = turn % 4
    spots: list[Box] = []
    if kind == 0:
        spots = [(a, b, a + 0.32, b + h) for b, h in ((0.08, 0.30), (0.44, 0.16), (0.66, 0.28)) for a in (0.14, 0.54)]
    elif kind == 1:
        spots = [(0.16, 0.08, 0.84, 0.52), (0.16, 0.62, 0.84, 0.94)]
    elif kind == 2:
        spots = [(0.42, 0.08, 0.58, 0.88)]
    else:
        spots = [(0.10, 0.05, 0.90, 0.95)]
    for place, (left, top, right, bottom) in enumerate(spots):
        box = (left * wide, top * high, right * wide, bottom * high)
        rectangle(image, box, shade(leaf, 0.6))
        inner = (box[0] + 3, box[1] + 3, box[2] - 2, box[3] - 2)
        glass = kind == 3 or (kind == 1 and place == 0) or kind == 2
        if glass:
            gradient(part(image, inner), (96, 108, 116), (40, 44, 48))
        else:
            rectangle(image, inner, mix(leaf, (255, 255, 255), 0.06))
            rectangle(image, (inner[0] + 6, inner[1] + 6, inner[2] - 5, inner[3] - 5), shade(leaf, 0.9))
    brass = (186, 156, 90) if turn % 2 else (170, 172, 174)
    stroke(image, [(0.88 * wide, 0.50 * high), (0.88 * wide, 0.60 * high)], brass, 0.035 * wide)
    disc(image, 0.88 * wide, 0.63 * high, 0.02 * wide, shade(brass, 0.5))
    if kind in (0, 1):
        rounded_rectangle(image, (0.36 * wide, 0.555 * high, 0.64 * wide, 0.585 * high), 3, brass)
    number(image, str(int(rng.integers(1, 98))), (0.40 * wide, 0.035 * high, 0.60 * wide, 0.07 * high), (226, 222, 210))
    rectangle(image, (0.06 * wide, 0.955 * high, 0.94 * wide, high), shade(leaf, 0.5))
    weather(image, rng, 0.05)
    return image


def graffiti(rng: np.random.Generator, wide: int, high: int, turn: int) -> UInt8:
    """Draw graffiti: thick outlined letters over patches of colour and tags."""
    ground = choose_colour(rng, PALE)
    image = new_image(wide, high, shade(ground, 0.8))
    cloud, body, edge = (BRIGHT[int(n)] for n in rng.permutation(len(BRIGHT))[:3])
    for _ in range(26):
        x, y = rng.uniform(0.08, 0.92) * wide, rng.uniform(0.25, 0.85) * high
        disc(image, x, y, rng.uniform(0.06, 0.14) * high, mix(cloud, ground, rng.uniform(0.0, 0.5)))
    word = _NAMES[turn % len(_NAMES)]
    size = 0.52 * high
    step = 0.86 * wide / len(word)
    lines = []
    for place, sign in enumerate(word):
        lean, drop = rng.normal(0.0, 0.12), rng.normal(0.0, 0.05) * high
        for line in glyph(sign, 0.72):
            turned = arrays.matmul(line, np.array([[1.0, lean], [lean, 1.0]]))
            lines.append(turned * size + (0.09 * wide + place * step, 0.24 * high + drop))
    for colour, width, shift in ((shade(edge, 0.35), 0.34, 0.05), ((20, 20, 24), 0.31, 0.0), (body, 0.23, 0.0)):
        for line in lines:
            stroke(image, line + shift * size, colour, width * size)
    light = mix(body, (255, 255, 255), 0.55)
    for line in lines:
        stroke(image, line - 0.055 * size, light, 0.045 * size)
    for _ in range(4):
        _tag(image, rng, rng.uniform(0.05, 0.8) * wide, rng.uniform(0.1, 0.9) * high, 0.12 * high)
    for _ in range(6):
        x, y = rng.uniform(0.1, 0.9) * wide, rng.uniform(0.6, 0.8) * high
        stroke(image, [(x, y), (x, y + rng.uniform(0.05, 0.18) * high)], body, 2)
    weather(image, rng, 0.06)
    return image


def _tag(image: UInt8, rng: np.random.Generator, x: float, y: float, size: float) -> None:
    """A signature in one stroke."""
    t = np.linspace(0.0, 1.0, 40)
    a, b = rng.uniform(2, 6, 2), rng.uniform(0, 6, 2)
    path = np.c_[
        x + size * (3.0 * t + 0.5 * arrays.sin(a[0] * 6 * t + b[0])), y + size * 0.6 * arrays.sin(a[1] * 6 * t + b[1])
    ]
    stroke(image, path, choose_colour(rng, ((24, 24, 28), (34, 40, 110), (130, 26, 34))), 2)
