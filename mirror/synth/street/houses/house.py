"""Builds a house of a given style on a lot."""

from __future__ import annotations

import numpy as np

from mirror.synth.model import Material, Model, Pieces
from mirror.synth.street.houses.body import FOOT_M, HouseBody, add_cornice, raise_walls
from mirror.synth.street.houses.fronts import add_balconies, add_bay
from mirror.synth.street.houses.roofs import add_roof
from mirror.synth.street.houses.sheds import build_farm, build_petrol_station, build_warehouse
from mirror.synth.street.houses.shops import add_flats, add_lobby, add_shops
from mirror.synth.street.houses.styles import BRICKS, STYLES, HouseStyle, Style
from mirror.synth.street.houses.windows import PATTERNS, Windows
from mirror.synth.textures.catalogue import Grain


def build_house(
    rng: np.random.Generator,
    style: HouseStyle,
    length_m: float,
    depth_m: float,
    *,
    corner: bool = False,
    detailed: bool = True,
) -> Model:
    """Build a house: the middle of the lot's front edge is the origin, the street towards -y, the ground at z = 0.

    The walls stand within the lot; balconies, awnings and eaves reach up to 1.3 m beyond its edges.

    Args:
        rng: random generator.
        style: style of the house.
        length_m: length of the lot along x, at least 5.
        depth_m: depth of the lot along y, at least 8.
        corner: whether the sides of a row house are visible and so have windows.
        detailed: whether the house is visible from nearby; otherwise it has no shops, doors and balconies.
    """
    if style == "farm":
        return build_farm(rng, length_m, depth_m)
    if style == "warehouse":
        return build_warehouse(rng, length_m, depth_m)
    if style == "station":
        return build_petrol_station(rng, length_m, depth_m)
    kind = STYLES[style]
    body = _draw_body(rng, kind, length_m, depth_m)
    pieces = Pieces()
    raise_walls(pieces, body, rng, sides_seen=corner or kind.free)
    if detailed:
        ground = kind.ground[int(rng.integers(len(kind.ground)))]
        {"shops": add_shops, "flats": add_flats, "lobby": add_lobby}[ground](pieces, body, rng)
        _add_front(pieces, body, kind, rng)
        if kind.cornice:
            add_cornice(pieces, body)
    else:
        pieces.wall((body.left, body.front), (body.right, body.front), FOOT_M, 0.0, body.plain(0.8))
        pieces.wall(
            (body.left, body.front), (body.right, body.front), 0.0, body.ground_m, body.finish(body.front_windows)
        )
    add_roof(pieces, body, kind.roofs[int(rng.integers(len(kind.roofs)))], rng)
    return pieces.model()


def _draw_body(rng: np.random.Generator, style: Style, length_m: float, depth_m: float) -> HouseBody:
    front = min(rng.uniform(*style.set_back_m), max(depth_m - style.depth_m[0], 0.0))
    back = min(front + rng.uniform(*style.depth_m), depth_m)
    half = 0.5 * length_m - (rng.uniform(0.8, 2.5) if style.free else 0.0)
    windows = style.fronts[int(rng.integers(len(style.fronts)))]
    brick = PATTERNS[windows].grain == Grain.BRICK
    colours = BRICKS if brick else style.colours
    colour = colours[int(rng.integers(len(colours)))]
    tint = rng.uniform(0.88, 1.08)
    storeys = int(rng.integers(style.storeys[0], style.storeys[1] + 1))
    sides = style.sides
    if brick and sides == Windows.SIDE:
        sides = Windows.SIDE_BRICK
    if brick and sides == Windows.COTTAGE:
        sides = Windows.COTTAGE_BRICK
    return HouseBody(
        -half,
        half,
        front,
        back,
        style.ground_m,
        style.ground_m + storeys * PATTERNS[windows].storey_m,
        (tint * colour[0], tint * colour[1], tint * colour[2]),
        Material.BRICK if brick else style.wall,
        windows,
        sides,
        int(rng.integers(1 << 20)),
    )


def _add_front(pieces: Pieces, body: HouseBody, style: Style, rng: np.random.Generator) -> None:
    """Add bay windows and balconies."""
    columns, storeys = body.columns()
    taken: set[int] = set()
    if body.eaves_m <= body.ground_m:
        return
    if storeys >= 2 and len(columns) >= 4 and rng.random() < style.bays:
        column = int(rng.integers(1, len(columns) - 1))
        chamfered = bool(rng.random() < 0.6)
        add_bay(pieces, body, columns[column], 1.9 if chamfered else 1.25, chamfered=chamfered)
        taken |= {column - 1, column, column + 1}
    if rng.random() < style.balconies:
        add_balconies(pieces, body, rng, taken)
