"""What stands and moves in the street besides buildings: bodies, sizes and motion of the road users."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from mirror.arrays import Records
from mirror.synth.render.primitives import (
    CLOTH,
    CONTAINER,
    CYLINDER,
    ELLIPSOID,
    GLASS,
    METAL,
    PAINT,
    SKIN,
    TYRE,
    solid,
)

CAR_COLOURS: Final = (
    (0.62, 0.63, 0.64),
    (0.80, 0.80, 0.79),
    (0.03, 0.03, 0.035),
    (0.16, 0.17, 0.19),
    (0.42, 0.03, 0.03),
    (0.04, 0.10, 0.32),
    (0.05, 0.16, 0.12),
    (0.45, 0.36, 0.22),
    (0.62, 0.30, 0.04),
)
_CLOTHES: Final = (
    (0.45, 0.05, 0.06),
    (0.06, 0.09, 0.24),
    (0.55, 0.52, 0.45),
    (0.05, 0.05, 0.05),
    (0.08, 0.26, 0.14),
    (0.60, 0.42, 0.06),
)


@dataclass(frozen=True)
class Body:
    """What a road user looks like, in its own frame: x forward, y left, z up, origin on the ground below its centre.

    Attributes:
        category: the class in its 3D boxes.
        size_m: length, width, height of its 3D box.
        solids: (N,) SOLID, within the box.
    """

    category: str
    size_m: tuple[float, float, float]
    solids: Records


@dataclass(frozen=True)
class Placement:
    """Where a road user is at an instant: world x and y, yaw (radians, counter-clockwise from east), speed."""

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float


class Motion(Protocol):
    """Where something is at any time of a drive."""

    def at(self, time_s: float) -> Placement:
        """The placement ``time_s`` after the drive's start."""
        ...


@dataclass(frozen=True)
class Straight:
    """Constant motion along a line; with speed 0, standing still.

    Attributes:
        start: where its line begins.
        reach_m: length of the line; from its end it goes on at its start.
        ahead_m: how far along the line it is at time 0.
    """

    start: Placement
    reach_m: float = math.inf
    ahead_m: float = 0.0

    def at(self, time_s: float) -> Placement:
        """The placement ``time_s`` after the drive's start."""
        along = (self.ahead_m + self.start.speed_mps * time_s) % self.reach_m
        yaw = self.start.yaw_rad
        return Placement(
            self.start.x_m + along * math.cos(yaw), self.start.y_m + along * math.sin(yaw), yaw, self.start.speed_mps
        )


@dataclass(frozen=True)
class RoadUser:
    """One road user of a drive: its boxes carry ``track_id``."""

    track_id: str
    body: Body
    motion: Motion


def car(rng: np.random.Generator) -> Body:
    """A saloon, an estate or a hatchback."""
    length, width, height = rng.uniform(4.1, 4.9), rng.uniform(1.76, 1.9), rng.uniform(1.42, 1.62)
    colour = CAR_COLOURS[rng.integers(len(CAR_COLOURS))]
    waist = 0.58 * height
    rear = rng.uniform(0.25, 0.75)
    cabin_length = length * rng.uniform(0.60, 0.68)
    cabin_x = -0.5 * length + 0.06 * length + 0.5 * cabin_length
    seed = int(rng.integers(1 << 30))
    return Body(
        "car",
        (length, width, height),
        np.concatenate(
            [
                solid(
                    (0, 0, 0.5 * (0.19 + waist)),
                    (length, width - 0.04, waist - 0.19),
                    colour,
                    PAINT,
                    slope=(0.12, 0.10),
                    seed=seed,
                ),
                solid(
                    (cabin_x, 0, 0.5 * (waist + height - 0.06)),
                    (cabin_length, 0.86 * width, height - 0.06 - waist),
                    colour,
                    GLASS,
                    slope=(1.25, rear),
                    seed=seed,
                ),
                _roof(cabin_x, cabin_length, width, height, waist, rear, colour),
                *_wheels(length, width, 0.33),
            ]
        ),
    )


def _roof(
    x: float, length: float, width: float, height: float, waist: float, rear: float, colour: tuple[float, float, float]
) -> Records:
    rise = height - 0.06 - waist
    front_end, back_end = x + 0.5 * length - 1.25 * rise, x - 0.5 * length + rear * rise
    return solid(
        (0.5 * (front_end + back_end), 0, height - 0.03), (front_end - back_end, 0.86 * width, 0.06), colour, METAL
    )


def _wheels(length: float, width: float, radius: float) -> list[Records]:
    return [
        solid((x, y, radius), (2 * radius, 0.24, 2 * radius), (0.02, 0.02, 0.02), TYRE, shape=CYLINDER)
        for x in (0.31 * length, -0.30 * length)
        for y in (0.5 * width - 0.12, 0.12 - 0.5 * width)
    ]


def van(rng: np.random.Generator) -> Body:
    """A delivery van."""
    colour = CAR_COLOURS[int(rng.integers(2))]
    seed = int(rng.integers(1 << 30))
    return Body(
        "van",
        (5.4, 2.02, 2.35),
        np.concatenate(
            [
                solid((0, 0, 0.73), (5.4, 1.98, 1.06), colour, PAINT, slope=(0.16, 0.0), seed=seed),
                solid((1.375, 0, 1.785), (2.31, 1.86, 1.05), colour, GLASS, slope=(0.75, 0.0), seed=seed),
                solid((-1.15, 0, 1.805), (3.1, 1.98, 1.09), colour, CONTAINER, slope=(0.0, 0.05), seed=seed),
                *_wheels(5.4, 2.02, 0.36),
            ]
        ),
    )


def truck(rng: np.random.Generator) -> Body:
    """A rigid truck with a box body."""
    colour = CAR_COLOURS[int(rng.integers(3, len(CAR_COLOURS)))]
    cargo = (0.75, 0.75, 0.72) if rng.random() < 0.5 else CAR_COLOURS[int(rng.integers(4, 8))]
    seed = int(rng.integers(1 << 30))
    return Body(
        "truck",
        (8.2, 2.5, 3.4),
        np.concatenate(
            [
                solid((3.2, 0, 1.05), (1.8, 2.4, 1.3), colour, PAINT, slope=(0.02, 0.0), seed=seed),
                solid((3.2, 0, 2.2), (1.8, 2.34, 1.0), colour, GLASS, slope=(0.18, 0.0), seed=seed),
                solid((-0.95, 0, 2.2), (6.3, 2.5, 2.4), cargo, CONTAINER, seed=seed),
                solid((-0.9, 0, 0.82), (6.2, 1.2, 0.36), (0.05, 0.05, 0.055), METAL),
                *_wheels(8.2, 2.5, 0.48),
            ]
        ),
    )


def bus(rng: np.random.Generator) -> Body:
    """A city bus."""
    colour = ((0.50, 0.04, 0.05), (0.05, 0.22, 0.40), (0.62, 0.44, 0.04))[int(rng.integers(3))]
    seed = int(rng.integers(1 << 30))
    return Body(
        "bus",
        (11.8, 2.55, 3.1),
        np.concatenate(
            [
                solid((0, 0, 0.85), (11.8, 2.51, 1.2), colour, PAINT, slope=(0.02, 0.02), seed=seed),
                solid((0, 0, 2.0), (11.7, 2.5, 1.1), colour, GLASS, slope=(0.04, 0.02), seed=seed),
                solid((0, 0, 2.825), (11.6, 2.5, 0.55), colour, METAL),
                *_wheels(11.8, 2.55, 0.5),
            ]
        ),
    )


def pedestrian(rng: np.random.Generator) -> Body:
    """A person on foot."""
    height = rng.uniform(1.58, 1.86)
    coat = _CLOTHES[rng.integers(len(_CLOTHES))]
    legs = _CLOTHES[rng.integers(1, 4)]
    skin = ((0.62, 0.42, 0.32), (0.45, 0.29, 0.20), (0.28, 0.17, 0.11))[int(rng.integers(3))]
    hair = ((0.02, 0.015, 0.01), (0.12, 0.07, 0.03), (0.35, 0.26, 0.14))[int(rng.integers(3))]
    hip, shoulder = 0.48 * height, 0.83 * height
    return Body(
        "pedestrian",
        (0.62, 0.56, height),
        np.concatenate(
            [
                solid((0.1, 0.09, 0.5 * hip), (0.17, 0.16, hip), legs, CLOTH),
                solid((-0.1, -0.09, 0.5 * hip), (0.17, 0.16, hip), legs, CLOTH),
                solid(
                    (0, 0, 0.5 * (hip + shoulder)), (0.30, 0.44, shoulder - hip + 0.16), coat, CLOTH, shape=ELLIPSOID
                ),
                solid((0, 0.23, 0.66 * height), (0.13, 0.10, 0.36 * height), coat, CLOTH, shape=ELLIPSOID),
                solid((0, -0.23, 0.66 * height), (0.13, 0.10, 0.36 * height), coat, CLOTH, shape=ELLIPSOID),
                solid((0.01, 0, 0.915 * height), (0.20, 0.17, 0.165 * height), skin, SKIN, shape=ELLIPSOID),
                solid((-0.02, 0, 0.94 * height), (0.21, 0.19, 0.12 * height), hair, CLOTH, shape=ELLIPSOID),
            ]
        ),
    )


def cyclist(rng: np.random.Generator) -> Body:
    """A person on a bicycle."""
    coat = _CLOTHES[rng.integers(len(_CLOTHES))]
    frame = CAR_COLOURS[int(rng.integers(4, len(CAR_COLOURS)))]
    return Body(
        "cyclist",
        (1.76, 0.6, 1.74),
        np.concatenate(
            [
                solid((0.54, 0, 0.34), (0.68, 0.05, 0.68), (0.02, 0.02, 0.02), TYRE, shape=CYLINDER),
                solid((-0.54, 0, 0.34), (0.68, 0.05, 0.68), (0.02, 0.02, 0.02), TYRE, shape=CYLINDER),
                solid((0, 0, 0.62), (0.95, 0.05, 0.10), frame, METAL),
                solid((0.42, 0, 0.95), (0.05, 0.56, 0.06), frame, METAL),
                solid((-0.08, 0.1, 0.68), (0.18, 0.15, 0.56), _CLOTHES[1], CLOTH),
                solid((-0.08, -0.1, 0.68), (0.18, 0.15, 0.56), _CLOTHES[3], CLOTH),
                solid((-0.02, 0, 1.18), (0.42, 0.42, 0.62), coat, CLOTH, shape=ELLIPSOID),
                solid((0.12, 0, 1.60), (0.24, 0.20, 0.27), (0.52, 0.36, 0.27), SKIN, shape=ELLIPSOID),
            ]
        ),
    )
