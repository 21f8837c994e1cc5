"""Grains of plants (grass, bark, leaves), and of cloth and metal, which are drawn with similar strokes."""

from __future__ import annotations

import cv2
import numpy as np

from mirror.arrays import Float32, Float64
from mirror.portable import arrays
from mirror.synth.textures.grains.noise import waves, wrap_patch

_SHIFT = 4


def grass(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Draw blades of grass in tufts over dark soil, with some dry ones."""
    tone = np.full((size, size), 62, np.uint8)
    count, texel = 12000, period_m / size
    tufts = waves(rng, size, 0.3, 0.04, 0.5)
    places = rng.uniform(0, size, (count, 2))
    lengths = rng.uniform(0.03, 0.09, count) / texel
    turns = rng.uniform(0, 2 * np.pi, count)
    lush = tufts[places[:, 1].astype(int), places[:, 0].astype(int)]
    shades = (np.linspace(70, 142, count) + rng.normal(0, 20, count) + 12 * lush).clip(40, 235)
    shades[rng.random(count) < 0.03] = 215
    offsets = np.c_[arrays.cos(turns), arrays.sin(turns)] * lengths[:, None]
    for (x, y), offset, shade, length in zip(places, offsets, shades, lengths):
        for left, top in wrap_patch(x, y, length, size):
            near = (round(left * 2**_SHIFT), round(top * 2**_SHIFT))
            far = (round((left + offset[0]) * 2**_SHIFT), round((top + offset[1]) * 2**_SHIFT))
            cv2.line(tone, near, far, shade, 1, cv2.LINE_AA, _SHIFT)
    return tone.astype(np.float32) / 115.0 + 0.05 * tufts


def bark(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Draw ridges along v, separated by dark fissures."""
    ridges = np.abs(waves(rng, size, 0.30, 0.06, 0.4, 6.0))
    plates = waves(rng, size, 0.08, 0.012, 0.4, 2.0)
    fissures = arrays.exp(-((ridges / 0.22) ** 2))
    return 1.05 + 0.16 * plates + 0.10 * ridges - 0.55 * fissures + 0.06 * waves(rng, size, 0.02, 0.004, 0.0)


def leaves(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Draw overlapping leaves of 5 to 9 cm with ribs: dark inside, light outside.

    They form clumps with dark gaps, which stay visible from a distance.
    """
    tone = np.full((size, size), 34, np.uint8)
    texel = period_m / size
    outline = _leaf()
    count = 1300
    places, turns = rng.uniform(0, size, (count, 2)), rng.uniform(0, 2 * np.pi, count)
    lengths = rng.uniform(0.05, 0.095, count) / texel
    depth = np.linspace(0.0, 1.0, count)
    shades = (48 + 78 * depth + rng.normal(0, 20, count) * (0.4 + depth)).clip(28, 225)
    for (x, y), turn, length, shade in zip(places, turns, lengths, shades):
        cos, sin = arrays.cos(turn) * length, arrays.sin(turn) * length
        shape: Float64 = arrays.matmul(outline, np.array([[cos, sin], [-sin, cos]]))
        for left, top in wrap_patch(x, y, length, size):
            points = ((shape + np.array([left, top])) * 2**_SHIFT).round().astype(np.int32)
            half = len(points) // 2
            cv2.fillPoly(tone, [points], shade * 0.86, cv2.LINE_AA, _SHIFT)
            cv2.fillPoly(tone, [points[: half + 1]], shade * 1.10, cv2.LINE_AA, _SHIFT)
            cv2.line(tone, points[0], points[half], shade * 1.32, 1, cv2.LINE_AA, _SHIFT)
    clumps = np.clip(1.0 + 0.30 * waves(rng, size, 0.40, 0.14, 0.3), 0.3, 1.8)
    return tone.astype(np.float32) / 110.0 * clumps


def _leaf() -> Float64:
    """Closed outline of a leaf of unit length, from its stalk at (-0.5, 0)."""
    along = np.linspace(0.0, 1.0, 7)
    half = 0.30 * arrays.sin(np.pi * arrays.power(along, 0.8))
    return np.r_[np.c_[along - 0.5, half], np.c_[along[-2:0:-1] - 0.5, -half[-2:0:-1]]]


def cloth(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Draw folds along v, with a faint weave."""
    folds = waves(rng, size, 0.5, 0.06, 0.9, 2.5)
    weave = waves(rng, size, 0.03, 0.008, 0.0, 0.2) + waves(rng, size, 0.03, 0.008, 0.0, 5.0)
    return 1.0 + 0.085 * folds + 0.035 * weave


def metal(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Draw metal brushed along u, with scratches and streaks of dirt along v."""
    brushed = waves(rng, size, 0.04, 0.004, 0.1, 0.01)
    runs = np.clip(waves(rng, size, 0.06, 0.01, 0.4, 25.0) - 0.8, 0.0, None)
    marks = np.clip(waves(rng, size, 0.03, 0.005, 0.0, 0.12) - 2.6, 0.0, None)
    return 1.0 + 0.028 * brushed - 0.09 * runs + 0.14 * marks + 0.02 * waves(rng, size, 0.6, 0.1, 0.8)
