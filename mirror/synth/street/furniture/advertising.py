"""Furniture that carries advertisements: billboards, columns, bus shelters."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.portable import arrays
from mirror.synth.model import Finish, Label, Material, Model, Pieces
from mirror.synth.street.furniture.lamps import FOOT_M
from mirror.synth.street.furniture.signs import add_sign
from mirror.synth.textures.catalogue import BILLBOARDS, POSTERS, Sign

_TURNS: Final = 4
"""Number of images that a changing billboard shows in turn, one per traversal."""
_STEEL: Final = Finish((0.20, 0.21, 0.21), Material.METAL, Label.POLE)
_FRAME: Final = Finish((0.06, 0.065, 0.07), Material.METAL, Label.BILLBOARD)


def _changing_image(rng: np.random.Generator, numbers: range, label: Label) -> Finish:
    first = int(rng.choice(numbers[: len(numbers) - _TURNS + 1]))
    return Finish((0.6, 0.6, 0.6), Material.LIT_IMAGE, label, image=first, images=_TURNS)


def billboard(rng: np.random.Generator, *, width_m: float = 3.9, low_m: float = 2.4) -> Model:
    """Make a 3:2 board on posts that faces +x; its image changes between traversals.

    Args:
        rng: random generator that chooses the images.
        width_m: width of the image.
        low_m: height of its lower edge; above 4 m the board stands on one thick post.
    """
    pieces = Pieces()
    half, high = 0.5 * width_m, low_m + width_m / 1.5
    if low_m > 4.0:
        pieces.tube((-0.15, 0, FOOT_M), (-0.15, 0, low_m), 0.28, _STEEL, corners=8)
    else:
        for y in (-0.6 * half, 0.6 * half):
            pieces.block((-0.22, y - 0.07, FOOT_M), (-0.08, y + 0.07, low_m + 0.5), _STEEL)
    pieces.block((-0.14, -half - 0.1, low_m - 0.1), (0.05, half + 0.1, high + 0.1), _FRAME, without=())
    pieces.wall((0.06, -half), (0.06, half), low_m, high, _changing_image(rng, BILLBOARDS, Label.BILLBOARD))
    return pieces.model()


def high_billboard(rng: np.random.Generator) -> Model:
    """Make a large board high on a post, as used beside motorways."""
    return billboard(rng, width_m=8.4, low_m=5.5)


def city_light(rng: np.random.Generator) -> Model:
    """Make a poster in an illuminated case, visible from both sides (+x and -x)."""
    pieces = Pieces()
    half, low, high = 0.6, 0.55, 2.35
    pieces.block((-0.08, -0.2, FOOT_M), (0.08, 0.2, low), _FRAME, without=("-z", "+z"))
    pieces.block((-0.1, -half - 0.07, low - 0.08), (0.1, half + 0.07, high + 0.1), _FRAME, without=())
    pieces.wall((0.11, -half), (0.11, half), low, high, _changing_image(rng, POSTERS, Label.BILLBOARD))
    pieces.wall((-0.11, half), (-0.11, -half), low, high, _changing_image(rng, POSTERS, Label.BILLBOARD))
    return pieces.model()


def advertising_column(rng: np.random.Generator) -> Model:
    """Make a round column with posters, a plinth and a cap."""
    pieces = Pieces()
    count, radius = 10, 0.68
    angle = 2.0 * np.pi * np.arange(count) / count
    ring = np.c_[arrays.cos(angle), arrays.sin(angle)]
    stone = Finish((0.34, 0.33, 0.31), Material.CONCRETE, Label.BILLBOARD)
    pieces.prism((radius + 0.06) * ring, FOOT_M, 0.5, stone)
    pieces.prism((radius - 0.003) * ring, 0.5, 3.0, stone._replace(colour=(0.42, 0.43, 0.40)))
    for start in range(0, count, 2):
        # The posters are narrower than the column's sides, so that their edges stay within its corners.
        left, right = (radius * (ring[start] + share * (ring[start + 1] - ring[start])) for share in (0.06, 0.94))
        pieces.wall(tuple(left), tuple(right), 1.2, 1.83, _changing_image(rng, POSTERS, Label.BILLBOARD))
        pieces.wall(tuple(left), tuple(right), 2.0, 2.63, _changing_image(rng, POSTERS, Label.BILLBOARD))
    pieces.prism((radius + 0.14) * ring, 3.0, 3.12, stone, bottom=True)
    roof = Finish((0.07, 0.11, 0.09), Material.METAL, Label.BILLBOARD)
    pieces.tube((0, 0, 3.12), (0, 0, 3.55), radius + 0.1, roof, end_radius_m=0.08, corners=count, cap=True)
    return pieces.model()


def bus_shelter(rng: np.random.Generator) -> Model:
    """Make a bus shelter that is open to +x.

    It has a roof, posts, glass at the back, a bench, a poster and the sign of the stop.
    """
    pieces = Pieces()
    half, back, front, high = 2.0, -0.75, 0.75, 2.45
    steel = Finish((0.10, 0.11, 0.12), Material.METAL, Label.FURNITURE)
    pieces.block((back - 0.1, -half - 0.1, high), (front + 0.1, half + 0.1, high + 0.14), steel, without=())
    for x, y in ((back, -half), (back, 0.0), (back, half), (front, half)):
        pieces.block((x - 0.04, y - 0.04, FOOT_M), (x + 0.04, y + 0.04, high), steel, without=("-z", "+z"))
    glass = Finish((0.14, 0.17, 0.17), Material.GLASS, Label.FURNITURE, two_sided=True)
    for left, right in ((-half + 0.05, -0.05), (0.05, half - 0.05)):
        pieces.wall((back, left), (back, right), 0.25, 2.2, glass)
    low, top = 0.5, 2.0
    pieces.block((-0.55, half - 0.07, low - 0.1), (0.55, half + 0.07, top + 0.1), steel, without=())
    pieces.wall((-0.5, half - 0.08), (0.5, half - 0.08), low, top, _changing_image(rng, POSTERS, Label.BILLBOARD))
    pieces.wall((0.5, half + 0.08), (-0.5, half + 0.08), low, top, _changing_image(rng, POSTERS, Label.BILLBOARD))
    wood = Finish((0.22, 0.13, 0.07), Material.WOOD, Label.FURNITURE)
    pieces.block((back + 0.15, -1.5, 0.42), (back + 0.55, 0.9, 0.47), wood, without=())
    for y in (-1.2, 0.6):
        pieces.block((back + 0.3, y - 0.03, -0.2), (back + 0.4, y + 0.03, 0.42), steel, without=("-z", "+z"))
    pole = Pieces()
    pole.tube((0, 0, FOOT_M), (0, 0, 2.9), 0.04, _STEEL, cap=True)
    add_sign(pole, Sign.BUS_STOP, 2.6, 0.28)
    pieces.add(pole.model().place(front - 0.1, -half - 0.8, 0.0, -0.5 * np.pi))
    return pieces.model()
