"""Builds people on foot and on two-wheelers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from mirror.portable import arrays
from mirror.synth.model import Label, Model
from mirror.synth.road_users.body import Body, Saddle
from mirror.synth.road_users.figure import Bag, Colour, Garment, Hat, Person, build_person
from mirror.synth.road_users.skeleton import STRIDE, riding_skeleton, walking_skeleton
from mirror.synth.textures.catalogue import FACES
from mirror.traffic.placement.motion import Placement

_TOPS: Final[tuple[Colour, ...]] = (
    (0.018, 0.019, 0.022), (0.018, 0.019, 0.022), (0.028, 0.034, 0.060), (0.075, 0.078, 0.082), (0.17, 0.165, 0.155),
    (0.16, 0.022, 0.022), (0.050, 0.060, 0.036), (0.15, 0.11, 0.065), (0.46, 0.45, 0.43), (0.035, 0.075, 0.14),
    (0.28, 0.19, 0.045), (0.10, 0.035, 0.06), (0.035, 0.10, 0.075),
)  # fmt: skip
_LEGS: Final[tuple[Colour, ...]] = (
    (0.018, 0.019, 0.023), (0.035, 0.050, 0.090), (0.024, 0.032, 0.055), (0.080, 0.077, 0.074), (0.18, 0.145, 0.10),
    (0.050, 0.047, 0.038),
)  # fmt: skip
_SHOES: Final[tuple[Colour, ...]] = ((0.02, 0.02, 0.02), (0.055, 0.033, 0.02), (0.45, 0.45, 0.44))
_FULL_PACE_MPS: Final = 0.9
_RIDING_LEG: Final = 0.50
"""Largest distance from the saddle to the lower pedal, as a share of the height."""
_PHASES: Final = 64
"""Number of poses in a gait cycle, 2 cm of walking apart."""
_PACES: Final = 8
_POSES_KEPT: Final = 4096
_BOX_PHASES: Final = 16
_BOX_SPARE_M: Final = 0.004
"""Margin of the box for poses between the sampled ones."""


@dataclass(frozen=True, eq=False)
class Pedestrian(Body):
    """A person on foot; ``model`` is the standing pose.

    Attributes:
        person: body and clothes.
    """

    person: Person

    @property
    def stride_m(self) -> float:
        """Length of a gait cycle: two steps at full pace."""
        return STRIDE * self.person.height_m

    def model_at(self, placement: Placement) -> Model:
        """Return the walking or standing pose, rounded to a fixed set of poses; steps are shorter at low speed."""
        phase = round(_PHASES * placement.along_m / self.stride_m) % _PHASES
        pace = round(_PACES * min(placement.speed_mps / _FULL_PACE_MPS, 1.0))
        return self.model if pace <= 0 else _cached_pose(self.person, phase, pace)

    def walking(self, phase: float, pace: float = 1.0) -> Model:
        """Return a pose of the walk, within the box at every phase and pace.

        Args:
            phase: walked distance divided by ``stride_m``; the gait repeats after 1.
            pace: from 0 (standing) to 1 (full steps).
        """
        if pace <= 0.0:
            return self.model
        return _build_walker(self.person, phase, pace)


@lru_cache(_POSES_KEPT)
def _cached_pose(person: Person, phase: int, pace: int) -> Model:
    return _build_walker(person, phase / _PHASES, pace / _PACES)


def _build_walker(person: Person, phase: float, pace: float) -> Model:
    skeleton = walking_skeleton(person.height_m, phase, pace, arm_raised=person.umbrella is not None)
    return build_person(person, skeleton, Label.PERSON)


def draw_person(rng: np.random.Generator, *, child: bool = False, umbrella: bool = False, warm: bool = False) -> Person:
    """Draw a person with clothes for the weather.

    Args:
        rng: random generator.
        child: whether the person is a child of 5 to 12 years instead of an adult.
        umbrella: whether the person holds an umbrella up.
        warm: whether the clothes are shirts and dresses instead of jackets and coats.
    """
    garments: tuple[Garment, ...] = ("shirt", "shirt", "dress", "jacket") if warm else ("jacket", "jacket", "coat")
    hats: tuple[Hat, ...] = ("none", "none", "none", "cap") if warm else ("none", "none", "none", "beanie", "cap")
    bags: tuple[Bag, ...] = ("none", "none", "backpack", "handbag")
    colours = [_TOPS[int(i)] for i in rng.integers(len(_TOPS), size=4)]
    height = rng.uniform(1.05, 1.45) if child else rng.normal(1.71, 0.075)
    return Person(
        height_m=float(np.clip(height, 1.0, 1.95)),
        stout=float(rng.uniform(0.92, 1.12)),
        face=int(rng.choice(FACES)),
        garment=garments[int(rng.integers(len(garments)))],
        top=colours[0],
        legs=_LEGS[int(rng.integers(len(_LEGS)))],
        shoes=_SHOES[int(rng.integers(len(_SHOES)))],
        hat=hats[int(rng.integers(len(hats)))],
        hat_colour=colours[1],
        bag="none" if umbrella else bags[int(rng.integers(len(bags)))],
        bag_colour=colours[2],
        umbrella=colours[3] if umbrella else None,
        seed=int(rng.integers(1 << 30)),
    )


def draw_pedestrian(
    rng: np.random.Generator, *, child: bool = False, umbrella: bool = False, warm: bool = False
) -> Pedestrian:
    """Draw a pedestrian; see :func:`draw_person` for the arguments."""
    person = draw_person(rng, child=child, umbrella=umbrella, warm=warm)
    standing = _build_walker(person, 0.0, 0.0)
    # Legs reach farthest as the heels come down, arms and luggage a little later, the head half-way between.
    poses = [_build_walker(person, phase / _BOX_PHASES, 1.0) for phase in range(_BOX_PHASES)]
    ends = np.array([np.abs(model.bounds()).max(axis=0) for model in (standing, *poses)]).max(axis=0)
    length, width, height = np.array([2.0, 2.0, 1.0]) * ends + _BOX_SPARE_M
    return Pedestrian("pedestrian", (float(length), float(width), float(height)), standing, person)


def build_rider(rng: np.random.Generator, saddle: Saddle, *, motorcycle: bool = False) -> Model:
    """Build the rider of a two-wheeler, in the frame of the vehicle.

    Args:
        rng: random generator that decides the person.
        saddle: contact points of the rider.
        motorcycle: whether the rider wears a full helmet and a jacket; others mostly wear a cycle helmet or none.
    """
    person = draw_person(rng)
    hats: tuple[Hat, ...] = ("full helmet",) if motorcycle else ("cycle helmet", "cycle helmet", "none")
    bag: Bag = "none" if person.bag == "handbag" else person.bag
    garment: Garment = "jacket" if motorcycle or rng.random() < 0.6 else "shirt"
    # The rider's height is raised until the legs reach the pedals.
    reach = max(float(arrays.norm(np.subtract(saddle.hip, foot))) for foot in (saddle.foot, saddle.foot_right))
    height = max(person.height_m, reach / _RIDING_LEG)
    person = replace(
        person, height_m=min(height, 2.0), garment=garment, hat=hats[int(rng.integers(len(hats)))], bag=bag
    )
    return build_person(person, riding_skeleton(person.height_m, saddle), Label.RIDER)
