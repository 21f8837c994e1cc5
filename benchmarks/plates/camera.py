"""The light and the camera of synthetic images: dirt, shade, blur, noise and compression."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from mirror.arrays import Float32, UInt8


def soil(plate: UInt8, rng: np.random.Generator, strength: float) -> UInt8:
    """Cover a plate with smooth patches of dirt."""
    high, wide = plate.shape[:2]
    grid = rng.random((int(rng.integers(2, 7)), int(rng.integers(3, 12))), np.float32)
    patches = cv2.resize(grid, (wide, high), interpolation=cv2.INTER_CUBIC)
    cover = np.clip((patches - 0.55) * 3.0, 0.0, 1.0)[..., None] * strength
    brown = np.array([rng.uniform(60, 150)] * 3) * [1.0, 0.9, 0.75]
    return np.asarray(plate * (1.0 - cover) + brown * cover, np.uint8)


def splash(plate: UInt8, rng: np.random.Generator, count: int) -> UInt8:
    """Cover a plate with splashes of mud: dirt of another kind, for tests."""
    result = plate.copy()
    high, wide = plate.shape[:2]
    for _ in range(count):
        place = (int(rng.integers(0, wide)), int(rng.integers(high // 3, high)))
        radius = max(round(float(rng.exponential(0.045 * high))), 1)
        tone = rng.uniform(0.6, 1.2)
        cv2.circle(result, place, radius, (int(92 * tone), int(80 * tone), int(62 * tone)), -1, cv2.LINE_AA)
    return result


def shade(image: UInt8, rng: np.random.Generator) -> UInt8:
    """Darken or lighten an image along a direction, and give its colours a cast."""
    height, width = image.shape[:2]
    corners = rng.uniform(0.65, 1.2, (2, 2)).astype(np.float32)
    field = cv2.resize(corners, (width, height), interpolation=cv2.INTER_LINEAR)
    cast = rng.normal(1.0, 0.06, 3).astype(np.float32)
    return np.asarray(cv2.multiply(image, field[..., None] * cast, dtype=cv2.CV_8U), np.uint8)


def make_night(image: UInt8, rng: np.random.Generator) -> UInt8:
    """Darken an image as at night, under lamps."""
    ramp = (np.arange(256) / 255.0) ** rng.uniform(1.1, 2.4) * rng.uniform(0.25, 0.8)
    cast = np.array([1.0, rng.uniform(0.8, 1.0), rng.uniform(0.55, 1.05)])
    table = np.clip(255.0 * ramp[:, None] * cast, 0, 255).astype(np.uint8)
    return np.stack([cv2.LUT(np.ascontiguousarray(image[..., one]), table[:, one]) for one in range(3)], axis=-1)


def blur(image: UInt8, rng: np.random.Generator, most_px: float) -> UInt8:
    """Blur an image by defocus or by a motion."""
    if rng.random() < 0.5:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), rng.uniform(0.3, max(most_px, 0.35))), np.uint8)
    length = max(int(rng.uniform(1.0, 2.0 * most_px + 1.0)), 1)
    kernel = np.zeros((2 * length + 1, 2 * length + 1), np.float32)
    angle = rng.uniform(0, np.pi)
    ahead = np.array([np.cos(angle), np.sin(angle)]) * 0.5 * length
    first, last = (tuple((length + sign * ahead).round().astype(int).tolist()) for sign in (-1, 1))
    cv2.line(kernel, first, last, 1.0)
    return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum()), np.uint8)


def record(image: UInt8, rng: np.random.Generator, noise: float, quality: int) -> UInt8:
    """Add the noise of a sensor, and compress an image as JPEG."""
    height, width = image.shape[:2]
    table = _noise_table()
    v, u = (int(rng.integers(0, table.shape[axis] - size)) for axis, size in ((0, height), (1, width)))
    added = table[v : v + height, u : u + width] * np.float32(noise)
    noisy = cv2.add(image, added, dtype=cv2.CV_8U)
    coded = cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)


@cache
def _noise_table() -> Float32:
    """Normal noise (H, W, 3), a little of it common to neighbours."""
    noise = np.random.default_rng(7).normal(0.0, 1.0, (1100, 1700, 3)).astype(np.float32)
    soft = cv2.GaussianBlur(noise, (0, 0), 0.8)
    return np.asarray(0.7 * noise + 0.7 * soft / soft.std(), np.float32)
