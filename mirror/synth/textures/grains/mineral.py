"""Grains of ground and walls without rows: asphalt, gravel, plaster, concrete, and dirt."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from mirror.arrays import Float32, UInt8
from mirror.synth.textures.grains.noise import joints, scatter_centres, waves, wrap_patch

_SHIFT: Final = 4
_STONE: Final = ((1.2, 0.55, 0.25), (1.0, 1.0, 0.0), (0.6, 1.08, -0.2))
_PEBBLE: Final = ((1.15, 0.7, 0.2), (0.9, 1.0, 0.0))
"""Ellipses of a drawn stone, its shadow first: size, tone, sideways offset."""


def asphalt(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Draw stones of 4 to 11 mm in bitumen; some are bright, some are missing."""
    stones = waves(rng, size, 0.02, 0.0035, 0.0)
    bright = np.clip(stones - 0.9, 0.0, None)
    pits = np.clip(-stones - 1.3, 0.0, None)
    mottled = waves(rng, size, 0.25, 0.03, 0.8)
    return 1.0 + 0.085 * stones + 0.30 * bright - 0.30 * pits + 0.035 * mottled


def gravel(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Draw stones of 1 to 5 cm, lit from one side, over dark gaps and sand."""
    tone = np.full((size, size), 70, np.uint8)
    texel = period_m / size
    radii = np.sort(0.008 * rng.pareto(2.8, 4000) + 0.008).clip(None, 0.03)[::-1] / texel
    places = rng.uniform(0, size, (len(radii), 2))
    shades = rng.normal(118, 20, len(radii)).clip(60, 205)
    turns, flats = rng.uniform(0, 180, len(radii)), rng.uniform(0.6, 1.0, len(radii))
    for (x, y), radius, shade, turn, flat in zip(places, radii, shades, turns, flats):
        for left, top in wrap_patch(x, y, radius + 2, size):
            for grow, part, shift in _STONE if radius > 2.4 else _PEBBLE:
                centre = (round((left + shift * radius) * 2**_SHIFT), round((top - shift * radius) * 2**_SHIFT))
                axes = (round(grow * radius * 2**_SHIFT), round(grow * flat * radius * 2**_SHIFT))
                cv2.ellipse(tone, centre, axes, turn, 0, 360, shade * part, -1, cv2.LINE_AA, _SHIFT)
    fine = waves(rng, size, 0.03, 0.004, 0.0)
    return tone.astype(np.float32) / 120.0 + 0.07 * fine + 0.05 * waves(rng, size, 0.4, 0.1, 0.5)


def plaster(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Draw plaster with fine bumps, strokes of the float and faint patches."""
    bumps = waves(rng, size, 0.02, 0.004, 0.3)
    strokes = waves(rng, size, 0.12, 0.012, 0.6, 0.35)
    return 1.0 + 0.028 * bumps + 0.018 * strokes + 0.022 * waves(rng, size, 0.5, 0.06, 0.9)


def concrete(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Draw panels of 2 m by 1 m with joints, tie holes, pores and soft patches."""
    at, texel = scatter_centres(size, period_m), period_m / size
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


def _disc(tone: UInt8, x: float, y: float, radius: float, shade: int) -> None:
    centre = (round(x * 2**_SHIFT), round(y * 2**_SHIFT))
    cv2.circle(tone, centre, round(radius * 2**_SHIFT), shade, -1, cv2.LINE_AA, _SHIFT)


def stains(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Draw dirt: large soft patches and a few darker spots."""
    soft = waves(rng, size, 0.7, 0.02, 1.15)
    spots = np.clip(waves(rng, size, 0.12, 0.012, 0.8) - 1.2, 0.0, None)
    return 1.0 + 0.075 * soft - 0.10 * spots + 0.02 * waves(rng, size, 0.05, 0.006, 0.4)
