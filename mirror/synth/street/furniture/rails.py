"""Rails, fences, walls and wires along streets; the models are in the same frame as the given lines."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.portable import arrays
from mirror.synth.model import Finish, Label, Material, Model, Pieces
from mirror.synth.street.houses.styles import Colour

_UP: Final = np.array([0.0, 0.0, 1.0])
_ZINC: Final = Finish((0.40, 0.41, 0.41), Material.METAL, Label.FURNITURE, two_sided=True)
_BEAM: Final = ((0.0, 0.52), (0.07, 0.58), (0.0, 0.67), (0.07, 0.76), (0.0, 0.82))
"""Cross-section of a guard rail's beam: offset sideways and height, metres."""
_POLE: Final = Finish((0.17, 0.12, 0.08), Material.BARK, Label.POLE)
_WIRE: Final = Finish((0.03, 0.03, 0.03), Material.PLAIN, Label.POLE)


def _space_evenly(line: Float64, step_m: float) -> Float64:
    """Evenly spaced points (N, 3) on a line, about ``step_m`` apart."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    count = max(round(along[-1] / step_m), 1) + 1
    at = np.linspace(0.0, along[-1], count)
    return np.stack([np.interp(at, along, line[:, axis]) for axis in range(3)], axis=1)


def _left_normal(start: Float64, end: Float64) -> Float64:
    """Horizontal unit vector to the left of a segment."""
    step = (end - start)[:2]
    return np.array([-step[1], step[0], 0.0]) / arrays.norm(step)


def _add_sheet(pieces: Pieces, start: Float64, end: Float64, low_m: float, high_m: float, finish: Finish) -> None:
    """Add an upright sheet above a segment; its front is on the segment's right."""
    low, high = low_m * _UP, high_m * _UP
    pieces.face(np.array([start + low, end + low, end + high, start + high]), finish)


def guard_rail(line: Float64) -> Model:
    """Build a guard rail of steel beams on posts.

    Args:
        line: (N, 3) points on the ground, metres.
    """
    pieces = Pieces()
    points = _space_evenly(line, 4.0)
    for start, end in pairwise(points):
        aside = _left_normal(start, end)
        for (a, low), (b, high) in pairwise(_BEAM):
            first, last = a * aside + low * _UP, b * aside + high * _UP
            pieces.face(np.array([start + first, end + first, end + last, start + last]), _ZINC)
        _add_sheet(pieces, start - 0.06 * aside, start - 0.06 * aside + 0.1 * (end - start) / 4.0, -0.3, 0.8, _ZINC)
    return pieces.model()


def fence(rng: np.random.Generator, line: Float64) -> Model:
    """Build a fence of wooden or metal rails on posts.

    Args:
        rng: random generator that chooses the kind.
        line: (N, 3) points on the ground, metres.
    """
    pieces = Pieces()
    wooden = bool(rng.random() < 0.6)
    colour = (0.24, 0.18, 0.12) if wooden else (0.08, 0.10, 0.09)
    board = Finish(colour, Material.WOOD if wooden else Material.METAL, Label.FURNITURE, two_sided=True)
    rails = ((0.35, 0.50), (0.75, 0.90)) if wooden else ((0.12, 0.17), (0.50, 0.54), (0.95, 1.0))
    points = _space_evenly(line, 2.5)
    for start, end in pairwise(points):
        for low, high in rails:
            _add_sheet(pieces, start, end, low, high, board)
    for place in points:
        pieces.tube(
            place - 0.3 * _UP,
            place + 1.08 * _UP,
            0.05,
            board._replace(two_sided=False),
            corners=4,
            cap=True,
        )
    return pieces.model()


def garden_wall(rng: np.random.Generator, line: Float64, *, high_m: float = 1.1) -> Model:
    """Build a wall with a coping.

    Args:
        rng: random generator that chooses brick or plaster.
        line: (N, 3) points on the ground, metres.
        high_m: height of the wall.
    """
    pieces = Pieces()
    kinds: tuple[tuple[Colour, Material], ...] = (
        ((0.31, 0.15, 0.10), Material.BRICK),
        ((0.52, 0.49, 0.43), Material.PLASTER),
        ((0.33, 0.32, 0.30), Material.CONCRETE),
    )
    colour, material = kinds[int(rng.integers(len(kinds)))]
    wall = Finish(colour, material, Label.WALL, int(rng.integers(1 << 20)))
    stone = Finish((0.40, 0.39, 0.36), Material.CONCRETE, Label.WALL)
    points = _space_evenly(line, 4.0)
    for start, end in pairwise(points):
        aside = 0.12 * _left_normal(start, end)
        _add_sheet(pieces, start - aside, end - aside, -0.5, high_m, wall)
        _add_sheet(pieces, end + aside, start + aside, -0.5, high_m, wall)
        rim = 1.4 * aside
        _add_sheet(pieces, start - rim, end - rim, high_m, high_m + 0.09, stone)
        _add_sheet(pieces, end + rim, start + rim, high_m, high_m + 0.09, stone)
        top = (high_m + 0.09) * _UP
        pieces.face(np.array([start - rim, end - rim, end + rim, start + rim]) + top, stone)
    for place, other in ((points[0], points[1]), (points[-1], points[-2])):
        rim = 0.168 * _left_normal(place, other)
        _add_sheet(pieces, place + rim, place - rim, -0.5, high_m + 0.09, stone)
    return pieces.model()


def power_line(places: Float64, *, height_m: float = 8.5, sag_m: float = 0.5) -> Model:
    """Build wooden poles with cross-arms, and three wires between neighbouring poles.

    Args:
        places: (N, 3) feet of the poles, metres.
        height_m: height of the poles.
        sag_m: sag of the wires between two poles.
    """
    pieces = Pieces()
    count = len(places)
    ends = []
    for number, place in enumerate(places):
        before, after = places[max(number - 1, 0)], places[min(number + 1, count - 1)]
        aside = _left_normal(before, after) if count > 1 else np.array([0.0, 1.0, 0.0])
        top = place + height_m * _UP
        pieces.tube(place - 0.6 * _UP, top, 0.15, _POLE, end_radius_m=0.10, cap=True)
        arm = top - 0.4 * _UP
        pieces.tube(arm - 0.95 * aside, arm + 0.95 * aside, 0.06, _POLE, corners=4, cap=True)
        ends.append([arm + shift * aside + 0.16 * _UP for shift in (-0.85, 0.3, 0.85)])
        for hook in ends[-1]:
            pieces.tube(hook - 0.14 * _UP, hook, 0.04, _WIRE._replace(colour=(0.30, 0.20, 0.14)), corners=5)
    share = np.linspace(0.0, 1.0, 7)
    for here, there in pairwise(ends):
        for start, end in zip(here, there, strict=True):
            hang = -4.0 * sag_m * share * (1.0 - share)
            points = start + share[:, None] * (end - start) + hang[:, None] * _UP
            for a, b in pairwise(points):
                pieces.tube(a, b, 0.014, _WIRE, corners=3)
    return pieces.model()
