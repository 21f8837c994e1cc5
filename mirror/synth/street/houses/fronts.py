"""Parts that project from a front above the ground floor: balconies and bay windows."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from mirror.synth.model import Finish, Label, Material, Pieces
from mirror.synth.street.houses.body import HouseBody
from mirror.synth.street.houses.styles import Colour
from mirror.synth.street.houses.windows import Windows

_RAILINGS: Final[tuple[tuple[Colour, Material], ...]] = (
    ((0.05, 0.05, 0.055), Material.METAL),
    ((0.30, 0.31, 0.32), Material.METAL),
    ((0.55, 0.54, 0.51), Material.PLASTER),
    ((0.16, 0.22, 0.23), Material.GLASS),
)
_PAINTED: Final[Colour] = (0.52, 0.49, 0.43)
_PLASTERED: Final = {
    Windows.TALL_BRICK: Windows.TALL,
    Windows.SASH_BRICK: Windows.SASH,
    Windows.MODERN_BRICK: Windows.MODERN,
    Windows.LOFT: Windows.SASH,
}


def add_balconies(pieces: Pieces, body: HouseBody, rng: np.random.Generator, taken: set[int], most: int = 7) -> None:
    """Add balconies one above the other at some columns of windows.

    Args:
        pieces: the faces to add to.
        body: body of the house.
        rng: random generator that chooses the columns and the railings.
        taken: indices of columns in use; columns that get balconies are added.
        most: largest number of balconies.
    """
    columns, storeys = body.columns()
    free = [number for number in range(len(columns)) if number not in taken]
    if not free:
        return
    every = 2 if len(columns) > 3 else 1
    chosen = free[int(rng.integers(every)) :: every][: max(most // storeys, 1)]
    colour, material = _RAILINGS[int(rng.integers(len(_RAILINGS)))]
    pitch = (body.right - body.left) / len(columns)
    half, depth = 0.5 * min(pitch * rng.uniform(0.8, 0.98), 3.2), rng.uniform(0.8, 1.15)
    railing = Finish(colour, material, Label.BUILDING, body.seed, two_sided=True)
    slab = Finish((0.42, 0.41, 0.39), Material.CONCRETE, Label.BUILDING, body.seed)
    first = 0 if body.ground_m > 3.5 else 1
    for column in chosen:
        taken.add(column)
        for storey in range(first, storeys):
            add_balcony(pieces, columns[column], body.front, body.floor_m(storey), half, depth, slab, railing)


def add_balcony(
    pieces: Pieces, x: float, y: float, floor_m: float, half_m: float, deep_m: float, slab: Finish, railing: Finish
) -> None:
    """Add a slab with a railing on three sides.

    Args:
        pieces: the faces to add to.
        x: middle of the balcony, metres.
        y: y of the wall.
        floor_m: height of the slab's top.
        half_m: half the width.
        deep_m: depth from the wall.
        slab: finish of the slab.
        railing: finish of the railing; both of its sides are visible.
    """
    left, right, front = x - half_m, x + half_m, y - deep_m
    pieces.block((left, front, floor_m - 0.16), (right, y, floor_m), slab, without=("+y",))
    foot, head = floor_m + 0.08, floor_m + 1.02
    rim = front + 0.04
    pieces.wall((left + 0.04, rim), (right - 0.04, rim), foot, head, railing)
    pieces.wall((left + 0.04, y), (left + 0.04, rim), foot, head, railing)
    pieces.wall((right - 0.04, rim), (right - 0.04, y), foot, head, railing)
    rail = railing._replace(colour=(0.09, 0.09, 0.09), material=Material.METAL)
    pieces.block(
        (left + 0.02, rim - 0.03, head), (right - 0.02, rim + 0.03, head + 0.05), rail, without=("-x", "+x", "+y", "-z")
    )


def add_bay(pieces: Pieces, body: HouseBody, x: float, half_m: float, *, chamfered: bool) -> None:
    """Add a bay window over all upper storeys except the top one, with a foot and its own roof.

    Args:
        pieces: the faces to add to.
        body: body of the house.
        x: middle of the bay window.
        half_m: half its width along the wall.
        chamfered: whether its sides are turned towards the street.
    """
    storeys = body.columns()[1]
    low, high = body.ground_m + 0.1, body.floor_m(max(storeys - 1, 1)) + 0.25
    depth = 0.85
    inner = half_m - (0.8 if chamfered else 0.0)
    wall, front = body.front, body.front - depth
    corners = [(x - half_m, wall), (x - inner, front), (x + inner, front), (x + half_m, wall)]
    if body.wall == Material.BRICK:
        # A brick bay in front of a brick wall would hardly be visible from the front.
        body = replace(body, colour=_PAINTED, wall=Material.PLASTER)
    front_windows = _PLASTERED.get(body.front_windows, body.front_windows)
    side = Windows.SIDE if chamfered else Windows.BLIND
    for number, windows in enumerate((side, front_windows, side)):
        pieces.wall(corners[number], corners[number + 1], low, high, body.finish(windows, 7 + number))
    foot = body.plain(0.95)
    pieces.face([(a, b, low) for a, b in reversed(corners)], foot)
    roof = Finish((0.12, 0.13, 0.13), Material.METAL, Label.BUILDING, body.seed)
    eaves, ridge = (
        [(a, b, high) for a, b in corners],
        [(x - half_m + 0.3, wall, high + 0.5), (x + half_m - 0.3, wall, high + 0.5)],
    )
    pieces.face([eaves[0], eaves[1], ridge[0]], roof)
    pieces.face([eaves[1], eaves[2], ridge[1], ridge[0]], roof)
    pieces.face([eaves[2], eaves[3], ridge[1]], roof)
