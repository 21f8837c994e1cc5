"""Traffic lights; their lamps are addressed by face index."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Int64
from mirror.portable import arrays
from mirror.synth.model import Finish, Label, Material, Model, Pieces
from mirror.synth.street.furniture.lamps import FOOT_M

_POLE: Final = Finish((0.26, 0.27, 0.27), Material.METAL, Label.POLE)
_CASE: Final = Finish((0.015, 0.016, 0.016), Material.PLAIN, Label.TRAFFIC_LIGHT)
_LAMPS: Final = ((0.95, 0.05, 0.02), (0.95, 0.42, 0.02), (0.04, 0.85, 0.38))
_UP: Final = np.array([0.0, 0.0, 1.0])
_LENS_M: Final = 0.105


@dataclass(frozen=True)
class SignalHead:
    """A traffic light.

    Attributes:
        model: its faces; the front is towards +x.
        red: indices of the red lamps among the model's faces.
        amber: indices of the amber lamps.
        green: indices of the green lamps.
    """

    model: Model
    red: Int64
    amber: Int64
    green: Int64


def traffic_light(reach_m: float = 0.0) -> SignalHead:
    """Build a traffic light on a pole, and optionally a second one on an arm over the road.

    Args:
        reach_m: y of the second light, of either sign; 0: there is no second light.
    """
    pieces = Pieces()
    lamps: list[list[int]] = [[], [], []]
    high = 6.0 if reach_m else 3.35
    pieces.tube((0, 0, FOOT_M), (0, 0, high), 0.085 if reach_m else 0.06, _POLE, cap=True)
    _add_head(pieces, lamps, 0.0, 2.15)
    if reach_m:
        end = reach_m + np.copysign(0.3, reach_m)
        pieces.tube((0, 0, high - 0.2), (0, end, high - 0.05), 0.065, _POLE, end_radius_m=0.045, cap=True)
        _add_head(pieces, lamps, reach_m, 5.0)
    red, amber, green = (np.array(numbers, np.int64) for numbers in lamps)
    return SignalHead(pieces.model(), red, amber, green)


def _add_head(pieces: Pieces, lamps: list[list[int]], y: float, foot_m: float) -> None:
    """Add a case with three hooded lamps in front of the pole or arm."""
    pieces.block((0.07, y - 0.16, foot_m), (0.26, y + 0.16, foot_m + 0.96), _CASE, without=())
    angle = 2.0 * np.pi * (np.arange(10) + 0.5) / 10 - 0.5 * np.pi
    ring = np.c_[np.full(10, 0.265), y + _LENS_M * arrays.cos(angle), _LENS_M * arrays.sin(angle)]
    hood = _CASE._replace(two_sided=True)
    for number, colour in enumerate(_LAMPS):
        middle = foot_m + 0.80 - 0.32 * number
        lens = Finish(colour, Material.SIGNAL, Label.TRAFFIC_LIGHT)
        lamps[number].append(pieces.face(ring + middle * _UP, lens))
        top, out = middle + 0.125, 0.26 + 0.17
        roof = ((out, y - 0.07, top), (out, y + 0.07, top), (0.26, y + 0.07, top), (0.26, y - 0.07, top))
        pieces.face(roof, hood)
        for way in (-1.0, 1.0):
            a, b = y + 0.07 * way, y + 0.13 * way
            low = middle - 0.02
            pieces.face(((out, a, top), (0.26, a, top), (0.26, b, low), (out - 0.05, b, low)), hood)
