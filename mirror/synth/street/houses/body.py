"""The body of a house: its outline and its walls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.synth.model import Finish, Label, Material, Pieces
from mirror.synth.street.houses.styles import Colour
from mirror.synth.street.houses.windows import Windows, window_grid
from mirror.synth.textures.catalogue import BILLBOARDS, GRAFFITI, POSTERS

FOOT_M: Final = -1.5
"""Lower end of the walls, below the ground because the ground slopes."""
STONE: Final[Colour] = (0.30, 0.29, 0.27)


@dataclass(frozen=True)
class HouseBody:
    """The walls of a house, in its own frame: the street is towards -y, the ground at z = 0.

    Attributes:
        left: smallest x, metres.
        right: largest x.
        front: smallest y.
        back: largest y.
        ground_m: height of the first upper floor.
        eaves_m: height of the walls.
        colour: reflectance (r, g, b) of the walls.
        wall: material of walls without windows.
        front_windows: windows of the wall towards the street.
        side_windows: windows of the other walls.
        seed: seed of the textures.
    """

    left: float
    right: float
    front: float
    back: float
    ground_m: float
    eaves_m: float
    colour: Colour
    wall: Material
    front_windows: Windows
    side_windows: Windows
    seed: int

    def finish(self, windows: Windows, number: int = 0) -> Finish:
        """Return the finish of a wall with windows."""
        return Finish(self.colour, Material.FACADE, Label.BUILDING, self.seed + number, int(windows))

    def plain(self, tone: float = 1.0, material: Material | None = None) -> Finish:
        """Return the finish of a wall without windows, with its colour scaled by ``tone``."""
        colour = tuple(min(tone * channel, 0.8) for channel in self.colour)
        return Finish(colour, self.wall if material is None else material, Label.BUILDING, self.seed)

    def columns(self) -> tuple[list[float], int]:
        """Return the positions x of the front's window columns above the ground floor, and the number of storeys."""
        columns, storeys = window_grid(self.front_windows, self.right - self.left, self.eaves_m - self.ground_m)
        pitch = (self.right - self.left) / columns
        return [self.left + (number + 0.5) * pitch for number in range(columns)], storeys

    def floor_m(self, storey: int) -> float:
        """Return the height of an upper storey's floor."""
        return self.ground_m + storey * (self.eaves_m - self.ground_m) / self.columns()[1]


def raise_walls(pieces: Pieces, body: HouseBody, rng: np.random.Generator, *, sides_seen: bool) -> None:
    """Add the upper storeys of the front, the other walls from the ground up, and the walls below the ground.

    Args:
        pieces: the faces to add to.
        body: body of the house.
        rng: random generator that chooses paintings on blind walls.
        sides_seen: whether the side walls have windows; otherwise they are fire walls towards the neighbours.
    """
    left, right, front, back = body.left, body.right, body.front, body.back
    if body.eaves_m > body.ground_m:
        pieces.wall((left, front), (right, front), body.ground_m, body.eaves_m, body.finish(body.front_windows))
    pieces.wall((right, back), (left, back), 0.0, body.eaves_m, body.finish(body.side_windows, 1))
    for number, (start, end) in enumerate((((right, front), (right, back)), ((left, back), (left, front)))):
        if sides_seen:
            pieces.wall(start, end, 0.0, body.eaves_m, body.finish(body.side_windows, 2 + number))
            continue
        pieces.wall(start, end, 0.0, body.eaves_m, body.plain(0.9))
        if rng.random() < 0.4:
            _add_painting(pieces, start, end, rng)
    foot = Finish(STONE, Material.CONCRETE, Label.BUILDING, body.seed)
    low, high = (left, front, FOOT_M), (right, back, 0.0)
    pieces.block(low, high, foot, without=("-y", "+z", "-z"))


def _add_painting(
    pieces: Pieces, start: tuple[float, float], end: tuple[float, float], rng: np.random.Generator
) -> None:
    """Add graffiti, posters or a billboard to a side wall, near the street."""
    x, ahead = start[0], 1.0 if end[1] > start[1] else -1.0
    out = x + 0.02 * ahead
    near = min(start[1], end[1]) + rng.uniform(0.4, 1.5)
    low, material, turns = rng.uniform(0.5, 0.8), Material.IMAGE, 1
    kind = rng.random()
    if kind < 0.4:
        numbers, width, height, count = GRAFFITI, 3.0, 1.5, 1
    elif kind < 0.65:
        numbers, width, height, count = POSTERS, 1.0, 1.5, 3
    else:
        # The billboard's image changes between traversals.
        turns, low, material = 4, rng.uniform(2.8, 3.6), Material.LIT_IMAGE
        numbers, width, height, count = BILLBOARDS[: len(BILLBOARDS) - turns + 1], 5.4, 3.6, 1
    for number in range(count):
        a = near + number * (width + 0.12)
        ends = ((out, a), (out, a + width)) if ahead > 0 else ((out, a + width), (out, a))
        label = Label.BUILDING if turns == 1 else Label.BILLBOARD
        sheet = Finish((0.5, 0.5, 0.5), material, label, image=int(rng.choice(numbers)), images=turns)
        pieces.wall(*ends, low, low + height, sheet)


def add_cornice(pieces: Pieces, body: HouseBody, proud_m: float = 0.35, high_m: float = 0.35) -> None:
    """Add a ledge along the top of the front."""
    low = (body.left, body.front - proud_m, body.eaves_m - high_m)
    pieces.block(low, (body.right, body.front, body.eaves_m), body.plain(1.15), without=("+y",))
    low = (body.left, body.front - 0.5 * proud_m, body.eaves_m - 1.7 * high_m)
    pieces.block(low, (body.right, body.front, body.eaves_m - high_m), body.plain(1.1), without=("+y", "+z"))
