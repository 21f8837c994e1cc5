"""A straight street of two lanes in either direction, for tests."""

from __future__ import annotations

import numpy as np

from hybridworldsim.simulator.ego.vehicle import VehicleParameters
from hybridworldsim.simulator.street.ground import StreetGround
from hybridworldsim.simulator.street.street import EgoCamera, Street, StreetRecording
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.schema.road_map import MapArea, MapLane, RoadMap
from mirror.schema.scenario import Scenario

LENGTH_M = 400.0
LANE_M = 3.5
EGO_R_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def lane(name: str, y: float, direction: float) -> MapLane:
    x = np.arange(0.0, LENGTH_M + 1.0)[:: int(direction)]
    line = np.column_stack([x, np.full(len(x), y), np.zeros(len(x))])
    neighbours = {"slow": ("fast", None), "fast": (None, "slow")}.get(name, (None, None))
    return MapLane(name, "drive", line, np.full(len(x), LANE_M), 13.9, left=neighbours[0], right=neighbours[1])


def flat(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.zeros(np.shape(x))


def straight_street() -> Street:
    lanes = {
        "slow": lane("slow", -1.5 * LANE_M, 1.0),
        "fast": lane("fast", -0.5 * LANE_M, 1.0),
        "oncoming": lane("oncoming", 0.5 * LANE_M, -1.0),
    }
    outline = np.array([(0.0, -3.0 * LANE_M), (LENGTH_M, -3.0 * LANE_M), (LENGTH_M, 2.0 * LANE_M), (0.0, 2.0 * LANE_M)])
    camera = Camera("pinhole", 96, 54, 60.0, 60.0, 48.0, 27.0)
    mounting = np.eye(4)
    mounting[:3, :3], mounting[:3, 3] = EGO_R_CAMERA, (1.5, 0.0, 1.5)
    rear = np.eye(4)
    rear[:3, :3], rear[:3, 3] = np.diag([-1.0, -1.0, 1.0]) @ EGO_R_CAMERA, (-0.5, 0.0, 1.5)
    times = np.arange(0.0, 20.0, 0.1)
    drive = np.column_stack([50.0 + 8.0 * times, np.full(len(times), -0.5 * LANE_M), np.zeros(len(times))])
    return Street(
        scene_id="straight",
        road_map=RoadMap("straight", None, False, lanes, (MapArea("road", (outline,)),)),
        ground=StreetGround(flat),
        vehicle=VehicleParameters(),
        rig={
            "front_wide": EgoCamera(camera, Poses.from_matrix(mounting)),
            "rear": EgoCamera(camera, Poses.from_matrix(rear)),
        },
        recordings={"drive-1": StreetRecording("drive-1", 1_700_000_000_000_000_000, times, drive, (), "day", "clear")},
        middle_m=(0.5 * LENGTH_M, 0.0),
        radius_m=0.5 * LENGTH_M,
    )


def scenario(*agents: dict, lane: str = "fast", along_m: float = 30.0, **more: object) -> Scenario:
    ego = more.pop("ego", {"speed_mps": 10.0, "start": {"kind": "lane", "lane": lane, "along_m": along_m}})
    return Scenario.model_validate({"name": "test", "duration_s": 8.0, "ego": ego, "agents": list(agents), **more})
