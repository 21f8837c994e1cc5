"""Places houses on a plan's lots."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from mirror.portable import arrays, scalars
from mirror.synth.model import Model
from mirror.synth.seeds import random_stream
from mirror.synth.street.furniture import fence, garden_wall
from mirror.synth.street.houses import HouseStyle, build_house
from mirror.synth.street.lots import Lot
from mirror.synth.street.plan import StreetPlan

Shares = dict[HouseStyle, float]

_STYLES: Final[dict[str, dict[str, Shares]]] = {
    "urban": {
        "front": {"stucco": 0.40, "brick": 0.22, "modern": 0.18, "shophouse": 0.12, "panel": 0.08},
        "corner": {"stucco": 0.50, "brick": 0.25, "modern": 0.25},
        "yard": {"stucco": 0.35, "brick": 0.30, "panel": 0.20, "modern": 0.15},
    },
    "campus": {
        "hall": {"hall": 0.80, "modern": 0.08, "brick": 0.12},
        "yard": {"hall": 0.60, "panel": 0.20, "tower": 0.20},
    },
    "rural": {"farm": {"detached": 0.6, "farm": 0.4}, "yard": {"farm": 0.7, "detached": 0.3}},
    "highway": {"works": {"warehouse": 0.65, "hall": 0.2, "station": 0.15}},
}
"""Shares of the house styles, by kind of scene and kind of lot."""

_DETAIL_RANGE_M: Final = 30.0
"""Houses up to this distance outside the ROI are detailed."""


def build_houses(plan: StreetPlan, seed: int) -> Iterator[Model]:
    """Yield a house for each lot, in the world frame; distant houses have less detail.

    Args:
        plan: plan of the scene.
        seed: seed of all random choices.
    """
    for number, lot in enumerate(plan.lots):
        rng = random_stream("houses", seed, 21, number)
        shares = _STYLES[plan.kind][lot.kind]
        style: HouseStyle = rng.choice(list(shares), p=list(shares.values())).item()
        near = float(arrays.hypot(*lot.origin[:2])) < plan.roi.radius_m + _DETAIL_RANGE_M and lot.kind != "yard"
        model = build_house(
            rng, style, lot.length_m, lot.depth_m, corner=lot.kind != "front", detailed=near or plan.kind != "urban"
        )
        yield _place_house(plan, lot, model)
        if style == "detached" and near:
            yield _front_fence(plan, lot, rng)


def _place_house(plan: StreetPlan, lot: Lot, model: Model) -> Model:
    """A house in the world frame, at the highest ground along its front."""
    along = np.array([scalars.cos(lot.yaw_rad), scalars.sin(lot.yaw_rad)])
    places = lot.origin[:2] + 0.5 * lot.length_m * np.array([[-1.0], [-0.5], [0.0], [0.5], [1.0]]) * along
    height = float(plan.height_m(places[:, 0], places[:, 1]).max())
    return model.place(lot.origin[0], lot.origin[1], height, lot.yaw_rad)


def _front_fence(plan: StreetPlan, lot: Lot, rng: np.random.Generator) -> Model:
    """A fence or wall along the front of a garden, with an opening on one side."""
    along = np.array([scalars.cos(lot.yaw_rad), scalars.sin(lot.yaw_rad)])
    ends = (-0.5, 0.28) if rng.random() < 0.5 else (-0.28, 0.5)
    places = lot.origin[:2] + lot.length_m * np.linspace(*ends, 6)[:, None] * along
    line = np.c_[places, plan.height_m(places[:, 0], places[:, 1])]
    return garden_wall(rng, line, high_m=0.8) if rng.random() < 0.35 else fence(rng, line)
