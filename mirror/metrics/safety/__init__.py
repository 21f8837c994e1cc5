"""Safety of a drive: functions of a log of states, whoever made it; no simulator is needed."""

from __future__ import annotations

from mirror.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from mirror.metrics.safety.collisions import Collision as Collision
    from mirror.metrics.safety.collisions import CollisionKind as CollisionKind
    from mirror.metrics.safety.collisions import find_collisions as find_collisions
    from mirror.metrics.safety.drivable_area import DrivableAreaCompliance as DrivableAreaCompliance
    from mirror.metrics.safety.drivable_area import drivable_area_compliance as drivable_area_compliance
    from mirror.metrics.safety.drivable_area import inside_area as inside_area
    from mirror.metrics.safety.state_file import StateLogWriter as StateLogWriter
    from mirror.metrics.safety.state_file import read_state_log as read_state_log
    from mirror.metrics.safety.state_file import write_state_log as write_state_log
    from mirror.metrics.safety.state_log import StateLog as StateLog
    from mirror.metrics.safety.ttc import LeastTimeToCollision as LeastTimeToCollision
    from mirror.metrics.safety.ttc import least_time_to_collision as least_time_to_collision
    from mirror.metrics.safety.ttc import time_to_collision as time_to_collision

__all__ = [
    "Collision",
    "CollisionKind",
    "DrivableAreaCompliance",
    "LeastTimeToCollision",
    "StateLog",
    "StateLogWriter",
    "drivable_area_compliance",
    "find_collisions",
    "inside_area",
    "least_time_to_collision",
    "read_state_log",
    "time_to_collision",
    "write_state_log",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Collision": "mirror.metrics.safety.collisions",
        "CollisionKind": "mirror.metrics.safety.collisions",
        "DrivableAreaCompliance": "mirror.metrics.safety.drivable_area",
        "LeastTimeToCollision": "mirror.metrics.safety.ttc",
        "StateLog": "mirror.metrics.safety.state_log",
        "StateLogWriter": "mirror.metrics.safety.state_file",
        "drivable_area_compliance": "mirror.metrics.safety.drivable_area",
        "find_collisions": "mirror.metrics.safety.collisions",
        "inside_area": "mirror.metrics.safety.drivable_area",
        "least_time_to_collision": "mirror.metrics.safety.ttc",
        "read_state_log": "mirror.metrics.safety.state_file",
        "time_to_collision": "mirror.metrics.safety.ttc",
        "write_state_log": "mirror.metrics.safety.state_file",
    },
)
