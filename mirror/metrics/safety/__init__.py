"""Safety of a drive: functions of a log of states, whoever made it; no simulator is needed."""

from __future__ import annotations

from mirror.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from mirror.metrics.safety.collisions import Collision as Collision
    from mirror.metrics.safety.collisions import CollisionKind as CollisionKind
    from mirror.metrics.safety.collisions import find_collisions as find_collisions
    from mirror.metrics.safety.comfort import COMFORT_BOUNDS as COMFORT_BOUNDS
    from mirror.metrics.safety.comfort import Comfort as Comfort
    from mirror.metrics.safety.comfort import measure_comfort as measure_comfort
    from mirror.metrics.safety.drivable_area import DrivableAreaCompliance as DrivableAreaCompliance
    from mirror.metrics.safety.drivable_area import drivable_area_compliance as drivable_area_compliance
    from mirror.metrics.safety.drivable_area import inside_area as inside_area
    from mirror.metrics.safety.driving_score import DrivingScore as DrivingScore
    from mirror.metrics.safety.lanes import LanePositions as LanePositions
    from mirror.metrics.safety.lanes import RedLight as RedLight
    from mirror.metrics.safety.lanes import find_red_lights as find_red_lights
    from mirror.metrics.safety.lanes import locate_on_lanes as locate_on_lanes
    from mirror.metrics.safety.motion_bounds import ImpossibleMotion as ImpossibleMotion
    from mirror.metrics.safety.motion_bounds import find_impossible_motion as find_impossible_motion
    from mirror.metrics.safety.presets import NavsimTimeToCollision as NavsimTimeToCollision
    from mirror.metrics.safety.presets import NuplanTimeToCollision as NuplanTimeToCollision
    from mirror.metrics.safety.presets import collisions_at_stamps as collisions_at_stamps
    from mirror.metrics.safety.presets import navsim_time_to_collision as navsim_time_to_collision
    from mirror.metrics.safety.presets import nuplan_time_to_collision as nuplan_time_to_collision
    from mirror.metrics.safety.progress import Progress as Progress
    from mirror.metrics.safety.progress import route_progress as route_progress
    from mirror.metrics.safety.report import FIGURES as FIGURES
    from mirror.metrics.safety.report import SafetyFigure as SafetyFigure
    from mirror.metrics.safety.report import SafetyReport as SafetyReport
    from mirror.metrics.safety.report import score_rollout as score_rollout
    from mirror.metrics.safety.same_states import find_difference as find_difference
    from mirror.metrics.safety.state_file import StateLogWriter as StateLogWriter
    from mirror.metrics.safety.state_file import read_state_log as read_state_log
    from mirror.metrics.safety.state_file import write_state_log as write_state_log
    from mirror.metrics.safety.state_log import StateLog as StateLog
    from mirror.metrics.safety.ttc import LeastTimeToCollision as LeastTimeToCollision
    from mirror.metrics.safety.ttc import least_time_to_collision as least_time_to_collision
    from mirror.metrics.safety.ttc import time_to_collision as time_to_collision

__all__ = [
    "COMFORT_BOUNDS",
    "FIGURES",
    "Collision",
    "CollisionKind",
    "Comfort",
    "DrivableAreaCompliance",
    "DrivingScore",
    "ImpossibleMotion",
    "LanePositions",
    "LeastTimeToCollision",
    "NavsimTimeToCollision",
    "NuplanTimeToCollision",
    "Progress",
    "RedLight",
    "SafetyFigure",
    "SafetyReport",
    "StateLog",
    "StateLogWriter",
    "collisions_at_stamps",
    "drivable_area_compliance",
    "find_collisions",
    "find_difference",
    "find_impossible_motion",
    "find_red_lights",
    "inside_area",
    "least_time_to_collision",
    "locate_on_lanes",
    "measure_comfort",
    "navsim_time_to_collision",
    "nuplan_time_to_collision",
    "read_state_log",
    "route_progress",
    "score_rollout",
    "time_to_collision",
    "write_state_log",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "COMFORT_BOUNDS": "mirror.metrics.safety.comfort",
        "Collision": "mirror.metrics.safety.collisions",
        "CollisionKind": "mirror.metrics.safety.collisions",
        "Comfort": "mirror.metrics.safety.comfort",
        "DrivableAreaCompliance": "mirror.metrics.safety.drivable_area",
        "DrivingScore": "mirror.metrics.safety.driving_score",
        "FIGURES": "mirror.metrics.safety.report",
        "ImpossibleMotion": "mirror.metrics.safety.motion_bounds",
        "LanePositions": "mirror.metrics.safety.lanes",
        "LeastTimeToCollision": "mirror.metrics.safety.ttc",
        "NavsimTimeToCollision": "mirror.metrics.safety.presets",
        "NuplanTimeToCollision": "mirror.metrics.safety.presets",
        "Progress": "mirror.metrics.safety.progress",
        "RedLight": "mirror.metrics.safety.lanes",
        "SafetyFigure": "mirror.metrics.safety.report",
        "SafetyReport": "mirror.metrics.safety.report",
        "StateLog": "mirror.metrics.safety.state_log",
        "StateLogWriter": "mirror.metrics.safety.state_file",
        "collisions_at_stamps": "mirror.metrics.safety.presets",
        "drivable_area_compliance": "mirror.metrics.safety.drivable_area",
        "find_collisions": "mirror.metrics.safety.collisions",
        "find_difference": "mirror.metrics.safety.same_states",
        "find_impossible_motion": "mirror.metrics.safety.motion_bounds",
        "find_red_lights": "mirror.metrics.safety.lanes",
        "inside_area": "mirror.metrics.safety.drivable_area",
        "least_time_to_collision": "mirror.metrics.safety.ttc",
        "locate_on_lanes": "mirror.metrics.safety.lanes",
        "measure_comfort": "mirror.metrics.safety.comfort",
        "navsim_time_to_collision": "mirror.metrics.safety.presets",
        "nuplan_time_to_collision": "mirror.metrics.safety.presets",
        "read_state_log": "mirror.metrics.safety.state_file",
        "route_progress": "mirror.metrics.safety.progress",
        "score_rollout": "mirror.metrics.safety.report",
        "time_to_collision": "mirror.metrics.safety.ttc",
        "write_state_log": "mirror.metrics.safety.state_file",
    },
)
