"""The skyline: distant blocks of houses, woods and hills on all sides, so that streets do not end at the horizon."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from mirror.arrays import Float64
from mirror.portable import scalars
from mirror.synth.model import Finish, Label, Material, Model, Pieces
from mirror.synth.street.houses.windows import Windows

Height = Callable[[float, float], Float64]
"""Height of the ground at (x, y), metres."""


def build_far_houses(
    rng: np.random.Generator, near_m: float, far_m: float, tall_m: tuple[float, float], height_m: Height
) -> Model:
    """Build a ring of house blocks around the origin, in two rows, with the higher blocks in the outer row.

    Args:
        rng: random generator.
        near_m: distance of the nearest fronts.
        far_m: distance of the farthest fronts.
        tall_m: smallest and largest height.
        height_m: height of the ground.
    """
    pieces = Pieces()
    for row, (distance, most) in enumerate(((near_m, 0.5), (0.5 * (near_m + far_m), 1.0))):
        bearing = rng.uniform(0.0, 0.2)
        while bearing < 2.0 * math.pi:
            wide = rng.uniform(18.0, 36.0)
            at = distance + rng.uniform(0.0, 0.5 * (far_m - near_m) - 12.0)
            tall = rng.uniform(tall_m[0], tall_m[0] + most * (tall_m[1] - tall_m[0]))
            tone = rng.uniform(0.75, 1.1)
            base = ((0.46, 0.43, 0.38), (0.33, 0.22, 0.17), (0.40, 0.41, 0.42), (0.50, 0.48, 0.45))[
                int(rng.integers(4))
            ]
            colour = tone * base[0], tone * base[1], tone * base[2]
            wall = Finish(colour, Material.FACADE, Label.BUILDING, int(rng.integers(1 << 20)), int(Windows.FAR))
            block = Pieces()
            roof = Finish((0.14, 0.10, 0.09) if rng.random() < 0.5 else (0.12,) * 3, Material.ROOF, Label.BUILDING)
            half, deep, foot = 0.5 * wide, 12.0, -12.0
            # The front faces the origin, which is towards the block's own -x.
            block.wall((0.0, half), (0.0, -half), foot, tall, wall)
            block.wall((0.0, -half), (deep, -half), foot, tall, wall)
            block.wall((deep, half), (0.0, half), foot, tall, wall)
            if row == 0 and rng.random() < 0.6:
                rise = rng.uniform(3.0, 5.0)
                ridge = 0.5 * deep
                block.face(
                    ((-0.3, half, tall), (-0.3, -half, tall), (ridge, -half, tall + rise), (ridge, half, tall + rise)),
                    roof,
                )
                for y in (-half, half):
                    gable = [(0.0, y, tall), (deep, y, tall), (ridge, y, tall + rise)]
                    block.face(gable if y < 0 else gable[::-1], wall._replace(material=Material.PLASTER))
            x, y = at * scalars.cos(bearing), at * scalars.sin(bearing)
            pieces.add(block.model().place(x, y, float(height_m(x, y)), bearing))
            bearing += (wide + rng.uniform(0.0, 6.0)) / at
    return pieces.model()


def build_far_woods(
    rng: np.random.Generator, near_m: float, far_m: float, tall_m: tuple[float, float], height_m: Height
) -> Model:
    """Build rings of trees around the origin as upright outlines that face inwards, paler with distance.

    Args:
        rng: random generator.
        near_m: distance of the nearest ring.
        far_m: distance of the farthest ring, which stands on hills.
        tall_m: smallest and largest height of the trees.
        height_m: height of the ground.
    """
    pieces = Pieces()
    rings = 3
    for ring in range(rings):
        distance = near_m + (far_m - near_m) * ring / (rings - 1)
        hill = 0.0 if ring == 0 else rng.uniform(8.0, 16.0) * ring
        phase = rng.uniform(0.0, 2.0 * math.pi, 3)
        pale = 0.45 * ring / (rings - 1)
        count = int(2.0 * math.pi * distance / (7.0 + 3.0 * ring))
        for number in range(count):
            bearing = 2.0 * math.pi * (number + rng.uniform(-0.3, 0.3)) / count
            swell = sum(scalars.sin(k * bearing + phase[k - 1]) / k for k in (1, 2, 3))
            foot = max(hill * (0.6 + 0.4 * swell), 0.0)
            tall, half = foot + rng.uniform(*tall_m), rng.uniform(0.62, 0.85) * 2.0 * math.pi * distance / count
            at = distance + rng.uniform(-3.0, 3.0)
            green = np.array([0.045, 0.075, 0.030]) * rng.uniform(0.75, 1.25)
            colour = tuple(green + pale * (np.array([0.10, 0.13, 0.15]) - green))
            finish = Finish(colour, Material.SKYLINE, Label.VEGETATION, int(rng.integers(1 << 20)))
            high = tall - foot
            outline = (
                (1.0, -12.0), (1.0, foot + 0.45 * high), (0.72, foot + 0.8 * high), (0.25, tall),
                (-0.25, tall - 0.02 * high), (-0.75, foot + 0.76 * high), (-1.0, foot + 0.4 * high), (-1.0, -12.0),
            )  # fmt: skip
            cos, sin = scalars.cos(bearing), scalars.sin(bearing)
            ground = float(height_m(at * cos, at * sin))
            corners = [(at * cos + y * half * sin, at * sin - y * half * cos, ground + z) for y, z in outline]
            pieces.face(corners[-1:] + corners[:-1], finish)
    return pieces.model()
