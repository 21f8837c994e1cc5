"""Recording vehicles: seven vehicle types with seven cameras each, and single vehicles of these types."""

from __future__ import annotations

from mirror.synth.rigs.types import VEHICLE_TYPES, VehicleType
from mirror.synth.rigs.vehicle import CameraReadout, Vehicle

__all__ = ["VEHICLE_TYPES", "CameraReadout", "Vehicle", "VehicleType"]
