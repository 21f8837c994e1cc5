"""Safety of a drive: functions of a log of states, whoever made it; no simulator is needed."""

from __future__ import annotations

from mirror.metrics.safety.collisions import Collision as Collision
from mirror.metrics.safety.collisions import CollisionKind as CollisionKind
from mirror.metrics.safety.collisions import find_collisions as find_collisions
from mirror.metrics.safety.drivable_area import DrivableAreaCompliance as DrivableAreaCompliance
from mirror.metrics.safety.drivable_area import drivable_area_compliance as drivable_area_compliance
from mirror.metrics.safety.drivable_area import inside_area as inside_area
from mirror.metrics.safety.state_log import StateLog as StateLog
from mirror.metrics.safety.time_to_collision import LeastTimeToCollision as LeastTimeToCollision
from mirror.metrics.safety.time_to_collision import least_time_to_collision as least_time_to_collision
from mirror.metrics.safety.time_to_collision import time_to_collision as time_to_collision
