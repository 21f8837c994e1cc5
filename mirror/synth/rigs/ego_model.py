"""The parts of a recording vehicle that its own cameras see: the bonnet of a car, the flanks of a larger vehicle."""

from __future__ import annotations

from mirror.synth.model import Model
from mirror.synth.rigs.types import VehicleType
from mirror.synth.road_users.ego import Measures, make_ego_body


def make_ego_model(kind: VehicleType) -> Model:
    """Build the parts of a vehicle that its own cameras can see, in the ego frame."""
    size = kind.size
    return make_ego_body(kind.name, Measures(size.length_m, size.width_m, size.height_m, size.wheelbase_m, size.rear_m))
