"""A served street, and requests to it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from hybridworldsim.simulator.agents.replay import RecordedTrack
from hybridworldsim.simulator.agents.states import Agent
from hybridworldsim.simulator.remote.lenses import to_spec
from hybridworldsim.simulator.remote.messages import wire
from hybridworldsim.simulator.remote.poses import to_flat_pose, to_pose
from hybridworldsim.simulator.remote.scenes import open_scenes
from hybridworldsim.simulator.remote.service import Limits, SensorService
from hybridworldsim.simulator.renderers.boxes import COLOURS
from hybridworldsim.simulator.renderers.registry import RendererFactory
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from tests.simulator.streets import EGO_R_CAMERA, straight_street

CALLS = {
    "get_version": ("Empty", "VersionId"),
    "get_available_scenes": ("Empty", "AvailableScenesReturn"),
    "get_available_cameras": ("AvailableCamerasRequest", "AvailableCamerasReturn"),
    "get_available_ego_masks": ("Empty", "AvailableEgoMasksReturn"),
    "render_rgb": ("RGBRenderRequest", "RGBRenderReturn"),
    "batch_render_rgb": ("BatchRGBRenderRequest", "BatchRGBRenderReturn"),
}


def service(limits: Limits | None = None) -> SensorService:
    street = straight_street()
    track = RecordedTrack(Agent("car-1", "car", (4.5, 1.9, 1.5)), np.zeros(1), np.zeros((1, 3)))
    street = replace(street, recordings={"drive-1": replace(street.recordings["drive-1"], tracks=(track,))})
    return SensorService(open_scenes(street, RendererFactory("boxes")), limits)


def sensor_pose(x: float = 100.0, y: float = -1.75) -> object:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = EGO_R_CAMERA, (x, y, 1.5)
    return to_pose(Poses.from_matrix(matrix))


def pair(start: object, end: object | None = None) -> object:
    return wire().PosePair(start_pose=start, end_pose=end or start)


def request(camera: Camera | None = None, **more: object) -> object:
    chosen = camera or Camera("pinhole", 320, 200, 160.0, 160.0, 160.0, 100.0)
    fields = {
        "scene_id": "drive-1", "camera_intrinsics": to_spec(chosen, "any"), "frame_start_us": 1_700_000_000_000_000,
        "frame_end_us": 1_700_000_000_010_000, "sensor_pose": pair(sensor_pose()), "image_format": 1,
    }  # fmt: skip
    return wire().RGBRenderRequest(**{**fields, **more})


def car_at(x: float, y: float, yaw: float = 0.0) -> object:
    return wire().DynamicObject(track_id="car-1", pose_pair=pair(to_flat_pose(x, y, yaw)))


def pixels(data: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


def is_car(image: np.ndarray) -> np.ndarray:
    return np.abs(image.astype(int) - COLOURS["car"]).sum(axis=2) < 120
