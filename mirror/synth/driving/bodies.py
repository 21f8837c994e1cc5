"""The bodies of road users: a fixed population of each kind, so that each body is built only once."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np

from mirror.synth.road_users.body import Body
from mirror.traffic.following.participants import KINDS, Kind

POPULATION: Final[dict[Kind, int]] = {
    "car": 96, "van": 24, "truck": 16, "bus": 8, "motorcycle": 8, "cyclist": 20, "pedestrian": 64,
}  # fmt: skip
"""Number of different bodies of each kind."""

_CHILD: Final = 0.12


@lru_cache(maxsize=1024)
def get_body(kind: Kind, number: int, umbrella: bool = False, warm: bool = False) -> Body:
    """Return one body of the population.

    Args:
        kind: kind of road user.
        number: index in the population of that kind.
        umbrella: whether a pedestrian holds an umbrella.
        warm: whether people wear summer clothes.
    """
    rng = np.random.default_rng([7, KINDS.index(kind), number])
    if kind == "pedestrian":
        from mirror.synth.road_users.people import draw_pedestrian

        return draw_pedestrian(rng, child=rng.random() < _CHILD, umbrella=umbrella, warm=warm)
    if kind == "car":
        from mirror.synth.road_users.cars import build_car

        return build_car(rng)
    if kind == "van":
        from mirror.synth.road_users.vans import build_van

        return build_van(rng)
    if kind == "truck":
        from mirror.synth.road_users.trucks import build_truck

        return build_truck(rng)
    if kind == "bus":
        from mirror.synth.road_users.buses import build_bus

        return build_bus(rng)
    from mirror.synth.road_users.two_wheelers import build_bicycle, build_motorcycle

    return build_motorcycle(rng) if kind == "motorcycle" else build_bicycle(rng)
