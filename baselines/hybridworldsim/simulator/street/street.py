"""A street to drive in: its map, ground and rig, and what was recorded in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np
import shapely

from hybridworldsim.simulator.agents.replay import RecordedTrack
from hybridworldsim.simulator.ego.vehicle import VehicleParameters
from hybridworldsim.simulator.street.ground import StreetGround
from mirror.arrays import Bool, Float64
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.geometry.rolling_shutter import RollingShutter
from mirror.schema.documents import Roi
from mirror.schema.road_features import SignalState
from mirror.schema.road_map import RoadMap
from mirror.schema.rollout import MapSource

if TYPE_CHECKING:
    from mirror.synth import SynthDrive

_BESIDE_M: Final = 2.0
"""Half of a lane and a little more: a recorded line so near is one in the same lane."""


@dataclass(frozen=True, eq=False)
class EgoCamera:
    """One camera of the ego vehicle.

    Attributes:
        camera: its lens and raster.
        ego_SE3_camera: its mounting.
        shutter: its shutter; None: all of an image is exposed at one instant.
    """

    camera: Camera
    ego_SE3_camera: Poses
    shutter: RollingShutter | None = None


@dataclass(frozen=True, eq=False)
class StreetRecording:
    """One recorded traversal of the street.

    Attributes:
        traversal_id: its id.
        start_ns: Unix time of its beginning.
        times_s: (T,) times since then.
        poses: (T, 3) x, y of the rear axle, and yaw.
        tracks: the recorded road users.
        light: light condition.
        weather: weather condition.
    """

    traversal_id: str
    start_ns: int
    times_s: Float64
    poses: Float64
    tracks: tuple[RecordedTrack, ...]
    light: str
    weather: str


@dataclass(frozen=True, eq=False)
class Street:
    """A street to drive in.

    Attributes:
        scene_id: the scene.
        road_map: its map.
        ground: its ground.
        vehicle: the ego vehicle.
        rig: its cameras by name.
        recordings: recorded traversals, by id; at least one.
        middle_m: (x, y) middle of the part that can be rendered.
        radius_m: radius of that part.
        clock_s: time of the signals' clock at the start of a rollout.
        roi: the region of interest, whose position on the earth sets the sun; None: not known.
        drive: the drive of the synthetic street that gives the exact world; None: the exact world is not known.
        map_source: where the map is from; None: not stated.
    """

    scene_id: str
    road_map: RoadMap
    ground: StreetGround
    vehicle: VehicleParameters
    rig: Mapping[str, EgoCamera]
    recordings: Mapping[str, StreetRecording]
    middle_m: tuple[float, float]
    radius_m: float
    clock_s: float = 0.0
    roi: Roi | None = None
    drive: SynthDrive | None = field(default=None, repr=False)
    map_source: MapSource | None = None

    def signals(self, time_s: float) -> dict[str, SignalState]:
        """Return the states of the signals whose phases are known, by id, at a time since the start."""
        states = {
            name: signal.state_at(self.clock_s + time_s) for name, signal in sorted(self.road_map.signals.items())
        }
        return {name: state for name, state in states.items() if state is not None}

    def is_inside(self, points_m: Float64) -> Bool:
        """Mark the points (N, 2) that lie in the part of the street that can be rendered."""
        return np.hypot(*(points_m - np.array(self.middle_m)).T) <= self.radius_m

    def is_driven(self, points_m: Float64) -> Bool:
        """Mark the points (N, 2) in the part of the street that can be rendered, and beside a recorded line."""
        lines = shapely.MultiLineString([one.poses[:, :2] for one in self.recordings.values() if len(one.poses) > 1])
        return self.is_inside(points_m) & (shapely.distance(lines, shapely.points(points_m)) <= _BESIDE_M)
