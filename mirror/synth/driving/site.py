"""What driving and traffic need to know of a scene."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mirror.arrays import Float64
from mirror.synth.driving.trace import HeightField
from mirror.synth.street.network import Network


@dataclass(frozen=True, eq=False)
class Site:
    """A scene as traffic sees it.

    Attributes:
        network: the lanes.
        radius_m: of the ROI, which lies round the origin.
        height_m: the ground.
        bus_stops: (S, 2) where buses stop.
    """

    network: Network
    radius_m: float
    height_m: HeightField
    bus_stops: Float64 = field(default_factory=lambda: np.zeros((0, 2)))


@dataclass(frozen=True)
class Bustle:
    """How much is going on.

    Attributes:
        vehicles: share of the traffic of a busy day.
        people: share of the people on foot and on bicycles.
        umbrellas: whether it rains on them.
        warm: whether they are dressed for summer.
    """

    vehicles: float = 1.0
    people: float = 1.0
    umbrellas: bool = False
    warm: bool = False
