"""Styles of houses: numbers of storeys, walls, roofs, ground floors and colours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from mirror.synth.model import Material
from mirror.synth.street.houses.windows import Windows

HouseStyle = Literal[
    "stucco", "brick", "modern", "panel", "shophouse", "detached", "hall", "tower", "farm", "warehouse", "station"
]
RoofKind = Literal["flat", "gable", "hip", "mansard"]
GroundFloor = Literal["flats", "shops", "lobby"]
Colour = tuple[float, float, float]

_STUCCO: Final[tuple[Colour, ...]] = (
    (0.60, 0.53, 0.40),
    (0.56, 0.43, 0.26),
    (0.50, 0.50, 0.47),
    (0.50, 0.36, 0.30),
    (0.54, 0.47, 0.37),
    (0.66, 0.64, 0.59),
    (0.40, 0.44, 0.37),
    (0.40, 0.45, 0.50),
    (0.58, 0.50, 0.44),
)
BRICKS: Final[tuple[Colour, ...]] = (
    (0.30, 0.13, 0.085),
    (0.35, 0.18, 0.12),
    (0.24, 0.11, 0.08),
    (0.41, 0.29, 0.19),
    (0.20, 0.17, 0.15),
)
"""Colours of brick walls."""
_MODERN: Final[tuple[Colour, ...]] = (
    (0.55, 0.55, 0.53),
    (0.30, 0.30, 0.31),
    (0.68, 0.67, 0.64),
    (0.38, 0.31, 0.24),
    (0.16, 0.16, 0.17),
    (0.50, 0.45, 0.38),
)
_CONCRETE: Final[tuple[Colour, ...]] = ((0.46, 0.45, 0.42), (0.52, 0.47, 0.40), (0.42, 0.45, 0.47), (0.56, 0.53, 0.47))
_LIGHT: Final[tuple[Colour, ...]] = ((0.66, 0.64, 0.60), (0.60, 0.54, 0.43), (0.54, 0.50, 0.45), (0.60, 0.46, 0.34))

TILES: Final[tuple[Colour, ...]] = ((0.24, 0.10, 0.065), (0.19, 0.085, 0.06), (0.085, 0.08, 0.08), (0.13, 0.12, 0.12))
"""Colours of pitched roofs: red and brown tiles, slates."""


@dataclass(frozen=True)
class Style:
    """Properties that the houses of one style share.

    Attributes:
        storeys: smallest and largest number of storeys above the ground floor.
        depth_m: smallest and largest depth.
        fronts: windows of the wall towards the street; one is chosen.
        sides: windows of the other walls.
        wall: material of gables and other walls without windows.
        colours: colours of walls that are not brick; one is chosen.
        roofs: kinds of roof; one is chosen.
        ground: kinds of ground floor; one is chosen.
        ground_m: height of the ground floor.
        balconies: share of the houses with balconies.
        bays: share of the houses with bay windows.
        cornice: whether there is a cornice under the roof.
        free: whether all four sides are visible.
        set_back_m: smallest and largest distance of the front from the lot's edge.
    """

    storeys: tuple[int, int]
    depth_m: tuple[float, float]
    fronts: tuple[Windows, ...]
    sides: Windows
    wall: Material
    colours: tuple[Colour, ...]
    roofs: tuple[RoofKind, ...]
    ground: tuple[GroundFloor, ...]
    ground_m: float
    balconies: float = 0.0
    bays: float = 0.0
    cornice: bool = False
    free: bool = False
    set_back_m: tuple[float, float] = (0.0, 0.0)


STYLES: Final[dict[HouseStyle, Style]] = {
    "stucco": Style(
        (2, 4), (10.0, 13.0), (Windows.TALL, Windows.TALL, Windows.SASH), Windows.SIDE, Material.PLASTER, _STUCCO,
        ("mansard", "gable", "flat"), ("shops", "flats"), 4.1, balconies=0.55, bays=0.35, cornice=True,
    ),
    "brick": Style(
        (2, 3), (9.0, 12.0), (Windows.SASH_BRICK, Windows.TALL_BRICK, Windows.LOFT), Windows.SIDE_BRICK,
        Material.BRICK, (), ("gable", "flat", "mansard"), ("shops", "flats"), 3.9, balconies=0.3, bays=0.25,
        cornice=True,
    ),
    "modern": Style(
        (2, 5), (11.0, 14.0), (Windows.MODERN, Windows.MODERN_BRICK, Windows.RIBBON), Windows.SIDE,
        Material.PLASTER, _MODERN, ("flat",), ("shops", "flats"), 4.0, balconies=0.75,
    ),
    "panel": Style(
        (4, 6), (11.0, 12.0), (Windows.PANEL,), Windows.PANEL, Material.CONCRETE, _CONCRETE, ("flat",), ("flats",),
        3.0, balconies=1.0,
    ),
    "shophouse": Style(
        (1, 3), (9.0, 12.0), (Windows.SASH, Windows.SASH_BRICK, Windows.MODERN), Windows.BLIND, Material.PLASTER,
        _STUCCO, ("flat", "gable"), ("shops",), 3.8, bays=0.3, cornice=True,
    ),
    "detached": Style(
        (0, 1), (8.0, 10.0), (Windows.COTTAGE, Windows.COTTAGE_BRICK), Windows.COTTAGE, Material.PLASTER,
        _LIGHT, ("gable", "hip"), ("flats",), 2.9, free=True, set_back_m=(3.5, 5.5),
    ),
    "hall": Style(
        (1, 3), (14.0, 20.0), (Windows.RIBBON, Windows.LOFT, Windows.MODERN_BRICK), Windows.RIBBON,
        Material.CONCRETE, _CONCRETE, ("flat", "flat", "hip"), ("lobby",), 4.2, free=True,
    ),
    "tower": Style(
        (7, 14), (16.0, 24.0), (Windows.CURTAIN_WALL,), Windows.CURTAIN_WALL, Material.CONCRETE,
        ((0.10, 0.13, 0.15), (0.13, 0.13, 0.13), (0.22, 0.25, 0.27)), ("flat",), ("lobby",), 4.8, free=True,
    ),
}  # fmt: skip
"""Styles of houses with storeys; farms, warehouses and petrol stations have their own builders."""
