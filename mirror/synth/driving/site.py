"""The description of a scene for the traffic simulation."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mirror.arrays import Float64
from mirror.traffic.lanes.network import Network
from mirror.traffic.placement.trace import HeightField


@dataclass(frozen=True, eq=False)
class TrafficSite:
    """A scene of the traffic simulation.

    Attributes:
        network: network of lanes.
        radius_m: radius of the ROI, which is centred at the origin.
        height_m: heights of the ground.
        bus_stops: (S, 2) positions of bus stops, metres.
    """

    network: Network
    radius_m: float
    height_m: HeightField
    bus_stops: Float64 = field(default_factory=lambda: np.zeros((0, 2)))


@dataclass(frozen=True)
class TrafficDensity:
    """The density of the traffic.

    Attributes:
        vehicles: density of vehicles, as a share of that of a busy day.
        people: density of pedestrians and cyclists, as a share of that of a busy day.
        umbrellas: whether pedestrians use umbrellas.
        warm: whether people wear summer clothes.
    """

    vehicles: float = 1.0
    people: float = 1.0
    umbrellas: bool = False
    warm: bool = False
