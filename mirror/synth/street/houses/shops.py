"""Ground floors: shops with signs and awnings, entrances of flats, glass lobbies."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.synth.model import Finish, Label, Material, Pieces
from mirror.synth.street.houses.body import FOOT_M, STONE, HouseBody
from mirror.synth.street.houses.styles import Colour
from mirror.synth.street.houses.windows import PATTERNS, Windows
from mirror.synth.textures.catalogue import DOORS, POSTERS, SHOP_SIGNS, SHOP_WINDOWS

_RECESS_M: Final = 0.24
_FASCIA_M: Final = 0.72
_FRAMES: Final[tuple[Colour, ...]] = (
    (0.03, 0.03, 0.035),
    (0.35, 0.36, 0.37),
    (0.05, 0.10, 0.07),
    (0.12, 0.06, 0.04),
    (0.55, 0.54, 0.50),
)
_FASCIAS: Final[tuple[Colour, ...]] = (
    (0.06, 0.06, 0.065),
    (0.25, 0.04, 0.03),
    (0.04, 0.10, 0.07),
    (0.05, 0.08, 0.18),
    (0.45, 0.43, 0.38),
    (0.30, 0.20, 0.09),
)
_AWNINGS: Final[tuple[Colour, ...]] = ((0.32, 0.05, 0.04), (0.06, 0.17, 0.10), (0.48, 0.42, 0.30), (0.07, 0.12, 0.24))


def add_shops(pieces: Pieces, body: HouseBody, rng: np.random.Generator) -> None:
    """Add shops side by side, with the house's entrance between them where there is room."""
    at, right = body.left, body.right
    entrance = right - at > 9.0
    door_at = rng.uniform(0.3, 0.7) * (right - at) + at
    if entrance:
        _add_entrance(pieces, body, rng, door_at - 1.1, door_at + 1.1)
        stretches = [(at, door_at - 1.1), (door_at + 1.1, right)]
    else:
        stretches = [(at, right)]
    for start, end in stretches:
        count = max(round((end - start) / 5.5), 1)
        width = (end - start) / count
        for number in range(count):
            _add_shop(pieces, body, rng, start + number * width, start + (number + 1) * width)


def _add_shop(pieces: Pieces, body: HouseBody, rng: np.random.Generator, left: float, right: float) -> None:
    front, back, high = body.front, body.front + _RECESS_M, body.ground_m
    seed = int(rng.integers(1 << 20))
    frame = _FRAMES[int(rng.integers(len(_FRAMES)))]
    pillar = 0.22
    foot = Finish(STONE, Material.CONCRETE, Label.BUILDING, body.seed)
    pieces.wall((left, front), (right, front), FOOT_M, 0.1, foot)
    pieces.level((left + pillar, front), (right - pillar, back), 0.1, foot)
    for x in (left, right - pillar):
        pieces.block((x, front, 0.1), (x + pillar, back, high), body.plain(0.95), without=("+y", "-z", "+z"))
    fascia_m = high - _FASCIA_M - 0.15
    interior = Finish(frame, Material.SHOPFRONT, Label.BUILDING, seed, image=int(rng.choice(SHOP_WINDOWS)))
    pieces.wall((left + pillar, back), (right - pillar, back), 0.1, fascia_m, interior)
    board = Finish(_FASCIAS[int(rng.integers(len(_FASCIAS)))], Material.PLAIN, Label.BUILDING, seed)
    pieces.block((left + 0.05, front - 0.09, fascia_m), (right - 0.05, back, high - 0.15), board, without=("+y",))
    pieces.wall((left + pillar, front), (right - pillar, front), high - 0.15, high, body.plain())
    width = min(right - left - 0.5, 3.4)
    middle, low = 0.5 * (left + right), fascia_m + 0.5 * (_FASCIA_M - width / 5)
    sign = Finish((0.6, 0.6, 0.6), Material.LIT_IMAGE, Label.BUILDING, image=int(rng.choice(SHOP_SIGNS)))
    pieces.wall((middle - width / 2, front - 0.11), (middle + width / 2, front - 0.11), low, low + width / 5, sign)
    if rng.random() < 0.35:
        _add_awning(pieces, left + 0.25, right - 0.25, front - 0.09, fascia_m + 0.02, rng)
    elif rng.random() < 0.4:
        _add_blade_sign(pieces, left + 0.2, front, fascia_m - 0.05, rng)


def _add_awning(pieces: Pieces, left: float, right: float, wall: float, high: float, rng: np.random.Generator) -> None:
    colour = _AWNINGS[int(rng.integers(len(_AWNINGS)))]
    cloth = Finish(colour, Material.CLOTH, Label.BUILDING, int(rng.integers(1 << 20)), two_sided=True)
    out, low = wall - rng.uniform(0.8, 1.1), high - rng.uniform(0.45, 0.65)
    pieces.face(((left, out, low), (right, out, low), (right, wall, high), (left, wall, high)), cloth)
    pieces.wall((left, out), (right, out), low - 0.2, low, cloth)
    pieces.face(((left, wall, low), (left, out, low), (left, wall, high)), cloth)
    pieces.face(((right, out, low), (right, wall, low), (right, wall, high)), cloth)


def _add_blade_sign(pieces: Pieces, x: float, wall: float, low: float, rng: np.random.Generator) -> None:
    """Add a sign at right angles to the wall, visible from both sides."""
    poster = Finish((0.6, 0.6, 0.6), Material.LIT_IMAGE, Label.BUILDING, image=int(rng.choice(POSTERS)))
    edge = Finish((0.05, 0.05, 0.05), Material.METAL, Label.BUILDING)
    near, far, high = wall - 0.2, wall - 0.75, low + 0.825
    pieces.block((x - 0.05, far, low), (x + 0.05, near, high), edge, without=("-x", "+x"))
    pieces.wall((x + 0.05, far), (x + 0.05, near), low, high, poster)
    pieces.wall((x - 0.05, near), (x - 0.05, far), low, high, poster)


def _add_entrance(pieces: Pieces, body: HouseBody, rng: np.random.Generator, left: float, right: float) -> None:
    """Add a part of the wall with the house's door."""
    front = body.front
    pieces.wall((left, front), (right, front), 0.0, body.ground_m, body.plain())
    pieces.wall((left, front), (right, front), FOOT_M, 0.0, Finish(STONE, Material.CONCRETE, Label.BUILDING, body.seed))
    add_door(pieces, body, 0.5 * (left + right), rng)


def add_door(pieces: Pieces, body: HouseBody, x: float, rng: np.random.Generator) -> None:
    """Add a house door in a projecting portal, and a step."""
    front, proud = body.front, 0.14
    stone = body.plain(1.12)
    high = 2.75
    for a in (x - 0.85, x + 0.57):
        pieces.block((a, front - proud, -0.3), (a + 0.28, front, high), stone, without=("+y", "-z", "+z"))
    pieces.block((x - 0.95, front - proud - 0.06, high), (x + 0.95, front, high + 0.3), stone, without=("+y",))
    door = Finish((0.3, 0.3, 0.3), Material.IMAGE, Label.BUILDING, image=int(rng.choice(DOORS)))
    pieces.wall((x - 0.57, front - 0.03), (x + 0.57, front - 0.03), 0.18, 0.18 + 2.28, door)
    over = Finish((0.05, 0.055, 0.06), Material.GLASS, Label.BUILDING)
    pieces.wall((x - 0.57, front - 0.03), (x + 0.57, front - 0.03), 2.46, high, over)
    step = Finish(STONE, Material.CONCRETE, Label.BUILDING, body.seed)
    pieces.block((x - 0.8, front - 0.4, -0.6), (x + 0.8, front, 0.16), step, without=("+y", "-z"))


def add_flats(pieces: Pieces, body: HouseBody, rng: np.random.Generator) -> None:
    """Add ground-floor windows above a plinth, and a door in its own part of the wall."""
    left, right, front = body.left, body.right, body.front
    plinth = Finish(STONE, Material.CONCRETE, Label.BUILDING, body.seed)
    columns, _ = body.columns()
    door = min(max(columns[int(rng.integers(len(columns)))], left + 1.1), right - 1.1)
    _add_entrance(pieces, body, rng, door - 1.1, door + 1.1)
    for number, (start, end) in enumerate(((left, door - 1.1), (door + 1.1, right))):
        if end - start < 0.01:
            continue
        windowed = end - start > PATTERNS[body.front_windows].width_m + 0.5
        wall = body.finish(body.front_windows, 4 + number) if windowed else body.plain()
        pieces.wall((start, front), (end, front), 0.0, body.ground_m, wall)
        pieces.block((start, front - 0.05, FOOT_M), (end, front, 0.55), plinth, without=("+y", "-z"))


def add_lobby(pieces: Pieces, body: HouseBody, rng: np.random.Generator) -> None:
    """Add a ground floor of glass between pillars, with a porch over the entrance."""
    left, right, front, high = body.left, body.right, body.front, body.ground_m
    glass = Finish((0.10, 0.11, 0.12), Material.FACADE, Label.BUILDING, body.seed + 5, int(Windows.CURTAIN_WALL))
    back = front + 0.6
    stone = Finish(STONE, Material.CONCRETE, Label.BUILDING, body.seed)
    pieces.wall((left, back), (right, back), 0.1, high, glass)
    pieces.face(((left, front, high), (left, back, high), (right, back, high), (right, front, high)), body.plain(0.9))
    pieces.level((left, front), (right, back), 0.1, stone)
    pieces.wall((left, front), (right, front), FOOT_M, 0.1, stone)
    for x, out in ((left, "-x"), (right, "+x")):
        corners = ((x, front), (x, back))
        start, end = corners[::-1] if out == "-x" else corners
        pieces.wall(end, start, 0.1, high, body.plain())
    count = max(int((right - left) / 6.0), 2)
    for number in range(count + 1):
        x = left + 0.3 + (right - left - 0.6) * number / count
        pieces.block(
            (x - 0.25, front + 0.02, 0.1), (x + 0.25, front + 0.4, high), body.plain(1.1), without=("-z", "+z")
        )
    door = left + (right - left) * (round(rng.uniform(0.3, 0.7) * count) + 0.5) / count
    door = min(max(door, left + 2.5), right - 2.5)
    roof = Finish((0.30, 0.31, 0.32), Material.METAL, Label.BUILDING)
    pieces.block((door - 2.2, front - 1.2, high - 0.75), (door + 2.2, front + 0.3, high - 0.5), roof, without=())
    doors = Finish((0.3, 0.3, 0.3), Material.IMAGE, Label.BUILDING, image=int(rng.choice(DOORS)))
    for x in (door - 1.3, door):
        pieces.wall((x, back - 0.04), (x + 1.25, back - 0.04), 0.12, 2.62, doors)
