"""Draws the motifs of advertisements: landscapes, towns, bottles, cars, cups, fruit, figures, plain shapes."""

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
    rectangle,
    rounded_rectangle,
    shade,
    star,
    stroke,
)

BRIGHT: Final[tuple[Colour, ...]] = (
    (196, 40, 42), (226, 118, 30), (238, 190, 40), (70, 146, 70), (34, 118, 160), (44, 66, 148), (120, 58, 130),
    (206, 84, 120), (30, 138, 132), (150, 96, 60),
)  # fmt: skip
DEEP: Final[tuple[Colour, ...]] = (
    (28, 36, 58), (52, 28, 36), (24, 56, 50), (40, 40, 44), (66, 44, 30), (30, 60, 92), (88, 24, 30), (22, 74, 62),
)  # fmt: skip
PALE: Final[tuple[Colour, ...]] = (
    (226, 222, 212), (222, 212, 190), (206, 218, 224), (224, 206, 200), (208, 220, 204), (232, 230, 226),
)  # fmt: skip

Motif = Callable[[UInt8, np.random.Generator], None]


def hills(image: UInt8, rng: np.random.Generator) -> None:
    """Draw several ridges under an evening or a midday sky."""
    high, wide = image.shape[:2]
    warm = rng.random() < 0.5
    sky = ((92, 120, 176), (238, 176, 110)) if warm else ((88, 150, 206), (206, 226, 236))
    gradient(image, *sky)
    sun_x, sun_y = rng.uniform(0.2 * wide, wide), 0.45 * high
    glow(image, sun_x, sun_y, 0.35 * high, 0.8, (255, 236, 180))
    disc(image, sun_x, sun_y, 0.06 * high, (252, 240, 200))
    near, far = ((40, 52, 48), (140, 110, 124)) if warm else ((44, 92, 46), (130, 160, 170))
    x = np.linspace(0, wide, 40)
    for step in range(4):
        share = step / 3
        rough = sum(rng.normal(0, 1 / k) * arrays.sin(k * x / wide * 2.6 + rng.uniform(0, 6)) for k in (1, 2, 4, 9))
        y = high * (0.46 + 0.15 * step - 0.05 * (1.4 - share) * rough)
        fill(image, [*zip(x, y), (wide, high), (0, high)], mix(far, near, share))


def skyline(image: UInt8, rng: np.random.Generator) -> None:
    """Draw towers with lit windows."""
    high, wide = image.shape[:2]
    gradient(image, (22, 28, 66), (196, 110, 120))
    for depth, tone in ((0.45, (70, 58, 96)), (0.8, (30, 28, 52))):
        at = -5.0
        while at < wide:
            broad = rng.uniform(0.05, 0.12) * wide
            tall = rng.uniform(0.25, 0.75) * high * (1.35 - depth)
            rectangle(image, (at, high - tall, min(at + broad, wide), high), tone)
            for x in np.arange(at + 3, min(at + broad, wide) - 4, 6):
                for y in np.arange(high - tall + 4, high - 4, 8):
                    if rng.random() < 0.35:
                        rectangle(image, (x, y, x + 3, y + 4), (244, 206, 120))
            at += broad + rng.uniform(0, 4)


def bottle(image: UInt8, rng: np.random.Generator) -> None:
    """Draw a bottle with a label and drops of water."""
    high, wide = image.shape[:2]
    base = choose_colour(rng, BRIGHT)
    gradient(image, mix(base, (255, 255, 255), 0.55), base)
    x = 0.5 * wide
    glow(image, x, 0.5 * high, 0.45 * high, 0.6)
    glass = choose_colour(rng, ((30, 84, 40), (94, 44, 18), (170, 30, 34), (34, 70, 120)))
    r = 0.13 * high
    rounded_rectangle(image, (x - r, 0.36 * high, x + r, high - 0.04 * high), 0.05 * high, glass)
    fill(
        image,
        [
            (x - r, 0.42 * high),
            (x - 0.4 * r, 0.22 * high),
            (x + 0.4 * r, 0.22 * high),
            (x + r, 0.42 * high),
        ],
        glass,
    )
    rectangle(image, (x - 0.38 * r, 0.1 * high, x + 0.38 * r, 0.25 * high), glass)
    rectangle(image, (x - 0.46 * r, 0.06 * high, x + 0.46 * r, 0.11 * high), (206, 170, 70))
    rounded_rectangle(image, (x - r, 0.5 * high, x + r, 0.76 * high), 4, (228, 222, 204))
    fill(image, star(x, 0.63 * high, 0.8 * r, 5, 0.45), base)
    stroke(
        image,
        [(x - 0.7 * r, 0.44 * high), (x - 0.7 * r, high - 0.1 * high)],
        mix(glass, (255, 255, 255), 0.5),
        0.12 * r,
    )
    for _ in range(40):
        disc(
            image,
            x + rng.uniform(-0.9, 0.9) * r,
            rng.uniform(0.42 * high, high - 0.06 * high),
            rng.uniform(0.6, 2.0),
            mix(glass, (255, 255, 255), 0.6),
        )


def car(image: UInt8, rng: np.random.Generator) -> None:
    """Draw a car on a road at dusk, seen from the side."""
    high, wide = image.shape[:2]
    gradient(image, (44, 50, 80), (226, 160, 110))
    road = 0.74 * high
    rectangle(image, (0, road, wide, high), (48, 48, 52))
    length = min(0.78 * wide, 1.9 * high)
    x, y, unit = 0.5 * wide - 0.5 * length, 0.84 * high, length / 4.4
    paint = choose_colour(rng, BRIGHT)
    body = [
        (0, 0.35),
        (0.05, 0.75),
        (0.9, 0.95),
        (1.5, 1.4),
        (2.9, 1.42),
        (3.7, 0.98),
        (4.3, 0.9),
        (4.4, 0.4),
        (4.3, 0.2),
        (0.1, 0.2),
    ]
    fill(image, [(x + a * unit, y - b * unit) for a, b in body], paint)
    pane = [(1.15, 0.96), (1.62, 1.32), (2.82, 1.34), (3.4, 0.98)]
    fill(image, [(x + a * unit, y - b * unit) for a, b in pane], (36, 44, 56))
    stroke(image, [(x + 2.25 * unit, y - 1.36 * unit), (x + 2.3 * unit, y - 0.3 * unit)], shade(paint, 0.6), 2)
    stroke(
        image,
        [(x + 0.1 * unit, y - 0.72 * unit), (x + 4.3 * unit, y - 0.78 * unit)],
        mix(paint, (255, 255, 255), 0.5),
        2,
    )
    for axle in (0.85, 3.5):
        disc(image, x + axle * unit, y - 0.22 * unit, 0.40 * unit, (24, 24, 26))
        disc(image, x + axle * unit, y - 0.22 * unit, 0.25 * unit, (160, 162, 166))
    glow(image, x + 4.3 * unit, y - 0.7 * unit, 0.5 * unit, 0.9)


def cup(image: UInt8, rng: np.random.Generator) -> None:
    """Draw a steaming cup of coffee with beans around it."""
    high, wide = image.shape[:2]
    gradient(image, (104, 66, 42), (46, 28, 20))
    x, y, r = 0.5 * wide, 0.62 * high, min(0.26 * wide, 0.30 * high)
    for _ in range(26):
        bx, by = rng.uniform(0, wide), rng.uniform(0.8 * high, high)
        disc(image, bx, by, 0.09 * r, (64, 36, 20), 0.7)
    disc(image, x, y + 0.95 * r, 1.5 * r, (206, 202, 196), 0.28)
    disc(image, x + 1.05 * r, y + 0.2 * r, 0.42 * r, (222, 218, 210))
    disc(image, x + 1.05 * r, y + 0.2 * r, 0.24 * r, (84, 52, 34))
    fill(
        image,
        [(x - r, y - 0.2 * r), (x + r, y - 0.2 * r), (x + 0.7 * r, y + 0.95 * r), (x - 0.7 * r, y + 0.95 * r)],
        (228, 224, 216),
    )
    disc(image, x, y - 0.2 * r, r, (234, 230, 224), 0.26)
    disc(image, x, y - 0.19 * r, 0.88 * r, (90, 52, 26), 0.22)
    for shift in (-0.35, 0.05, 0.4):
        wave = np.linspace(0, 1, 14)
        stroke(
            image,
            np.c_[x + (shift + 0.12 * arrays.sin(7 * wave + shift)) * r, y - 0.4 * r - 1.1 * r * wave],
            (170, 140, 118),
            0.07 * r,
        )


def fruit(image: UInt8, rng: np.random.Generator) -> None:
    """Draw apples, oranges and leaves in a heap."""
    high, wide = image.shape[:2]
    gradient(image, (210, 226, 196), (120, 168, 96))
    high = high
    for y in np.linspace(0.45 * high, high - 0.08 * high, 5):
        for x in np.arange(rng.uniform(0, 20), wide, 0.19 * high):
            r = rng.uniform(0.09, 0.13) * high
            tone = choose_colour(rng, ((196, 42, 36), (230, 134, 34), (206, 186, 50), (110, 160, 50), (150, 30, 60)))
            disc(image, x + 1.5, y + 2, r, shade(tone, 0.5))
            disc(image, x, y, r, tone)
            disc(image, x - 0.3 * r, y - 0.35 * r, 0.3 * r, mix(tone, (255, 255, 255), 0.5))


def figure(image: UInt8, rng: np.random.Generator) -> None:
    """Draw the silhouette of a leaping person in front of coloured rays."""
    high, wide = image.shape[:2]
    x, y = 0.5 * wide, 0.52 * high
    one, other = choose_colour(rng, BRIGHT), choose_colour(rng, PALE)
    gradient(image, other, other)
    rays = 14
    for number in range(rays):
        a, b = 2 * np.pi * number / rays, 2 * np.pi * (number + 0.5) / rays
        ends = [
            (np.clip(x + 2 * wide * arrays.cos(t), 0, wide), np.clip(y + 2 * wide * arrays.sin(t), 0, high))
            for t in (a, b)
        ]
        fill(image, [(x, y), *ends], one)
    ink, unit = choose_colour(rng, DEEP), 0.09 * high
    lift, swing = rng.uniform(0.5, 1.4), rng.choice([-1.0, 1.0])
    joints = np.array(
        [
            (0, -2.4),
            (0, -1.6),
            (0, 0.4),
            (1.6, 1.2),
            (2.6, 2.6),
            (-1.4, 1.4),
            (-3.0, 1.2),
            (1.9, -2.2 * lift),
            (-1.9, -1.2),
        ]
    )
    joints = joints * (swing * unit, unit) + (x, y)
    disc(image, joints[0, 0], joints[0, 1], 0.62 * unit, ink)
    stroke(image, joints[[1, 2]], ink, 1.1 * unit)
    for limb in ((2, 3, 4), (2, 5, 6)):
        stroke(image, joints[list(limb)], ink, 0.62 * unit)
    for hand in (7, 8):
        stroke(image, joints[[1, hand]], ink, 0.42 * unit)


def shapes(image: UInt8, rng: np.random.Generator) -> None:
    """Draw circles, bars and triangles of a few colours."""
    high, wide = image.shape[:2]
    ground = choose_colour(rng, PALE)
    gradient(image, ground, shade(ground, 0.92))
    size = min(wide, high)
    for _ in range(9):
        x, y = rng.uniform(0, wide), rng.uniform(0, high)
        r = min(rng.uniform(0.06, 0.24) * size, x, wide - x, y, high - y)
        tone = choose_colour(rng, BRIGHT)
        kind = rng.integers(3)
        if r < 3:
            continue
        if kind == 0:
            disc(image, x, y, r, tone)
        elif kind == 1:
            fill(image, star(x, y, r, 3, 0.5, rng.uniform(0, 6)), tone)
        else:
            rectangle(image, (x - r, y - 0.3 * r, x + r, y + 0.3 * r), tone)
    for _ in range(3):
        x, y = rng.uniform(0, wide - 0.4 * size), rng.uniform(0, high - 0.4 * size)
        stroke(image, [(x, y), (x + 0.4 * size, y + 0.4 * size)], choose_colour(rng, DEEP), 0.02 * size)


MOTIFS: Final[tuple[Motif, ...]] = (hills, skyline, bottle, car, cup, fruit, figure, shapes)
