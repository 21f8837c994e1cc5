"""Street lamps. The front faces +x; the foot is at the origin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from mirror.arrays import Float64
from mirror.portable import arrays
from mirror.synth.model import Finish, Label, Material, Model, Pieces

LampKind = Literal["arm", "double", "column", "lantern"]
"""High lamp with an arm over the road; lamp with two arms, between carriageways; low modern lamp; historic lantern."""

FOOT_M: Final = -0.6
_STEEL: Final = Finish((0.24, 0.25, 0.25), Material.METAL, Label.POLE)
_IRON: Final = Finish((0.035, 0.045, 0.04), Material.METAL, Label.POLE)
_GLOW: Final = Finish((0.72, 0.70, 0.64), Material.STREET_LAMP, Label.POLE)


@dataclass(frozen=True)
class LampPost:
    """A street lamp.

    Attributes:
        model: its faces.
        lights: (L, 3) positions of its light sources, metres.
    """

    model: Model
    lights: Float64


def lamp_post(kind: LampKind, *, height_m: float, reach_m: float = 1.8) -> LampPost:
    """Build a street lamp.

    Args:
        kind: kind of lamp.
        height_m: height of the light above the ground.
        reach_m: length of its arms.
    """
    pieces = Pieces()
    if kind in ("arm", "double"):
        ways = (1.0, -1.0) if kind == "double" else (1.0,)
        pieces.tube((0, 0, FOOT_M), (0, 0, 1.0), 0.11, _STEEL)
        pieces.tube((0, 0, 1.0), (0, 0, height_m), 0.085, _STEEL, end_radius_m=0.055, cap=True)
        for way in ways:
            _add_arm(pieces, height_m, way * reach_m)
        return LampPost(pieces.model(), np.array([(way * reach_m, 0.0, height_m) for way in ways]))
    if kind == "column":
        pieces.tube((0, 0, FOOT_M), (0, 0, height_m - 0.3), 0.06, _STEEL)
        low, high = height_m - 0.05, height_m + 0.03
        pieces.tube((0, 0, height_m - 0.3), (0, 0, low), 0.16, _GLOW, corners=8)
        angle = 2.0 * np.pi * (np.arange(10) + 0.5) / 10
        pieces.prism(np.c_[0.36 * arrays.cos(angle), 0.36 * arrays.sin(angle)], low, high, _STEEL)
        pieces.face(np.c_[0.36 * arrays.cos(-angle), 0.36 * arrays.sin(-angle), np.full(10, low)], _STEEL)
        return LampPost(pieces.model(), np.array([[0.0, 0.0, height_m - 0.15]]))
    pieces.tube((0, 0, FOOT_M), (0, 0, 0.7), 0.13, _IRON, corners=8, end_radius_m=0.10)
    pieces.tube((0, 0, 0.7), (0, 0, height_m - 0.35), 0.06, _IRON, end_radius_m=0.045)
    foot, head = height_m - 0.35, height_m + 0.15
    pieces.tube((0, 0, foot), (0, 0, head), 0.13, _GLOW, end_radius_m=0.23, corners=4)
    pieces.tube((0, 0, head), (0, 0, head + 0.22), 0.27, _IRON, end_radius_m=0.03, corners=4, cap=True)
    return LampPost(pieces.model(), np.array([[0.0, 0.0, height_m - 0.1]]))


def _add_arm(pieces: Pieces, height_m: float, end_m: float) -> None:
    pieces.tube((0, 0, height_m - 0.25), (0.85 * end_m, 0, height_m + 0.06), 0.045, _STEEL, corners=5)
    near, far = sorted((0.8 * end_m, 0.8 * end_m + np.copysign(0.75, end_m)))
    low, high = height_m, height_m + 0.12
    pieces.block((near, -0.16, low), (far, 0.16, high), _STEEL)
    pieces.face(((near, 0.16, low), (far, 0.16, low), (far, -0.16, low), (near, -0.16, low)), _GLOW)
