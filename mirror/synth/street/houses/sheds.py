"""Buildings without storeys: farms, warehouses, petrol stations."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.portable import arrays
from mirror.synth.model import Finish, Label, Material, Model, Pieces
from mirror.synth.street.houses.body import FOOT_M, STONE
from mirror.synth.street.houses.styles import TILES, Colour
from mirror.synth.street.houses.windows import Windows
from mirror.synth.textures.catalogue import BILLBOARDS, SHOP_SIGNS, SHOP_WINDOWS

_BARNS: Final[tuple[Colour, ...]] = ((0.24, 0.07, 0.05), (0.20, 0.14, 0.09), (0.32, 0.28, 0.22), (0.13, 0.10, 0.08))
_SHEETS: Final[tuple[Colour, ...]] = ((0.52, 0.53, 0.53), (0.30, 0.36, 0.42), (0.42, 0.40, 0.36), (0.22, 0.30, 0.25))


def _add_shed(
    pieces: Pieces,
    low: tuple[float, float],
    high: tuple[float, float],
    eaves_m: float,
    rise_m: float,
    wall: Finish,
    gable: Finish,
    roof: Finish,
) -> None:
    """Add four walls and a saddle roof; its ridge runs along the longer side."""
    (a, b), (c, d) = low, high
    foot = Finish(STONE, Material.CONCRETE, Label.BUILDING, wall.seed)
    outline = [(a, b), (c, b), (c, d), (a, d)]
    for start, end in zip(outline, outline[1:] + outline[:1]):
        pieces.wall(start, end, FOOT_M, 0.5, foot)
        pieces.wall(start, end, 0.5, eaves_m, wall)
    # p runs along the ridge and q across it; both are rotated by 90 degrees if the ridge leads away from the street.
    turned = d - b > c - a
    p0, p1, q0, q1 = (b, d, -c, -a) if turned else (a, c, b, d)

    def at(p: float, q: float, z: float) -> tuple[float, float, float]:
        return (-q, p, z) if turned else (p, q, z)

    over, top, middle = 0.4, eaves_m + rise_m, 0.5 * (q0 + q1)
    low_z = eaves_m - over * rise_m / (middle - q0)
    for near, q, far in ((p0 - over, q0 - over, p1 + over), (p1 + over, q1 + over, p0 - over)):
        slope = (at(near, q, low_z), at(far, q, low_z), at(far, middle, top), at(near, middle, top))
        pieces.face(slope, roof._replace(two_sided=True))
    for p, left, right in ((p0, q1, q0), (p1, q0, q1)):
        pieces.face((at(p, left, eaves_m), at(p, right, eaves_m), at(p, middle, top)), gable)


def build_farm(rng: np.random.Generator, length_m: float, depth_m: float) -> Model:
    """Build a barn with a large door, a silo, and a farmhouse where there is room.

    Args:
        rng: random generator.
        length_m: length of the lot.
        depth_m: depth of the lot.
    """
    pieces = Pieces()
    seed = int(rng.integers(1 << 20))
    tiles = Finish(TILES[int(rng.integers(len(TILES)))], Material.ROOF, Label.BUILDING, seed)
    split = rng.uniform(0.50, 0.58) if length_m > 20.0 else 1.0
    half = 0.5 * length_m - 0.6
    side = 1.0 if rng.random() < 0.5 else -1.0
    edge = half - split * 2.0 * half
    ends = sorted((side * -half, side * -edge))
    colour = _BARNS[int(rng.integers(len(_BARNS)))]
    boards = Finish(colour, Material.FACADE, Label.BUILDING, seed, int(Windows.BOARDS))
    front, back = 0.25 * depth_m, min(0.25 * depth_m + rng.uniform(9.0, 13.0), depth_m - 0.5)
    eaves = rng.uniform(3.8, 5.0)
    low, high = (ends[0], front), (ends[1], back)
    _add_shed(
        pieces, low, high, eaves, 0.28 * (back - front) + 0.8, boards, boards._replace(material=Material.WOOD), tiles
    )
    middle = 0.5 * (ends[0] + ends[1])
    gate = Finish((0.08, 0.07, 0.06), Material.WOOD, Label.BUILDING, seed)
    pieces.wall((middle - 2.0, front - 0.04), (middle + 2.0, front - 0.04), 0.05, 3.5, gate)
    rail = Finish((0.10, 0.10, 0.10), Material.METAL, Label.BUILDING)
    pieces.block((middle - 2.6, front - 0.12, 3.5), (middle + 2.6, front, 3.62), rail, without=("+y",))
    if split < 1.0:
        ends = sorted((side * (-edge + 2.5), side * half))
        plaster = Finish((0.60, 0.56, 0.47), Material.FACADE, Label.BUILDING, seed + 1, int(Windows.COTTAGE))
        roof = tiles._replace(seed=seed + 1)
        start, end = 0.12 * depth_m, min(0.12 * depth_m + 8.0, depth_m - 0.5)
        gable = plaster._replace(material=Material.PLASTER)
        _add_shed(pieces, (ends[0], start), (ends[1], end), 5.6, 3.4, plaster, gable, roof)
        x, y = 0.5 * (ends[0] + ends[1]) + 1.5, 0.5 * (start + end)
        brick = Finish((0.28, 0.14, 0.10), Material.BRICK, Label.BUILDING, seed)
        pieces.block((x - 0.35, y - 0.35, 8.0), (x + 0.35, y + 0.35, 9.8), brick)
    if depth_m > 24.0:
        radius = 1.9
        x, y = max(middle - 3.0, radius - half), min(back + 4.0, depth_m - 2.2)
        angle = 2.0 * np.pi * np.arange(12) / 12
        outline = np.stack([x + radius * arrays.cos(angle), y + radius * arrays.sin(angle)], axis=1)
        pieces.prism(outline, FOOT_M, 8.5, Finish((0.42, 0.43, 0.42), Material.METAL, Label.BUILDING, seed))
    return pieces.model()


def build_warehouse(rng: np.random.Generator, length_m: float, depth_m: float) -> Model:
    """Build a hall of metal sheets with gates, an office corner and a company sign.

    Args:
        rng: random generator.
        length_m: length of the lot.
        depth_m: depth of the lot.
    """
    pieces = Pieces()
    seed = int(rng.integers(1 << 20))
    half, front, back = 0.5 * length_m - 0.5, 0.2 * depth_m, depth_m - 0.5
    high = rng.uniform(6.5, 10.0)
    colour = _SHEETS[int(rng.integers(len(_SHEETS)))]
    sheets = Finish(colour, Material.FACADE, Label.BUILDING, seed, int(Windows.CLADDING))
    roof = Finish((0.36, 0.36, 0.36), Material.METAL, Label.BUILDING, seed)
    _add_shed(pieces, (-half, front), (half, back), high, 1.4, sheets, sheets._replace(material=Material.METAL), roof)
    band = Finish((0.25, 0.05, 0.04) if rng.random() < 0.5 else (0.05, 0.10, 0.25), Material.METAL, Label.BUILDING)
    pieces.wall((-half, front - 0.03), (half, front - 0.03), high - 0.9, high - 0.4, band)
    office = min(9.0, 0.4 * length_m)
    glass = Finish((0.45, 0.45, 0.44), Material.FACADE, Label.BUILDING, seed + 1, int(Windows.RIBBON))
    outline = [(-half, front - 2.5), (office - half, front - 2.5), (office - half, front), (-half, front)]
    pieces.prism(outline, FOOT_M, 0.0, Finish(STONE, Material.CONCRETE, Label.BUILDING))
    pieces.prism(outline, 0.0, 7.0 if high > 7.5 else 3.5, glass, top=roof)
    gate = Finish((0.50, 0.51, 0.52), Material.METAL, Label.BUILDING, seed)
    frame = Finish((0.05, 0.05, 0.05), Material.PLAIN, Label.BUILDING)
    count = max(int((length_m - office - 4.0) / 7.0), 1)
    for number in range(count):
        x = office - half + 3.5 + 7.0 * number
        if x + 2.4 > half:
            break
        pieces.wall((x - 2.1, front - 0.03), (x + 2.1, front - 0.03), 0.0, 4.5, frame)
        pieces.wall((x - 1.9, front - 0.05), (x + 1.9, front - 0.05), 0.0, 4.3, gate)
    sign = Finish((0.6, 0.6, 0.6), Material.LIT_IMAGE, Label.BUILDING, image=int(rng.choice(SHOP_SIGNS)))
    wide = min(7.5, 0.4 * length_m)
    pieces.wall((half - wide - 1.0, front - 0.06), (half - 1.0, front - 0.06), high - 0.7 - wide / 5, high - 0.7, sign)
    return pieces.model()


def build_petrol_station(rng: np.random.Generator, length_m: float, depth_m: float) -> Model:
    """Build a canopy over pumps, a shop behind it, and a price mast.

    Args:
        rng: random generator.
        length_m: length of the lot.
        depth_m: depth of the lot.
    """
    pieces = Pieces()
    seed = int(rng.integers(1 << 20))
    accent: Colour = ((0.45, 0.04, 0.03), (0.04, 0.20, 0.10), (0.04, 0.10, 0.32))[int(rng.integers(3))]
    half = min(0.5 * length_m - 1.0, 11.0)
    near, far = 0.18 * depth_m, 0.18 * depth_m + min(8.0, 0.4 * depth_m)
    white, colour = (Finish(c, Material.METAL, Label.BUILDING, seed) for c in ((0.62, 0.62, 0.61), accent))
    under = rng.uniform(4.6, 5.2)
    pieces.block((-half, near, under), (half, far, under + 0.8), white, without=())
    pieces.block(
        (-half - 0.02, near - 0.02, under + 0.15), (half + 0.02, far + 0.02, under + 0.45), colour, without=("-z", "+z")
    )
    lamp = Finish((0.7, 0.7, 0.68), Material.STREET_LAMP, Label.BUILDING)
    _add_lights(pieces, (-half, near), (half, far), under - 0.02, lamp)
    middle = 0.5 * (near + far)
    for x in np.linspace(-0.65 * half, 0.65 * half, 3):
        pieces.block((x - 0.18, middle - 0.18, FOOT_M), (x + 0.18, middle + 0.18, under), white, without=("-z", "+z"))
        kerb = Finish((0.45, 0.44, 0.42), Material.CONCRETE, Label.FURNITURE)
        pieces.block((x - 1.8, middle - 0.6, -0.5), (x + 1.8, middle + 0.6, 0.15), kerb)
        for pump in (x - 1.0, x + 1.0):
            pieces.block(
                (pump - 0.4, middle - 0.25, 0.15),
                (pump + 0.4, middle + 0.25, 1.7),
                white._replace(label=Label.FURNITURE),
            )
            pieces.block(
                (pump - 0.42, middle - 0.27, 1.2),
                (pump + 0.42, middle + 0.27, 1.5),
                colour._replace(label=Label.FURNITURE),
            )
    front, back = far + 3.0, min(far + 10.0, depth_m - 0.3)
    wall = Finish((0.55, 0.55, 0.53), Material.PLASTER, Label.BUILDING, seed)
    wide = 0.8 * half
    outline = [(-wide, front), (wide, front), (wide, back), (-wide, back)]
    pieces.prism(outline, FOOT_M, 4.0, wall)
    for number in range(3):
        a = -wide + 0.4 + number * (2 * wide - 0.8) / 3
        shop = Finish(
            (0.06, 0.06, 0.06), Material.SHOPFRONT, Label.BUILDING, seed + number, image=int(rng.choice(SHOP_WINDOWS))
        )
        pieces.wall((a, front - 0.03), (a + (2 * wide - 0.8) / 3, front - 0.03), 0.05, 2.8, shop)
    sign = Finish((0.6, 0.6, 0.6), Material.LIT_IMAGE, Label.BUILDING, image=int(rng.choice(SHOP_SIGNS)))
    pieces.wall((-2.0, front - 0.05), (2.0, front - 0.05), 3.0, 3.8, sign)
    _add_mast(pieces, 0.5 * length_m - 1.3, 1.0, int(rng.choice(BILLBOARDS)), white)
    return pieces.model()


def _add_lights(pieces: Pieces, low: tuple[float, float], high: tuple[float, float], z_m: float, lamp: Finish) -> None:
    """Add lamps under the canopy."""
    for x in np.linspace(0.8 * low[0], 0.8 * high[0], 4):
        for y in (low[1] + 1.5, high[1] - 1.5):
            left, right, near, far = x - 0.35, x + 0.35, y - 0.35, y + 0.35
            pieces.face(((left, far, z_m), (right, far, z_m), (right, near, z_m), (left, near, z_m)), lamp)


def _add_mast(pieces: Pieces, x: float, y: float, image: int, finish: Finish) -> None:
    """Add a pole with an advertisement that is visible from both directions of the street."""
    pieces.tube((x, y, FOOT_M), (x, y, 5.0), 0.12, finish)
    panel = Finish((0.6, 0.6, 0.6), Material.LIT_IMAGE, Label.BILLBOARD, image=image)
    low, high = (x - 0.12, y - 0.9), (x + 0.12, y + 0.9)
    pieces.block((*low, 4.6), (*high, 5.8), finish, without=("-x", "+x"))
    pieces.wall((high[0], low[1]), high, 4.6, 5.8, panel)
    pieces.wall((low[0], high[1]), low, 4.6, 5.8, panel)
