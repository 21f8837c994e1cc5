"""Small furniture on pavements: seats, bins, boxes, bollards, tables, road works."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Final

import numpy as np

from mirror.portable import arrays
from mirror.synth.model import Finish, Label, Material, Model, Pieces, ellipsoid
from mirror.synth.street.furniture.lamps import FOOT_M
from mirror.synth.textures.catalogue import POSTERS

Maker = Callable[[np.random.Generator], Model]

_WOOD: Final = Finish((0.25, 0.15, 0.08), Material.WOOD, Label.FURNITURE)
_IRON: Final = Finish((0.05, 0.055, 0.055), Material.METAL, Label.FURNITURE)
_GREY: Final = Finish((0.28, 0.30, 0.29), Material.METAL, Label.FURNITURE)
_WHITE: Final = Finish((0.62, 0.62, 0.60), Material.PLAIN, Label.FURNITURE)
_RED: Final = Finish((0.48, 0.04, 0.03), Material.PLAIN, Label.FURNITURE)


def _ring(count: int, radius_m: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    angle = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    return np.c_[radius_m * arrays.cos(angle), radius_m * arrays.sin(angle)]


def bench(rng: np.random.Generator) -> Model:
    """Make a bench that faces +x."""
    pieces = Pieces()
    half = rng.uniform(0.8, 1.0)
    for x in (-0.02, 0.16):
        pieces.block((x - 0.12, -half, 0.42), (x + 0.03, half, 0.46), _WOOD, without=())
    for z in (0.58, 0.74):
        pieces.block((-0.22, -half, z), (-0.18, half, z + 0.11), _WOOD, without=())
    for y in (-0.75 * half, 0.75 * half):
        pieces.block((-0.18, y - 0.03, -0.2), (0.18, y + 0.03, 0.42), _IRON, without=("-z", "+z"))
        pieces.block((-0.24, y - 0.03, 0.2), (-0.17, y + 0.03, 0.85), _IRON, without=("-z",))
    return pieces.model()


def bin_(rng: np.random.Generator) -> Model:
    """Make a litter bin."""
    pieces = Pieces()
    colour = ((0.05, 0.055, 0.055), (0.05, 0.13, 0.08), (0.55, 0.20, 0.03), (0.25, 0.26, 0.26))[int(rng.integers(4))]
    coat = Finish(colour, Material.METAL, Label.FURNITURE)
    pieces.prism(_ring(8, 0.21), -0.2, 0.72, coat, top=_IRON)
    pieces.prism(_ring(8, 0.23), 0.86, 0.91, coat, bottom=True)
    for x, y in _ring(8, 0.19)[::4]:
        pieces.block((x - 0.02, y - 0.02, 0.72), (x + 0.02, y + 0.02, 0.86), coat, without=("-z", "+z"))
    return pieces.model()


def bollards(rng: np.random.Generator) -> Model:
    """Make a row of bollards along y."""
    pieces = Pieces()
    steel = _IRON if rng.random() < 0.6 else _GREY
    for y in (-1.5, 0.0, 1.5):
        pieces.tube((0, y, -0.3), (0, y, 0.92), 0.055, steel, cap=True)
        pieces.tube((0, y, 0.74), (0, y, 0.82), 0.058, _WHITE)
    return pieces.model()


def hydrant(rng: np.random.Generator) -> Model:
    """Make a fire hydrant."""
    pieces = Pieces()
    colour = ((0.50, 0.05, 0.03), (0.06, 0.12, 0.30), (0.52, 0.36, 0.04))[int(rng.integers(3))]
    coat = Finish(colour, Material.METAL, Label.FURNITURE)
    pieces.tube((0, 0, -0.3), (0, 0, 0.62), 0.10, coat, corners=8)
    pieces.prism(_ring(8, 0.13), 0.62, 0.68, coat, bottom=True)
    pieces.tube((0, 0, 0.68), (0, 0, 0.82), 0.11, coat, end_radius_m=0.03, corners=8, cap=True)
    for end in (-0.2, 0.2):
        pieces.tube((0, 0, 0.45), (0, end, 0.45), 0.05, coat, cap=True)
    return pieces.model()


def post_box(rng: np.random.Generator) -> Model:
    """Make a post box that faces +x."""
    pieces = Pieces()
    colour = ((0.55, 0.38, 0.02), (0.45, 0.03, 0.02), (0.05, 0.12, 0.32))[int(rng.integers(3))]
    coat = Finish(colour, Material.PAINT, Label.FURNITURE)
    pieces.block((-0.16, -0.22, 0.62), (0.16, 0.22, 1.32), coat, without=())
    pieces.block((-0.06, -0.10, -0.3), (0.06, 0.10, 0.62), _GREY, without=("-z", "+z"))
    pieces.block((0.155, -0.16, 1.14), (0.185, 0.16, 1.19), _IRON, without=("-x",))
    label = Finish((0.6, 0.6, 0.58), Material.PLAIN, Label.FURNITURE)
    pieces.wall((0.165, -0.10), (0.165, 0.10), 0.8, 1.02, label)
    return pieces.model()


def electrical_box(rng: np.random.Generator) -> Model:
    """Make a grey cabinet, on some of which posters are stuck."""
    pieces = Pieces()
    half, high = rng.uniform(0.35, 0.7), rng.uniform(1.05, 1.4)
    coat = Finish((0.36, 0.38, 0.36), Material.METAL, Label.FURNITURE, int(rng.integers(1 << 20)))
    pieces.block((-0.18, -half, 0.1), (0.18, half, high), coat)
    pieces.block(
        (-0.16, -half + 0.03, -0.3), (0.16, half - 0.03, 0.1), Finish((0.25,) * 3, Material.CONCRETE, Label.FURNITURE)
    )
    pieces.block((-0.21, -half - 0.03, high), (0.21, half + 0.03, high + 0.05), coat, without=())
    if rng.random() < 0.5:
        paper = Finish((0.5,) * 3, Material.IMAGE, Label.FURNITURE, image=int(rng.choice(POSTERS)))
        pieces.wall((0.19, -0.2), (0.19, 0.2), 0.45, 1.05 - 1e-3 if high < 1.1 else 1.05, paper)
    return pieces.model()


def bicycle_stands(rng: np.random.Generator) -> Model:
    """Make the steel hoops side by side along y."""
    pieces = Pieces()
    for y in np.arange(int(rng.integers(2, 5))) * 0.9:
        ends = (-0.35, y, -0.2), (-0.35, y, 0.8), (0.35, y, 0.8), (0.35, y, -0.2)
        for start, end in pairwise(ends):
            pieces.tube(start, end, 0.025, _GREY._replace(two_sided=True), corners=5)
    return pieces.model()


def cafe_table(rng: np.random.Generator) -> Model:
    """Make a small table with chairs, some under a parasol."""
    pieces = Pieces()
    pieces.prism(_ring(10, 0.34), 0.72, 0.75, _WOOD if rng.random() < 0.5 else _GREY, bottom=True)
    pieces.tube((0, 0, -0.2), (0, 0, 0.72), 0.035, _IRON)
    colour = ((0.30, 0.05, 0.04), (0.05, 0.05, 0.055), (0.40, 0.32, 0.18))[int(rng.integers(3))]
    seat = Finish(colour, Material.WOOD, Label.FURNITURE)
    for way in (-1.0, 1.0):
        near, far = sorted((0.45 * way, 0.85 * way))
        pieces.block((-0.2, near, 0.43), (0.2, far, 0.47), seat, without=())
        back = 0.85 * way
        pieces.block((-0.2, back - 0.02, 0.55), (0.2, back + 0.02, 0.88), seat, without=())
        for x in (-0.17, 0.17):
            for y in (near + 0.03, far - 0.03):
                pieces.tube((x, y, -0.2), (x, y, 0.43), 0.016, _IRON, corners=3)
            pieces.tube((x, back, 0.43), (x, back, 0.86), 0.016, _IRON, corners=3)
    if rng.random() < 0.4:
        cloth = Finish(
            (0.50, 0.46, 0.38) if rng.random() < 0.5 else (0.34, 0.06, 0.05), Material.CLOTH, Label.FURNITURE
        )
        pieces.tube((0, 0, 0.75), (0, 0, 2.5), 0.025, _WOOD, corners=5)
        cloth = cloth._replace(two_sided=True)
        pieces.tube((0, 0, 2.15), (0, 0, 2.6), 1.1, cloth, end_radius_m=0.03, corners=8)
    return pieces.model()


def planter(rng: np.random.Generator) -> Model:
    """Make a tub with a plant."""
    pieces = Pieces()
    tub = Finish((0.36, 0.35, 0.33), Material.CONCRETE, Label.FURNITURE)
    half = rng.uniform(0.35, 0.6)
    pieces.block((-0.35, -half, -0.3), (0.35, half, 0.5), tub)
    soil = Finish((0.04, 0.03, 0.02), Material.GRAVEL, Label.FURNITURE)
    pieces.level((-0.3, -half + 0.05), (0.3, half - 0.05), 0.505, soil)
    green = (0.05, 0.10, 0.03) if rng.random() < 0.6 else (0.10, 0.11, 0.03)
    for y in np.linspace(-0.6, 0.6, 3) * half:
        size = [float(rng.uniform(0.4, 0.6)) for _ in range(3)]
        pieces.add(
            ellipsoid(
                (0.0, float(y), 0.62), size, green, Material.LEAVES, Label.VEGETATION, seed=int(rng.integers(1 << 20))
            )
        )
    return pieces.model()


def recycling_bank(rng: np.random.Generator) -> Model:
    """Make the containers for glass and paper, side by side along y."""
    pieces = Pieces()
    colours = ((0.05, 0.15, 0.08), (0.06, 0.12, 0.26), (0.45, 0.42, 0.36))
    for number, colour in enumerate(colours[: int(rng.integers(2, 4))]):
        y = 1.6 * number
        coat = Finish(colour, Material.METAL, Label.FURNITURE, number)
        pieces.block((-0.6, y - 0.7, 0.08), (0.6, y + 0.7, 1.25), coat)
        top = [(-0.6, y - 0.7), (0.6, y - 0.7), (0.6, y + 0.7), (-0.6, y + 0.7)]
        lid = [(-0.3, y - 0.5), (0.3, y - 0.5), (0.3, y + 0.5), (-0.3, y + 0.5)]
        for k in range(4):
            j = (k + 1) % 4
            pieces.face(((*top[k], 1.25), (*top[j], 1.25), (*lid[j], 1.65), (*lid[k], 1.65)), coat)
        pieces.face([(*corner, 1.65) for corner in lid], coat)
        pieces.block((-0.55, y - 0.65, -0.3), (0.55, y + 0.65, 0.08), _IRON, without=("-z", "+z"))
    return pieces.model()


def works_barrier(rng: np.random.Generator) -> Model:
    """Make the red and white barrier boards on feet, as around road works."""
    pieces = Pieces()
    count, width = 5, 0.44
    for number in range(int(rng.integers(1, 3))):
        start = 2.3 * number - 1.1
        for z in (0.45, 0.92):
            low, high = (-0.02, start, z), (0.02, start + count * width, z + 0.2)
            pieces.block(low, high, _WHITE, without=("-x", "+x"))
            for stripe in range(count):
                left = start + stripe * width
                coat = _RED if stripe % 2 == 0 else _WHITE
                pieces.wall((0.02, left), (0.02, left + width), z, z + 0.2, coat)
                pieces.wall((-0.02, left + width), (-0.02, left), z, z + 0.2, coat)
        for y in (start + 0.15, start + count * width - 0.15):
            pieces.block((-0.02, y - 0.03, 0.0), (0.02, y + 0.03, 1.15), _WHITE, without=("-z",))
            pieces.block((-0.35, y - 0.09, -0.1), (0.35, y + 0.09, 0.1), _IRON)
    return pieces.model()


def cones(rng: np.random.Generator) -> Model:
    """Make a few traffic cones."""
    pieces = Pieces()
    orange = Finish((0.60, 0.12, 0.02), Material.PLAIN, Label.FURNITURE)
    for number in range(int(rng.integers(2, 5))):
        x, y = rng.uniform(-0.15, 0.15), 1.3 * number
        pieces.block((x - 0.18, y - 0.18, -0.05), (x + 0.18, y + 0.18, 0.04), orange)
        pieces.tube((x, y, 0.04), (x, y, 0.3), 0.13, orange, end_radius_m=0.095, corners=8)
        pieces.tube((x, y, 0.3), (x, y, 0.45), 0.095, _WHITE, end_radius_m=0.068, corners=8)
        pieces.tube((x, y, 0.45), (x, y, 0.7), 0.068, orange, end_radius_m=0.025, corners=8, cap=True)
    return pieces.model()


def parking_meter(rng: np.random.Generator) -> Model:
    """Make a ticket machine that faces +x."""
    pieces = Pieces()
    coat = Finish((0.10, 0.14, 0.22) if rng.random() < 0.5 else (0.20, 0.21, 0.21), Material.METAL, Label.FURNITURE)
    pieces.block((-0.12, -0.16, FOOT_M), (0.12, 0.16, 1.55), coat)
    pieces.block((-0.14, -0.18, 1.55), (0.14, 0.18, 1.60), _GREY, without=())
    screen = Finish((0.03, 0.05, 0.04), Material.GLASS, Label.FURNITURE)
    pieces.wall((0.125, -0.10), (0.125, 0.10), 1.22, 1.38, screen)
    blue = Finish((0.03, 0.09, 0.36), Material.PLAIN, Label.FURNITURE)
    pieces.block((-0.02, -0.15, 1.60), (0.02, 0.15, 1.9), blue, without=())
    return pieces.model()


PAVEMENT: Final[tuple[Maker, ...]] = (
    bench, bin_, bollards, hydrant, post_box, electrical_box, bicycle_stands, planter, parking_meter, recycling_bank,
    works_barrier, cones,
)  # fmt: skip
"""Builders of furniture at the kerb of a town's pavement."""
PARK: Final[tuple[Maker, ...]] = (bench, bin_, bicycle_stands, planter, bollards, cafe_table)
"""Builders of furniture on a campus."""
ROADSIDE: Final[tuple[Maker, ...]] = (electrical_box, cones, works_barrier)
"""Builders of furniture beside a road through fields."""
