"""Draws the interiors behind shop windows: rooms with goods, lamps and some people."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from mirror.arrays import UInt8
from mirror.portable import arrays
from mirror.synth.textures.images.drawing import (
    Colour,
    choose_colour,
    disc,
    fill,
    glow,
    gradient,
    mix,
    new_image,
    part,
    rectangle,
    rounded_rectangle,
    shade,
    star,
    stroke,
    weather,
)
from mirror.synth.textures.images.lettering import write
from mirror.synth.textures.images.motifs import BRIGHT, DEEP, PALE

_Goods = Callable[[UInt8, np.random.Generator], None]
_FLOORS: Final[tuple[Colour, ...]] = ((112, 84, 60), (92, 90, 88), (128, 122, 114), (70, 56, 46), (100, 76, 70))
_WORDS: Final = ("SALE", "NEU", "-30 %", "OFFEN", "Mo-Fr 9-18", "Angebot", "Mittagstisch", "Herbst")


def shop_window(rng: np.random.Generator, wide: int, high: int, turn: int) -> UInt8:
    """Draw the interior of a shop seen through its window: walls, lamps, goods, words on the pane."""
    image = new_image(wide, high, (90, 80, 70))
    wall = shade(choose_colour(rng, PALE), rng.uniform(0.50, 0.75))
    _room(image, rng, wall)
    _GOODS[turn % len(_GOODS)](image, rng)
    if rng.random() < 0.35:
        _keeper(image, rng)
    if rng.random() < 0.6:
        words = _WORDS[int(rng.integers(len(_WORDS)))]
        left, top = rng.uniform(0.05, 0.6) * wide, rng.uniform(0.08, 0.3) * high
        tone = choose_colour(rng, ((228, 226, 220), (196, 40, 42), (236, 200, 60)))
        write(image, words, (left, top, left + 0.32 * wide, top + 0.12 * high), tone, weight=800)
    weather(image, rng, 0.03)
    return image


def _room(image: UInt8, rng: np.random.Generator, wall: Colour) -> None:
    """Draw the rear wall, the ceiling with lamps, the floor and the side walls in perspective."""
    high, wide = image.shape[:2]
    left, right, top, floor = 0.14 * wide, 0.86 * wide, 0.16 * high, 0.80 * high
    gradient(image, shade(wall, 1.1), shade(wall, 0.8))
    fill(image, [(0, 0), (wide, 0), (right, top), (left, top)], shade(wall, 1.12))
    fill(image, [(0, high), (wide, high), (right, floor), (left, floor)], choose_colour(rng, _FLOORS))
    fill(image, [(0, 0), (left, top), (left, floor), (0, high)], shade(wall, 0.72))
    fill(image, [(wide, 0), (right, top), (right, floor), (wide, high)], shade(wall, 0.66))
    for x in np.linspace(0.2, 0.8, int(rng.integers(2, 5))) * wide:
        y = rng.uniform(0.05, 0.12) * high
        glow(image, x, y, 0.30 * high, 0.75)
        rectangle(image, (x - 0.05 * wide, y - 3, x + 0.05 * wide, y + 2), (255, 250, 232))


def _shelves(image: UInt8, rng: np.random.Generator, rows: int, goods: _Goods | None, low: float = 0.78) -> None:
    """Draw shelves along the rear wall with boxes, jars or books."""
    high, wide = image.shape[:2]
    board = choose_colour(rng, ((120, 90, 62), (70, 66, 62), (176, 170, 160)))
    step = (low - 0.24) / rows
    for row in range(rows):
        y = (0.24 + (row + 1) * step) * high
        at = 0.15 * wide
        tone = choose_colour(rng, BRIGHT)
        while at < 0.84 * wide:
            size = rng.uniform(0.012, 0.035) * wide
            tall = rng.uniform(0.5, 0.9) * step * high
            if rng.random() < 0.35:
                tone = choose_colour(rng, BRIGHT)
            item = shade(tone, rng.uniform(0.6, 1.05))
            if rng.random() < 0.88:
                rectangle(image, (at, y - tall, at + size, y), item)
                rectangle(
                    image, (at + 1, y - 0.6 * tall, at + size - 1, y - 0.35 * tall), mix(item, (240, 236, 226), 0.6)
                )
            at += size + rng.uniform(0.5, 2.5)
        rectangle(image, (0.14 * wide, y, 0.86 * wide, y + 4), board)
        rectangle(image, (0.14 * wide, y + 4, 0.86 * wide, y + 7), shade(board, 0.5))


def _grocery(image: UInt8, rng: np.random.Generator) -> None:
    high, wide = image.shape[:2]
    _shelves(image, rng, 4, None)
    for x in np.linspace(0.05, 0.75, 4) * wide:
        crate = (x, 0.84 * high, x + 0.2 * wide, 0.97 * high)
        tone = choose_colour(rng, ((196, 42, 36), (230, 134, 34), (110, 160, 50), (206, 186, 50)))
        for _ in range(26):
            disc(
                image,
                rng.uniform(crate[0] + 5, crate[2] - 5),
                crate[1] + rng.uniform(-6, 8),
                6.0,
                shade(tone, rng.uniform(0.7, 1.1)),
            )
        rectangle(image, crate, (134, 98, 60))
        rectangle(image, (crate[0] + 3, crate[1] + 8, crate[2] - 3, crate[1] + 11), (92, 64, 38))


def _clothes(image: UInt8, rng: np.random.Generator) -> None:
    high, wide = image.shape[:2]
    rail = 0.36 * high
    stroke(image, [(0.18 * wide, rail), (0.82 * wide, rail)], (60, 58, 56), 3)
    at = 0.20 * wide
    while at < 0.80 * wide:
        size = rng.uniform(0.015, 0.03) * wide
        tone = shade(choose_colour(rng, BRIGHT + DEEP + PALE), rng.uniform(0.5, 0.9))
        fill(
            image,
            [
                (at, rail + 4),
                (at + size, rail + 4),
                (at + 1.2 * size, rail + 0.3 * high),
                (at - 0.2 * size, rail + 0.3 * high),
            ],
            tone,
        )
        at += size + 1.5
    for x in rng.permutation([0.2, 0.42, 0.64, 0.84])[: int(rng.integers(2, 4))]:
        _figure(
            image,
            float(x) * wide,
            0.97 * high,
            0.74 * high,
            shade(choose_colour(rng, BRIGHT + DEEP), 0.9),
            (216, 200, 184),
            rng,
        )


def _figure(
    image: UInt8, x: float, foot: float, tall: float, coat: Colour, skin: Colour, rng: np.random.Generator
) -> None:
    """Draw a standing, dressed person."""
    legs = shade(choose_colour(rng, DEEP), 0.9)
    for side in (-1, 1):
        stroke(
            image, [(x + side * 0.05 * tall, foot - 0.45 * tall), (x + side * 0.06 * tall, foot)], legs, 0.085 * tall
        )
        stroke(
            image,
            [(x + side * 0.12 * tall, foot - 0.80 * tall), (x + side * 0.16 * tall, foot - 0.46 * tall)],
            shade(coat, 0.85),
            0.06 * tall,
        )
    body = [(-0.13, 0.83), (0.13, 0.83), (0.10, 0.6), (0.14, 0.38), (-0.14, 0.38), (-0.10, 0.6)]
    fill(image, [(x + a * tall, foot - b * tall) for a, b in body], coat)
    stroke(image, [(x, foot - 0.82 * tall), (x, foot - 0.4 * tall)], shade(coat, 0.7), 2)
    stroke(image, [(x, foot - 0.80 * tall), (x, foot - 0.9 * tall)], skin, 0.05 * tall)
    disc(image, x, foot - 0.93 * tall, 0.055 * tall, skin, 1.3)


def _keeper(image: UInt8, rng: np.random.Generator) -> None:
    high, wide = image.shape[:2]
    x = rng.uniform(0.25, 0.75) * wide
    _figure(image, x, 0.95 * high, 0.62 * high, shade(choose_colour(rng, BRIGHT), 0.7), (176, 128, 100), rng)
    disc(
        image,
        x,
        0.95 * high - 0.605 * high,
        0.042 * high,
        choose_colour(rng, ((40, 28, 20), (90, 60, 30), (24, 22, 22))),
        0.8,
    )


def _bakery(image: UInt8, rng: np.random.Generator) -> None:
    high, wide = image.shape[:2]
    _shelves(image, rng, 2, None, 0.52)
    for y in (0.36, 0.50):
        for x in np.arange(0.17, 0.83, 0.065) * wide:
            disc(image, x, y * high - 6, 0.026 * wide, shade((178, 116, 58), rng.uniform(0.7, 1.1)), 0.6)
    rectangle(image, (0.06 * wide, 0.62 * high, 0.94 * wide, high), (196, 190, 180))
    rectangle(image, (0.08 * wide, 0.65 * high, 0.92 * wide, 0.84 * high), (70, 58, 46))
    for y in (0.73, 0.82):
        for x in np.arange(0.10, 0.91, 0.035) * wide:
            tone = choose_colour(rng, ((190, 130, 66), (220, 190, 140), (120, 66, 40), (206, 90, 90)))
            disc(image, x, y * high - 3, 0.014 * wide, tone, 0.8)
        rectangle(image, (0.08 * wide, y * high, 0.92 * wide, y * high + 2), (210, 206, 198))


def _cafe(image: UInt8, rng: np.random.Generator) -> None:
    high, wide = image.shape[:2]
    for x in (0.28, 0.5, 0.72):
        y = rng.uniform(0.26, 0.34) * high
        stroke(image, [(x * wide, 0), (x * wide, y)], (30, 28, 26), 2)
        glow(image, x * wide, y + 8, 0.2 * high, 0.8, (255, 220, 150))
        fill(
            image,
            [(x * wide - 8, y), (x * wide + 8, y), (x * wide + 16, y + 14), (x * wide - 16, y + 14)],
            (44, 42, 40),
        )
    for x in (0.22, 0.52, 0.80):
        if rng.random() < 0.75:
            _figure(
                image,
                (x - 0.07) * wide,
                1.06 * high,
                0.56 * high,
                shade(choose_colour(rng, BRIGHT), 0.7),
                (186, 140, 112),
                rng,
            )
        disc(image, x * wide, 0.78 * high, 0.085 * wide, (126, 88, 56), 0.28)
        disc(image, x * wide, 0.77 * high, 0.085 * wide, (150, 106, 68), 0.26)
        rectangle(image, (x * wide - 3, 0.80 * high, x * wide + 3, high), (36, 34, 32))
        disc(image, x * wide + 8, 0.755 * high, 0.014 * wide, (226, 222, 216), 0.8)


def _books(image: UInt8, rng: np.random.Generator) -> None:
    high, wide = image.shape[:2]
    _shelves(image, rng, 5, None)
    for x in np.linspace(0.08, 0.86, 7) * wide:
        tone = choose_colour(rng, BRIGHT + DEEP)
        tall = rng.uniform(0.16, 0.22) * high
        box = (x, 0.97 * high - tall, x + 0.075 * wide, 0.97 * high)
        rectangle(image, box, tone)
        rectangle(image, (box[0] + 4, box[1] + 6, box[2] - 4, box[1] + 0.3 * tall), choose_colour(rng, PALE))
        disc(image, 0.5 * (box[0] + box[2]), box[1] + 0.65 * tall, 0.02 * wide, choose_colour(rng, BRIGHT))


def _plants(image: UInt8, rng: np.random.Generator) -> None:
    high, wide = image.shape[:2]
    for row, base in enumerate((0.62, 0.80, 0.98)):
        for x in np.arange(rng.uniform(0.04, 0.1), 0.97, 0.095) * wide:
            size = rng.uniform(0.05, 0.09) * high * (1 + 0.3 * row)
            y = base * high
            green = shade((66, 120, 54), rng.uniform(0.6, 1.15))
            for _ in range(9):
                turn = rng.uniform(-1.3, 1.3)
                tip = (x + 2.0 * size * arrays.sin(turn), y - size - 2.0 * size * arrays.cos(turn))
                stroke(image, [(x, y - size), tip], shade(green, rng.uniform(0.7, 1.2)), 4)
                if rng.random() < 0.5:
                    fill(image, star(*tip, 6.0, 6, 0.5), choose_colour(rng, BRIGHT))
            fill(
                image,
                [(x - 0.7 * size, y - size), (x + 0.7 * size, y - size), (x + 0.5 * size, y), (x - 0.5 * size, y)],
                (156, 92, 62),
            )


def _shoes(image: UInt8, rng: np.random.Generator) -> None:
    high, wide = image.shape[:2]
    for y in (0.38, 0.54, 0.70, 0.90):
        rectangle(image, (0.1 * wide, y * high, 0.9 * wide, y * high + 4), (206, 202, 196))
        for x in np.arange(0.13, 0.84, 0.085) * wide:
            tone = choose_colour(rng, BRIGHT + DEEP + PALE)
            shoe = [(0, 0), (0.06, 0), (0.06, -0.014), (0.035, -0.028), (0.022, -0.05), (0.002, -0.05)]
            fill(image, [(x + a * wide, y * high + b * wide) for a, b in shoe], tone)
            stroke(image, [(x, y * high), (x + 0.06 * wide, y * high)], shade(tone, 0.4), 2)


def _screens(image: UInt8, rng: np.random.Generator) -> None:
    high, wide = image.shape[:2]
    for y in (0.26, 0.54):
        for x in (0.17, 0.41, 0.65):
            box = (x * wide, y * high, (x + 0.2) * wide, (y + 0.22) * high)
            rectangle(image, box, (22, 22, 24))
            inner = (box[0] + 4, box[1] + 4, box[2] - 4, box[3] - 4)
            gradient(part(image, inner), choose_colour(rng, BRIGHT), choose_colour(rng, DEEP))
            disc(
                image,
                rng.uniform(inner[0] + 12, inner[2] - 12),
                0.5 * (inner[1] + inner[3]),
                10.0,
                choose_colour(rng, PALE),
            )
    for x in np.linspace(0.08, 0.85, 6) * wide:
        rounded_rectangle(
            image,
            (x, 0.86 * high, x + 0.07 * wide, 0.95 * high),
            5,
            choose_colour(rng, ((40, 40, 44), (200, 200, 204))),
        )


def _furniture(image: UInt8, rng: np.random.Generator) -> None:
    high, wide = image.shape[:2]
    tone = choose_colour(rng, BRIGHT)
    rounded_rectangle(image, (0.14 * wide, 0.52 * high, 0.56 * wide, 0.76 * high), 14, shade(tone, 0.8))
    rounded_rectangle(image, (0.10 * wide, 0.66 * high, 0.60 * wide, 0.88 * high), 12, tone)
    for x in (0.24, 0.44):
        rounded_rectangle(image, (x * wide - 22, 0.55 * high, x * wide + 22, 0.70 * high), 8, choose_colour(rng, PALE))
    stroke(image, [(0.72 * wide, 0.92 * high), (0.72 * wide, 0.36 * high)], (40, 38, 36), 4)
    glow(image, 0.72 * wide, 0.36 * high, 0.3 * high, 0.8, (255, 222, 160))
    fill(
        image,
        [
            (0.66 * wide, 0.42 * high),
            (0.78 * wide, 0.42 * high),
            (0.75 * wide, 0.26 * high),
            (0.69 * wide, 0.26 * high),
        ],
        (236, 214, 160),
    )
    rectangle(image, (0.30 * wide, 0.24 * high, 0.50 * wide, 0.42 * high), (60, 50, 40))
    gradient(
        part(image, (0.31 * wide, 0.255 * high, 0.49 * wide, 0.405 * high)),
        choose_colour(rng, BRIGHT),
        choose_colour(rng, PALE),
    )


_GOODS: Final[tuple[_Goods, ...]] = (
    _grocery, _clothes, _bakery, _cafe, _books, _plants, _shoes, _screens, _furniture, _clothes, _cafe, _grocery,
)  # fmt: skip
