"""A bridge over a motorway, with the embankments that lead up to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
import shapely

from mirror.arrays import Float64
from mirror.synth.model import Label, Material, Model, block, merge_models, polygon
from mirror.synth.roads.crossing import CrossedStreet
from mirror.synth.roads.section import COUNTRY_ROAD

_RISE_M: Final = 6.5
_DECK_M: Final = 1.0
_HALF_M: Final = 4.6
_CLEAR_M: Final = 4.0
_BACK_M: Final = 8.0
_FALL_M: Final = 120.0
_BELOW_M: Final = 4.0
_FRONT: Final = 1.5
_SIDE: Final = 1.8
_GREY: Final = (0.33, 0.33, 0.32)
_PALE: Final = (0.40, 0.40, 0.39)
_STEEL: Final = (0.20, 0.23, 0.23)
_GRASS: Final = (0.090, 0.130, 0.042)


@dataclass(frozen=True)
class Overbridge:
    """A bridge over a street, with its embankments.

    Attributes:
        model: faces of the bridge and its embankments, which reach below the ground.
        outline: area of land that they occupy.
    """

    model: Model
    outline: shapely.Geometry


def build_overbridge(street: CrossedStreet, station_m: float, height_m: float) -> Overbridge:
    """Build a bridge at right angles over a street.

    Args:
        street: the street below.
        station_m: station of the street at the bridge.
        height_m: height of the street's middle there.
    """
    span = street.section.half_m + _CLEAR_M + _BACK_M
    parts = [
        block((0.0, 0.0, _RISE_M - 0.5 * _DECK_M), (2.0 * span, 2.0 * _HALF_M - 0.8, _DECK_M), _GREY, Material.CONCRETE,
              Label.WALL, without=()),
        *(
            block((0.0, side * (_HALF_M - 0.2), _RISE_M), (2.0 * span, 0.5, 0.55), _PALE, Material.CONCRETE, Label.WALL,
                  without=())
            for side in (1, -1)
        ),
        *(
            block((0.0, side * (_HALF_M - 0.2), _RISE_M + 0.27 + up), (2.0 * span, 0.08, 0.10), _STEEL, Material.METAL,
                  Label.FURNITURE, without=())
            for side in (1, -1) for up in (0.3, 0.6, 0.9)
        ),
        *(
            block((x, 0.0, 0.5 * (_RISE_M - _DECK_M) - 0.5), (0.9, 5.4, _RISE_M - _DECK_M + 1.0), _PALE,
                  Material.CONCRETE, Label.WALL)
            for x in (0.0, span - _BACK_M - 2.3, _BACK_M + 2.3 - span)
        ),
        *(_build_embankment(span).place(0.0, 0.0, 0.0, turn) for turn in (0.0, np.pi)),
    ]  # fmt: skip
    x, y = street.line.at(station_m)
    yaw = float(street.line.heading(station_m)) + 0.5 * np.pi
    model = merge_models(parts).place(float(x), float(y), height_m, yaw)
    low = model.corners[model.corners[:, 2] < height_m - 1.5]
    return Overbridge(model, shapely.convex_hull(shapely.multipoints(low[:, :2])))


def _build_embankment(span_m: float) -> Model:
    """The embankment on the +x side of a bridge over the origin; its crest descends evenly to below the ground."""
    high, low = _RISE_M, -_BELOW_M
    end = span_m + _FALL_M * (high - low) / high
    foot_x, foot_y = span_m - _FRONT * (high - low), _HALF_M + _SIDE * (high - low)
    half = COUNTRY_ROAD.half_m

    def crest(right_m: float, left_m: float) -> npt.ArrayLike:
        return [(span_m, right_m, high), (end, right_m, low), (end, left_m, low), (span_m, left_m, high)]

    def grass(corners: npt.ArrayLike) -> Model:
        return polygon(corners, _GRASS, Material.GRASS, Label.TERRAIN, seed=5)

    near: Float64 = np.array([(span_m, side * _HALF_M, high) for side in (-1.0, 1.0)])
    foot: Float64 = np.array([(foot_x, side * foot_y, low) for side in (-1.0, 1.0)])
    far: Float64 = np.array([(end, side * _HALF_M, low) for side in (-1.0, 1.0)])
    return merge_models(
        [
            polygon(crest(-half, half), COUNTRY_ROAD.colour, Material.ASPHALT, Label.ROAD, seed=9),
            grass(crest(-_HALF_M, -half)),
            grass(crest(half, _HALF_M)),
            grass([near[0], near[1], foot[1], foot[0]]),
            grass([near[0], foot[0], far[0]]),
            grass([near[1], far[1], foot[1]]),
        ]
    )
