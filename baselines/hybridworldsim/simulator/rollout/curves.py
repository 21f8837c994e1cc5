"""Curves of a drive in the simulator: those of its states, and those that only the vehicle knows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybridworldsim.simulator.ego.vehicle import EgoState
from mirror.evaluation.drive_curves import DriveCurve, contact_curve, gap_curve, margin_curve
from mirror.metrics.safety import StateLog
from mirror.schema.road_map import RoadMap


def list_curves(log: StateLog, egos: Sequence[EgoState], road_map: RoadMap) -> list[DriveCurve]:
    """List the curves of a drive.

    Args:
        log: states of the ego and the agents.
        egos: the T states of the ego, with its acceleration and its steering.
        road_map: the map, in the frame of the log.
    """
    speeds, accelerations = ([getattr(ego, name) for ego in egos] for name in ("speed_mps", "acceleration_mps2"))
    steering = np.degrees([ego.steering_rad for ego in egos])
    return [
        DriveCurve("Speed", "m/s", "forward, of the rear axle", np.array(speeds)),
        DriveCurve("Acceleration", "m/s²", "forward; negative: braking", np.array(accelerations), 2),
        DriveCurve("Steering", "°", "angle of the front wheels; positive: to the left", steering),
        gap_curve(log),
        contact_curve(log),
        margin_curve(log, road_map),
    ]
