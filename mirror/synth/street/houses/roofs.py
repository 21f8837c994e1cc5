"""Roofs: flat ones with equipment; gabled, hipped and mansard ones with dormers and chimneys."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final

import numpy as np

from mirror.portable import scalars
from mirror.synth.model import Finish, Label, Material, Pieces
from mirror.synth.street.houses.body import HouseBody
from mirror.synth.street.houses.styles import TILES, Colour, RoofKind
from mirror.synth.street.houses.windows import Windows

_FASCIA_M: Final = 0.18
_GUTTER: Final[Colour] = (0.22, 0.22, 0.21)
_METAL: Final[Colour] = (0.40, 0.41, 0.41)


def add_roof(pieces: Pieces, body: HouseBody, kind: RoofKind, rng: np.random.Generator) -> None:
    """Add a roof on the walls of a body."""
    tiles = Finish(TILES[int(rng.integers(len(TILES)))], Material.ROOF, Label.BUILDING, body.seed)
    depth = body.back - body.front
    if kind == "flat":
        _add_flat_roof(pieces, body, rng)
    elif kind == "hip":
        _add_hip_roof(pieces, body, tiles, scalars.tan(math.radians(rng.uniform(28.0, 36.0))))
    elif kind == "gable":
        slope = scalars.tan(math.radians(rng.uniform(36.0, 46.0)))
        ridge = 0.5 * depth * slope
        _add_profile(pieces, body, tiles, [(0.0, 0.0), (0.5 * depth, ridge), (depth, 0.0)])
        if depth > 7.5 and rng.random() < 0.75:
            _add_dormers(pieces, body, tiles, slope, 0.0, rng)
        _add_chimneys(pieces, body, ridge, rng)
    else:
        steep, foot = 2.5, 0.9
        top = steep + 0.22 * (0.5 * depth - foot)
        _add_profile(
            pieces, body, tiles, [(0.0, 0.0), (foot, steep), (0.5 * depth, top), (depth - foot, steep), (depth, 0.0)]
        )
        _add_dormers(pieces, body, tiles, steep / foot, 0.45, rng)
        _add_chimneys(pieces, body, top, rng)


def _add_profile(pieces: Pieces, body: HouseBody, tiles: Finish, profile: list[tuple[float, float]]) -> None:
    """Extrude a convex profile (distance from the front, height above the eaves) along the street, with fascias."""
    over = 0.35
    base = body.eaves_m + _FASCIA_M
    left, right = body.left, body.right
    edges = [(body.front + y, base + z) for y, z in profile]
    first, last = profile[0], profile[-1]
    edges[0], edges[-1] = (body.front + first[0] - over, base), (body.front + last[0] + over, base)
    for (a, low), (b, high) in pairwise(edges):
        pieces.face(((left, a, low), (right, a, low), (right, b, high), (left, b, high)), tiles)
    gutter = Finish(_GUTTER, Material.METAL, Label.BUILDING)
    pieces.block((left, edges[0][0], body.eaves_m), (right, edges[-1][0], base), gutter, without=("-z", "+z"))
    soffit = body.plain(0.9, Material.PLASTER)
    _add_soffit(pieces, (left, edges[0][0]), (right, edges[-1][0]), body.eaves_m, soffit)
    for x in (left, right):
        outline = [(x, y, z) for y, z in edges]
        pieces.face(outline if x == left else outline[::-1], body.plain())


def _add_soffit(pieces: Pieces, low: tuple[float, float], high: tuple[float, float], z: float, finish: Finish) -> None:
    """Add a horizontal rectangle that faces down."""
    (a, b), (c, d) = low, high
    pieces.face(((a, d, z), (c, d, z), (c, b, z), (a, b, z)), finish)


def _add_hip_roof(pieces: Pieces, body: HouseBody, tiles: Finish, slope: float) -> None:
    over = 0.45
    left, right, front, back = body.left - over, body.right + over, body.front - over, body.back + over
    low = body.eaves_m + _FASCIA_M
    half = 0.5 * min(right - left, back - front)
    high = low + half * slope
    middle_y, middle_x = 0.5 * (front + back), 0.5 * (left + right)
    if right - left >= back - front:
        ends = (left + half, middle_y, high), (right - half, middle_y, high)
    else:
        ends = (middle_x, front + half, high), (middle_x, back - half, high)
    a, b, c, d = (left, front, low), (right, front, low), (right, back, low), (left, back, low)
    if right - left >= back - front + 0.1:
        faces = [(a, b, ends[1], ends[0]), (b, c, ends[1]), (c, d, ends[0], ends[1]), (d, a, ends[0])]
    elif back - front >= right - left + 0.1:
        faces = [(a, b, ends[0]), (b, c, ends[1], ends[0]), (c, d, ends[1]), (d, a, ends[0], ends[1])]
    else:
        peak = (middle_x, middle_y, high)
        faces = [(a, b, peak), (b, c, peak), (c, d, peak), (d, a, peak)]
    for corners in faces:
        pieces.face(corners, tiles)
    gutter = Finish(_GUTTER, Material.METAL, Label.BUILDING)
    pieces.block((left, front, body.eaves_m), (right, back, low), gutter, without=("-z", "+z"))
    _add_soffit(pieces, (left, front), (right, back), body.eaves_m, body.plain(0.9, Material.PLASTER))


def _add_dormers(
    pieces: Pieces, body: HouseBody, tiles: Finish, slope: float, above_m: float, rng: np.random.Generator
) -> None:
    """Add dormers to the front slope, above columns of windows."""
    columns, _ = body.columns()
    chosen = columns[int(rng.integers(2)) :: 2][:4]
    base = body.eaves_m + _FASCIA_M
    high = 1.6
    foot = base + max(above_m, 0.45)
    for x in chosen:
        front = body.front + (foot - base) / slope
        back = front + high / slope
        left, right, top = x - 0.7, x + 0.7, foot + high
        wall = Finish((0.5, 0.49, 0.46), Material.FACADE, Label.BUILDING, body.seed + int(10 * x), int(Windows.DORMER))
        cheek = tiles._replace(material=Material.METAL, colour=(0.16, 0.17, 0.17))
        pieces.wall((left, front), (right, front), foot, top, wall)
        pieces.face(((left, back, top), (left, front, foot), (left, front, top)), cheek)
        pieces.face(((right, front, foot), (right, back, top), (right, front, top)), cheek)
        roof = (left - 0.12, front - 0.15, top), (right + 0.12, back + 0.05, top + 0.12)
        pieces.block(*roof, cheek, without=("+y",))


def _add_chimneys(pieces: Pieces, body: HouseBody, ridge_m: float, rng: np.random.Generator) -> None:
    brick = Finish((0.28, 0.14, 0.10), Material.BRICK, Label.BUILDING, body.seed)
    middle = 0.5 * (body.front + body.back)
    top = body.eaves_m + _FASCIA_M + ridge_m
    for _ in range(int(rng.integers(1, 3))):
        x, y = rng.uniform(body.left + 0.8, body.right - 0.8), middle + rng.uniform(-0.9, 0.9)
        pieces.block((x - 0.4, y - 0.3, top - 1.4), (x + 0.4, y + 0.3, top + rng.uniform(0.5, 1.0)), brick)


def _add_flat_roof(pieces: Pieces, body: HouseBody, rng: np.random.Generator) -> None:
    """Add a parapet, and on some roofs a set-back storey, a shaft, air conditioners or an antenna."""
    left, right, front, back = body.left, body.right, body.front, body.back
    top = body.eaves_m + 0.55
    pieces.block((left, front, body.eaves_m), (right, back, top), body.plain(), without=("-z", "+z"))
    rim = Finish(_METAL, Material.METAL, Label.BUILDING)
    felt = Finish((0.20, 0.20, 0.19), Material.GRAVEL, Label.BUILDING, body.seed)
    pieces.block((left, front - 0.05, top), (right, back + 0.05, top + 0.08), rim, without=("+z",))
    pieces.level((left, front - 0.05), (right, back + 0.05), top + 0.08, felt)
    top += 0.08
    wide, depth = right - left, back - front
    if rng.random() < 0.3 and depth > 8.0 and wide > 8.0:
        near, far = (left + 1.2, front + 2.2), (right - 1.2, back - 1.0)
        wall = body.finish(Windows.MODERN, 11)
        outline = [near, (far[0], near[1]), far, (near[0], far[1])]
        pieces.prism(outline, top, top + 3.0, wall, top=felt)
        pieces.block(
            (near[0] - 0.4, near[1] - 0.5, top + 3.0), (far[0] + 0.4, far[1] + 0.3, top + 3.2), rim, without=()
        )
        top += 3.2
    for _ in range(int(rng.integers(1, 4))):
        x, y = rng.uniform(left + 1.8, right - 1.8), rng.uniform(front + 0.35 * depth, back - 1.8)
        if rng.random() < 0.4:
            pieces.block((x - 1.3, y - 1.2, top), (x + 1.3, y + 1.2, top + 2.3), body.plain(0.85))
        else:
            pieces.block((x - 0.6, y - 0.4, top + 0.15), (x + 0.6, y + 0.4, top + 1.1), rim)
    if rng.random() < 0.6:
        x, y = rng.uniform(left + 1.0, right - 1.0), front + rng.uniform(0.2, 0.7) * depth
        mast = Finish((0.30, 0.30, 0.30), Material.METAL, Label.BUILDING)
        high = top + rng.uniform(2.2, 4.0)
        pieces.tube((x, y, top), (x, y, high), 0.04, mast, corners=3)
        for step in range(3):
            pieces.tube((x - 0.5, y, high - 0.3 * step), (x + 0.5, y, high - 0.3 * step), 0.02, mast, corners=3)
