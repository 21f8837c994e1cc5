"""Ground and walls without a bond: asphalt, gravel, plaster, concrete, and the dirt on all of them."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from mirror.arrays import Float32, Float64, UInt8
from mirror.synth.textures.grains.noise import joints, middles, waves, wrapped

_SHIFT: Final = 4
_STONE: Final = ((1.2, 0.55, 0.25), (1.0, 1.0, 0.0), (0.6, 1.08, -0.2))
_PEBBLE: Final = ((1.15, 0.7, 0.2), (0.9, 1.0, 0.0))
"""Ellipses that a stone is painted with, its shade first: size, tone, how far to the side."""


def asphalt(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Stones of 4 to 11 mm in bitumen: some bright, some missing."""
    stones = waves(rng, size, 0.02, 0.0035, 0.0)
    bright = np.clip(stones - 0.9, 0.0, None)
    pits = np.clip(-stones - 1.3, 0.0, None)
    mottled = waves(rng, size, 0.25, 0.03, 0.8)
    return 1.0 + 0.085 * stones + 0.30 * bright - 0.30 * pits + 0.035 * mottled


def road(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """What lies on a carriageway: cracks, sealed and open, mended trenches, oil, worn wheel tracks, covers."""
    texel = period_m / size
    tone = np.full((size, size), 128, np.uint8)
    for _ in range(5):
        wide, high = int(rng.uniform(0.8, 5.0) / texel), int(rng.uniform(0.6, 2.2) / texel)
        x, y = rng.uniform(0, size, 2)
        shade = int(128 * rng.choice([0.72, 0.82, 0.9, 1.12]))
        for left, top in wrapped(x, y, max(wide, high), size):
            cv2.rectangle(tone, (int(left), int(top)), (int(left) + wide, int(top) + high), shade, -1)
            cv2.rectangle(tone, (int(left), int(top)), (int(left) + wide, int(top) + high), 70, 1, cv2.LINE_AA)
    for number in range(26):
        sealed = number % 3 == 0
        heading = rng.choice([0.0, 0.5 * np.pi]) + rng.normal(0.0, 0.25)
        steps = int(rng.uniform(2.0, 7.0) / 0.12)
        turns = heading + np.cumsum(rng.normal(0.0, 0.10, steps)) + rng.normal(0.0, 0.55, steps)
        path = rng.uniform(0, size, 2) + np.cumsum(np.c_[np.cos(turns), np.sin(turns)] * 0.12 / texel, axis=0)
        _crack(tone, path, 68 if sealed else 88, 3 if sealed else 1, size)
    spots = rng.uniform(0, size, (40, 2))
    for (x, y), radius in zip(spots, rng.uniform(0.04, 0.22, 40) / texel):
        shade = int(rng.uniform(96, 120))
        for left, top in wrapped(x, y, radius + 1, size):
            _disc(tone, left, top, radius, shade)
    drawn = cv2.GaussianBlur(np.pad(tone, 8, "wrap"), (0, 0), 0.7)[8:-8, 8:-8].astype(np.float32) / 128.0
    drips = np.clip(waves(rng, size, 0.02, 0.006, 0.5) - 2.1, 0.0, None)
    return drawn - 0.10 * drips + 0.02 * waves(rng, size, 0.3, 0.02, 1.0, 0.3)


def _crack(tone: UInt8, path: Float64, shade: int, thickness: int, size: int) -> None:
    reach = 0.5 * float(np.ptp(path, axis=0).max()) + 4
    middle = 0.5 * (path.min(axis=0) + path.max(axis=0))
    inside = middle % size
    for x, y in wrapped(inside[0], inside[1], reach, size):
        moved = (path - middle + [x, y]) * 2**_SHIFT
        cv2.polylines(tone, [moved.round().astype(np.int32)], False, shade, thickness, cv2.LINE_AA, _SHIFT)


def _disc(tone: UInt8, x: float, y: float, radius: float, shade: int) -> None:
    centre = (round(x * 2**_SHIFT), round(y * 2**_SHIFT))
    cv2.circle(tone, centre, round(radius * 2**_SHIFT), shade, -1, cv2.LINE_AA, _SHIFT)


def gravel(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Stones of 1 to 5 cm, lit from one side, over dark gaps and sand."""
    tone = np.full((size, size), 70, np.uint8)
    texel = period_m / size
    radii = np.sort(0.008 * rng.pareto(2.8, 4000) + 0.008).clip(None, 0.03)[::-1] / texel
    places = rng.uniform(0, size, (len(radii), 2))
    shades = rng.normal(118, 20, len(radii)).clip(60, 205)
    turns, flats = rng.uniform(0, 180, len(radii)), rng.uniform(0.6, 1.0, len(radii))
    for (x, y), radius, shade, turn, flat in zip(places, radii, shades, turns, flats):
        for left, top in wrapped(x, y, radius + 2, size):
            for grow, part, shift in _STONE if radius > 2.4 else _PEBBLE:
                centre = (round((left + shift * radius) * 2**_SHIFT), round((top - shift * radius) * 2**_SHIFT))
                axes = (round(grow * radius * 2**_SHIFT), round(grow * flat * radius * 2**_SHIFT))
                cv2.ellipse(tone, centre, axes, turn, 0, 360, shade * part, -1, cv2.LINE_AA, _SHIFT)
    fine = waves(rng, size, 0.03, 0.004, 0.0)
    return tone.astype(np.float32) / 120.0 + 0.07 * fine + 0.05 * waves(rng, size, 0.4, 0.1, 0.5)


def plaster(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Rubbed render: fine bumps, strokes of the float, faint shades."""
    bumps = waves(rng, size, 0.02, 0.004, 0.3)
    strokes = waves(rng, size, 0.12, 0.012, 0.6, 0.35)
    return 1.0 + 0.028 * bumps + 0.018 * strokes + 0.022 * waves(rng, size, 0.5, 0.06, 0.9)


def concrete(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Panels of 2 m by 1 m with joints, holes of the ties, pores and clouds."""
    at, texel = middles(size, period_m), period_m / size
    line = np.maximum(joints(at, 2.0, 0.012, texel)[None, :], joints(at, 1.0, 0.010, texel)[:, None])
    panel = rng.normal(0.0, 0.035, (4, 2)).repeat(size // 4, axis=0).repeat(size // 2, axis=1)
    boards = waves(rng, size, 0.06, 0.006, 0.3, 0.06)
    pores = np.clip(waves(rng, size, 0.012, 0.004, 0.0) - 2.3, 0.0, 1.0)
    tone = 1.0 + panel + 0.020 * boards + 0.045 * waves(rng, size, 0.4, 0.03, 1.1) - 0.25 * pores
    ties = np.zeros((size, size), np.uint8)
    for x in np.arange(0.5, period_m, 1.0):
        for y in np.arange(0.25, period_m, 0.5):
            _disc(ties, x / texel - 0.5, y / texel - 0.5, 0.014 / texel, 255)
    return (tone * (1.0 - 0.32 * line) * (1.0 - 0.4 * (ties / 255.0))).astype(np.float32)


def stains(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Weather: wide soft shades and a few darker spots."""
    soft = waves(rng, size, 0.7, 0.02, 1.15)
    spots = np.clip(waves(rng, size, 0.12, 0.012, 0.8) - 1.2, 0.0, None)
    return 1.0 + 0.075 * soft - 0.10 * spots + 0.02 * waves(rng, size, 0.05, 0.006, 0.4)
