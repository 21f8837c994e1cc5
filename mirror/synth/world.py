"""The static street of a scene: three straight streets with their crossings, houses, trees, lamps and parked cars.

It is laid out in street coordinates, u along the main street and v to its left, and stands turned by the main street's
direction in the scene's east-north-up frame, with the road surface at height 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float64, Records
from mirror.schema.documents import Roi
from mirror.synth.render.primitives import (
    BARK,
    ELLIPSOID,
    FACADE,
    LAMP,
    LEAVES,
    METAL,
    ROOF,
    SKYLINE,
    placed,
    solid,
)
from mirror.synth.road_users import Body, Placement, RoadUser, Straight, car, van

HALF_ROAD_M: Final = 5.8
LANE_LINE_M: Final = 3.45
PAVEMENT_M: Final = 3.6
LANE_CENTRE_M: Final = 1.75
_PARKED_AT_M: Final = 4.7
_CURB_M: Final = HALF_ROAD_M + PAVEMENT_M

STREET: Final = np.dtype(
    [
        ("origin", np.float64, 2),
        ("direction", np.float64, 2),
        ("half_road", np.float64),
        ("lane_line", np.float64),
        ("pavement", np.float64),
    ]
)

_FACADES: Final = (
    (0.46, 0.20, 0.13),
    (0.60, 0.52, 0.40),
    (0.66, 0.62, 0.55),
    (0.52, 0.36, 0.24),
    (0.40, 0.42, 0.43),
    (0.70, 0.58, 0.34),
    (0.32, 0.16, 0.13),
    (0.55, 0.60, 0.60),
)


@dataclass(frozen=True)
class Style:
    """What tells one kind of scene from another.

    Attributes:
        storeys: fewest and most of a house.
        gap_m: between houses, least and most.
        set_back_m: of houses from the pavement, least and most.
        tree_every_m: along the pavements.
        parked: share of the parking places that are taken.
        green: whether the land is grass, not stone.
    """

    storeys: tuple[int, int]
    gap_m: tuple[float, float]
    set_back_m: tuple[float, float]
    tree_every_m: float
    parked: float
    green: bool


STYLES: Final = {
    "urban": Style((3, 7), (0.0, 5.0), (0.2, 1.5), 19.0, 0.55, green=False),
    "campus": Style((2, 4), (8.0, 22.0), (4.0, 10.0), 11.0, 0.30, green=True),
}


@dataclass(frozen=True)
class World:
    """All that stands still in a scene.

    Attributes:
        roi: the scene.
        yaw_rad: direction of the main street, counter-clockwise from east.
        cross_m: where the cross street meets the main street.
        edge_m: where the street at the edge of the ROI meets it.
        streets: (3,) STREET: main, cross, edge.
        solids: (N,) SOLID.
        lamps: (M, 3) lights of the street lamps.
        parked: parked cars, whose bodies are not among ``solids``.
        green: whether the land is grass.
        seed: of the textures.
    """

    roi: Roi
    yaw_rad: float
    cross_m: float
    edge_m: float
    streets: Records
    solids: Records
    lamps: Float64
    parked: tuple[RoadUser, ...]
    green: bool
    seed: int

    def point(self, u: float, v: float) -> tuple[float, float]:
        """World x and y of street coordinates."""
        return _turned(self.yaw_rad, u, v)

    def placement(self, u: float, v: float, yaw: float = 0.0, speed_mps: float = 0.0) -> Placement:
        """A placement given in street coordinates."""
        return Placement(*self.point(u, v), self.yaw_rad + yaw, speed_mps)


def build_world(roi: Roi, yaw_deg: float, seed: int) -> World:
    """Lay out a scene.

    Args:
        roi: the scene; its radius sets the extent, its ``scene_type`` the style (``urban`` or ``campus``).
        yaw_deg: direction of the main street, counter-clockwise from east.
        seed: of everything that is left to chance.
    """
    rng = np.random.default_rng([seed, 1])
    style = STYLES[roi.scene_type or "urban"]
    yaw = math.radians(yaw_deg)
    radius = roi.radius_m
    cross, edge = 0.28 * radius, -0.975 * radius
    extent = radius + 70.0
    layout = _Layout(style, extent, (cross, edge), rng)
    solids = [*layout.houses(), *layout.trees(), *layout.skyline()]
    lamps = layout.lamps()
    solids += [part for u, v, side in lamps for part in _lamp_post(u, v, side)]
    cos, sin = math.cos(yaw), math.sin(yaw)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    standing = placed(np.concatenate(solids), turn, np.zeros(3), -1)
    streets = np.zeros(3, STREET)
    for street, (u, across) in zip(streets, ((0.0, 0.0), (cross, math.pi / 2), (edge, math.pi / 2))):
        street["origin"] = _turned(yaw, u, 0.0)
        street["direction"] = math.cos(yaw + across), math.sin(yaw + across)
        street["half_road"], street["lane_line"], street["pavement"] = HALF_ROAD_M, LANE_LINE_M, PAVEMENT_M
    lights = np.array([(*_turned(yaw, u, v - 1.5 * side), 6.2) for u, v, side in lamps])
    parked = tuple(
        RoadUser(
            f"parked-{number:03d}", body, Straight(Placement(*_turned(yaw, u, v), yaw + (math.pi if v > 0 else 0), 0.0))
        )
        for number, (u, v, body) in enumerate(layout.parked())
    )
    return World(roi, yaw, cross, edge, streets, standing, lights, parked, style.green, seed)


def _turned(yaw: float, u: float, v: float) -> tuple[float, float]:
    return u * math.cos(yaw) - v * math.sin(yaw), u * math.sin(yaw) + v * math.cos(yaw)


class _Layout:
    """Places things along the streets, in street coordinates, clear of the other streets."""

    def __init__(self, style: Style, extent: float, across: Sequence[float], rng: np.random.Generator) -> None:
        self.style, self.extent, self.across, self.rng = style, extent, across, rng
        self._built: list[tuple[float, float, float, float]] = []

    def houses(self) -> Iterator[Records]:
        """Rows of houses on both sides of every street."""
        for street in range(3):
            for side in (1, -1):
                at = -self.extent
                while at < self.extent:
                    length, depth = self.rng.uniform(12, 26), self.rng.uniform(10, 15)
                    back = _CURB_M + self.rng.uniform(*self.style.set_back_m)
                    storeys = int(self.rng.integers(self.style.storeys[0], self.style.storeys[1] + 1))
                    colour = np.array(_FACADES[self.rng.integers(len(_FACADES))]) * self.rng.uniform(0.85, 1.1)
                    seed = int(self.rng.integers(1 << 30))
                    middle, aside = at + 0.5 * length, side * (back + 0.5 * depth)
                    if self._free(street, middle, aside, length, depth):
                        yield from _house(
                            *self._uv(street, middle, aside), street, side, length, depth, storeys, colour, seed
                        )
                    at += length + self.rng.uniform(*self.style.gap_m)

    def trees(self) -> Iterator[Records]:
        """Trees in the pavement and, where the land is green, behind it."""
        rows = [_CURB_M - 0.9] + ([_CURB_M + 3.0, _CURB_M + 20.0] if self.style.green else [])
        for street in range(3):
            for row in rows:
                for side in (1, -1):
                    count = int(2 * self.extent / self.style.tree_every_m)
                    for number in range(count):
                        at = -self.extent + (number + self.rng.uniform(0.3, 0.7)) * self.style.tree_every_m
                        keep, height, seed = (
                            self.rng.random(),
                            self.rng.uniform(5.0, 8.5),
                            int(self.rng.integers(1 << 30)),
                        )
                        if keep < 0.8 and self._free(street, at, side * row, 1.6, 1.6, clear=4.0, keep=False):
                            yield from _tree(*self._uv(street, at, side * row), height, seed)

    def lamps(self) -> list[tuple[float, float, int]]:
        """Lamp posts, on alternating sides: u, v and the side of the road, along the main street only."""
        posts = []
        for number, at in enumerate(np.arange(-self.extent + 6.0, self.extent, 22.0)):
            side = 1 if number % 2 else -1
            if all(abs(at - u) > HALF_ROAD_M + 1.5 for u in self.across):
                posts.append((float(at), side * (HALF_ROAD_M + 0.5), side))
        return posts

    def parked(self) -> Iterator[tuple[float, float, Body]]:
        """Cars in the parking lanes of the main street, none near its crossings and its ends."""
        for side in (1, -1):
            for at in np.arange(-self.extent + 50.0, self.extent - 50.0, 6.3):
                taken, kind = self.rng.random() < self.style.parked, self.rng.random()
                body = van(self.rng) if kind < 0.12 else car(self.rng)
                if taken and all(abs(at - u) > 18.0 for u in self.across):
                    yield float(at + self.rng.uniform(-0.3, 0.3)), side * _PARKED_AT_M, body

    def skyline(self) -> Iterator[Records]:
        """A ring of far houses and woods, so that no street ends in nothing."""
        for bearing in np.arange(0.0, 2.0 * math.pi, math.pi / 36.0):
            far, width = self.extent + self.rng.uniform(60, 130), self.rng.uniform(26, 40)
            tall = self.rng.uniform(9, 16) if self.style.green else self.rng.uniform(14, 42)
            colour = (0.10, 0.15, 0.08) if self.style.green else (0.34, 0.35, 0.37)
            shade = self.rng.uniform(0.8, 1.15)
            at = (far * math.cos(bearing), far * math.sin(bearing), 0.5 * tall)
            seed = int(self.rng.integers(1 << 30))
            yield solid(at, (14.0, width, tall), [shade * c for c in colour], SKYLINE, yaw=bearing, seed=seed)

    def _uv(self, street: int, along: float, aside: float) -> tuple[float, float]:
        return (along, aside) if street == 0 else (self.across[street - 1] - aside, along)

    def _free(
        self,
        street: int,
        along: float,
        aside: float,
        length: float,
        depth: float,
        *,
        clear: float = 0.0,
        keep: bool = True,
    ) -> bool:
        """Whether a place is clear of every street and house; a house that is kept takes it."""
        u, v = self._uv(street, along, aside)
        du, dv = (0.5 * length, 0.5 * depth) if street == 0 else (0.5 * depth, 0.5 * length)
        own = _CURB_M if keep else HALF_ROAD_M + clear / 4
        others = _CURB_M + clear
        limit = [own if street == number else others for number in range(3)]
        if abs(v) < dv + limit[0] - 1e-6 or any(
            abs(u - at) < du + limit[number] - 1e-6 for number, at in enumerate(self.across, start=1)
        ):
            return False
        if any(abs(u - a) < du + da + 0.2 and abs(v - b) < dv + db + 0.2 for a, b, da, db in self._built):
            return False
        if keep:
            self._built.append((u, v, du, dv))
        return True


def _house(
    u: float, v: float, street: int, side: int, length: float, depth: float, storeys: int, colour: Float64, seed: int
) -> Iterator[Records]:
    """A block with its front to the street (its local -y), and a parapet or a pitched roof."""
    yaw = (0.0 if side > 0 else math.pi) + (0.0 if street == 0 else math.pi / 2)
    height = 3.1 * storeys + 1.0
    yield solid((u, v, 0.5 * height), (length, depth, height), colour, FACADE, yaw=yaw, seed=seed)
    if seed % 3:
        roof = (0.22, 0.10, 0.07) if seed % 2 else (0.10, 0.10, 0.11)
        rise, along = 0.30 * depth, (depth, length)
        yield solid(
            (u, v, height + 0.5 * rise), (along[0] + 0.8, along[1] + 0.5, rise), roof, ROOF,
            slope=(1.5, 1.5), yaw=yaw + math.pi / 2, seed=seed,
        )  # fmt: skip
    else:
        yield solid((u, v, height + 0.2), (length + 0.3, depth + 0.3, 0.4), 0.8 * colour, ROOF, yaw=yaw, seed=seed)


def _tree(u: float, v: float, height: float, seed: int) -> Iterator[Records]:
    rng = np.random.default_rng(seed)
    yield solid(
        (u, v, 0.25 * height), (0.30, 0.30, 0.5 * height), (0.12, 0.08, 0.05), BARK, slope=(0.02, 0.02), seed=seed
    )
    green = np.array([0.09, 0.17, 0.04]) * rng.uniform(0.8, 1.3)
    for turn in range(4):
        spread = 0.16 * height * rng.uniform(0.6, 1.1)
        angle = turn * math.pi / 2 + rng.uniform(-0.5, 0.5)
        size = height * rng.uniform(0.34, 0.46)
        yield solid(
            (u + spread * math.cos(angle), v + spread * math.sin(angle), height * rng.uniform(0.62, 0.84)),
            (size, size, 0.85 * size), green * rng.uniform(0.85, 1.15), LEAVES, shape=ELLIPSOID, seed=seed + turn,
        )  # fmt: skip


def _lamp_post(u: float, v: float, side: int) -> Iterator[Records]:
    yield solid((u, v, 3.2), (0.13, 0.13, 6.4), (0.10, 0.11, 0.11), METAL)
    yield solid((u, v - 0.75 * side, 6.37), (0.08, 1.6, 0.08), (0.10, 0.11, 0.11), METAL)
    yield solid((u, v - 1.5 * side, 6.28), (0.28, 0.7, 0.14), (0.75, 0.72, 0.65), LAMP)
