"""Grains of materials in rows: slabs, bricks, tiles, planks."""

from __future__ import annotations

import numpy as np

from mirror.arrays import Float32, Float64
from mirror.portable import arrays
from mirror.synth.textures.grains.noise import joints, waves


def _lay_units(
    rng: np.random.Generator, size: int, rows: int, columns: int, shift: float, spread: float
) -> tuple[Float64, Float64, Float64]:
    """Lay pieces in rows; every other row is displaced by ``shift`` of a piece.

    Returns:
        Three (size, size) arrays: tone of the piece, and position in the piece along u and along v, 0 to 1.
    """
    down = (np.arange(size) + 0.5) * (rows / size)
    row = down.astype(np.int64)
    across = (np.arange(size) + 0.5)[None, :] * (columns / size) + (shift * (row % 2))[:, None]
    column = across.astype(np.int64) % columns
    tones = rng.normal(0.0, spread, (rows, columns))
    return tones[row[:, None], column], across % 1.0, np.broadcast_to((down % 1.0)[:, None], (size, size))


def _bevel(inside: Float64, piece_m: float, width_m: float) -> Float64:
    """Shading of a bevel: 1 at the low edge of a piece, -1 at its high edge, 0 between."""
    low, high = inside * piece_m, (1.0 - inside) * piece_m
    return np.clip(1.0 - low / width_m, 0.0, 1.0) - np.clip(1.0 - high / width_m, 0.0, 1.0)


def paving(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Draw concrete slabs of 0.4 m in a running bond, with joints, worn edges and chewing gum."""
    pitch, texel = 0.4, period_m / size
    tone, along, up = _lay_units(rng, size, 6, 6, 0.5, 0.055)
    joint = np.maximum(joints(along * pitch, pitch, 0.010, texel), joints(up * pitch, pitch, 0.010, texel))
    edge = arrays.exp(-np.minimum(np.minimum(along, 1 - along), np.minimum(up, 1 - up)) * pitch / 0.018)
    fine = waves(rng, size, 0.02, 0.0035, 0.0)
    gum = np.clip(3.0 * (waves(rng, size, 0.03, 0.012, 0.0) - 2.45), 0.0, 1.0)
    body = (1.0 + tone + 0.055 * fine + 0.03 * waves(rng, size, 0.3, 0.04, 0.8)) * (1.0 - 0.10 * edge)
    return (body * (1.0 - 0.22 * gum) * (1.0 - joint) + 0.48 * joint).astype(np.float32)


def brick(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Draw bricks of 0.26 m by 0.08 m with mortar in a stretcher bond; some are darker."""
    texel = period_m / size
    tone, along, up = _lay_units(rng, size, 26, 8, 0.5, 0.11)
    tone = tone - 0.12 * (tone < -0.15)
    mortar = np.maximum(joints(along * 0.26, 0.26, 0.010, texel), joints(up * 0.08, 0.08, 0.010, texel))
    fine = waves(rng, size, 0.03, 0.004, 0.2)
    body = 1.0 + tone + 0.07 * fine + 0.10 * waves(rng, size, 0.06, 0.02, 0.4)
    # Rows run along v, upwards on a wall, so the low edge of a brick is shaded.
    body -= 0.14 * _bevel(up, 0.08, 0.012)
    pale = 1.32 + 0.06 * fine
    return (body * (1.0 - mortar) + pale * mortar).astype(np.float32)


def roof(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Draw pantiles of 0.2 m by 0.3 m with a round profile; each row overlaps the one below."""
    texel = period_m / size
    tone, along, up = _lay_units(rng, size, 8, 12, 0.0, 0.09)
    rolled = arrays.sin(2.0 * np.pi * along) * 0.16 + 0.06 * arrays.cos(4.0 * np.pi * along)
    shade = np.clip((up * 0.3 - 0.262) / 0.02, 0.0, 1.0)
    lip = np.clip(1.0 - up * 0.3 / 0.016, 0.0, 1.0)
    groove = joints(along * 0.2, 0.2, 0.012, texel)
    fine = waves(rng, size, 0.05, 0.005, 0.3)
    moss = np.clip(waves(rng, size, 0.12, 0.02, 0.6) - 1.1, 0.0, None)
    body = 1.0 + tone + rolled + 0.05 * fine - 0.16 * moss + 0.13 * lip
    return (body * (1.0 - 0.5 * shade) * (1.0 - 0.35 * groove)).astype(np.float32)


def wood(rng: np.random.Generator, size: int, period_m: float) -> Float32:
    """Draw planks of 0.15 m along u, with grain, knots and gaps between planks."""
    texel = period_m / size
    tone, _, up = _lay_units(rng, size, 10, 1, 0.0, 0.09)
    gap = joints(up * 0.15, 0.15, 0.008, texel)
    warp = waves(rng, size, 0.5, 0.12, 0.6, 0.12)
    rings = arrays.sin(2.0 * np.pi * (5.0 * up + 0.8 * warp + 3.0 * tone))
    fibre = waves(rng, size, 0.05, 0.003, 0.2, 0.02)
    knots = np.clip(2.0 * (waves(rng, size, 0.10, 0.045, 0.0, 0.5) - 2.35), 0.0, 1.0)
    body = 1.0 + tone + 0.055 * rings + 0.055 * fibre - 0.40 * knots
    return (body * (1.0 - 0.62 * gap)).astype(np.float32)
