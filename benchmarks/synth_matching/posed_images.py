"""Images of the synthetic street with their truth, for feature matching and bundle adjustment."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float32, Float64, Int64, UInt8
from mirror.geometry import Poses, matrix_from_quaternion
from mirror.geometry.cameras import Camera
from mirror.recordings.light import Light
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.fleet.drives import make_drives
from mirror.synth.light.condition import Condition, Weather
from mirror.synth.light.sun import instant_of
from mirror.synth.model import Label
from mirror.synth.rigs import VEHICLE_TYPES, Vehicle
from mirror.traffic.placement.trace import TraceMotion

SKY_M: Final = 1e6
"""Assumed distance of the sky."""


@dataclass(frozen=True, eq=False)
class PosedImage:
    """An image with its truth.

    Attributes:
        bgr: (H, W, 3) pixels.
        camera: the true lens.
        world_SE3_camera: the true pose, one.
        distance_m: (H, W) distances along the rays of the pixel centres, infinite for the sky.
        normal: (H, W, 3) normals of the surfaces, world frame.
        is_static: (H, W) whether the pixel is static: neither a moving road user nor the recording vehicle.
    """

    bgr: UInt8
    camera: Camera
    world_SE3_camera: Poses
    distance_m: Float32
    normal: Float32
    is_static: Bool

    @property
    def origin(self) -> Float64:
        """Position (3,) of the camera, world metres."""
        return self.world_SE3_camera.translation[0]

    def pixels(self, uv_px: Float64) -> tuple[Int64, Int64]:
        """Return the rows and columns (N,) of the pixels that contain points (N, 2) of the image."""
        column = np.clip(np.floor(uv_px[:, 0]), 0, self.camera.width_px - 1).astype(np.int64)
        row = np.clip(np.floor(uv_px[:, 1]), 0, self.camera.height_px - 1).astype(np.int64)
        return row, column

    def rays(self, uv_px: Float64) -> Float64:
        """Return the unit directions (N, 3) of points of the image, world frame."""
        return self.camera.unproject(uv_px).direction @ matrix_from_quaternion(self.world_SE3_camera.rotation)[0].T

    def points(self, uv_px: Float64) -> Float64:
        """Return the world points (N, 3) of points (N, 2) of the image, on the surface at the centre of the pixel."""
        row, column = self.pixels(uv_px)
        centre = self.rays(np.stack([column, row], axis=1).astype(np.float64) + 0.5)
        ray, normal = self.rays(uv_px), self.normal[row, column].astype(np.float64)
        distance, sky = self.distance_m[row, column].astype(np.float64), ~normal.any(axis=1)
        distance[sky], normal[sky] = SKY_M, ray[sky]
        distance *= np.vecdot(normal, centre) / np.vecdot(normal, ray)
        return self.origin + distance[:, None] * ray

    def image_of(self, points: Float64) -> Float64:
        """Return the projections (N, 2) of world points (N, 3); NaN where undefined."""
        return self.camera.project(self.world_SE3_camera.inverse().transform(points)[0]).uv_px


def urban_drive(
    route: str,
    light: Light = "day",
    weather: Weather = "clear",
    *,
    date: str = "2025-05-14",
    vehicle: str = "saloon",
    width_px: int = 960,
    visit: int = 0,
) -> SynthDrive:
    """Make a drive through the urban scene of the preset ``benchmark``.

    Args:
        route: name of the route.
        light: light of the drive.
        weather: weather of the drive.
        date: date of the drive.
        vehicle: vehicle type; always the same vehicle of that type.
        width_px: width of an image with share 1.
        visit: index of the visit; it changes traffic, leaves and billboards.
    """
    preset, drives = make_drives("benchmark", 0, scenes=1)
    drive = next(one for one in drives if one.recipe.route == route)
    roi = drive.roi
    start = instant_of(date, light, roi.longitude_deg or 0.0, roi.latitude_deg or 0.0)
    return replace(
        drive,
        drive_id=f"{route}-{light}-{weather}-{visit}",
        preset=replace(preset, width_px=width_px),
        recipe=replace(drive.recipe, date=date, light=light, weather=weather, vehicle=vehicle),
        vehicle=Vehicle(f"vehicle-{vehicle}", VEHICLE_TYPES[vehicle], width_px, 7),
        condition=Condition(start, light, weather, visit=visit),
        seed=drive.seed + visit,
    )


def render_frames(drive: SynthDrive, instants_ns: Int64, cameras: Sequence[str]) -> list[dict[str, PosedImage]]:
    """Render images of a drive by some cameras at some instants."""
    drive.prepare()
    moving = [number for number, user in enumerate(drive.road_users) if isinstance(user.motion, TraceMotion)]

    def render_frame(instant_ns: int) -> dict[str, PosedImage]:
        instant, images = drive.at(instant_ns), {}
        for name in cameras:
            image = drive.render(name, instant_ns, instant)
            view = image.view
            images[name] = PosedImage(
                image.bgr,
                drive.vehicle.cameras[name],
                drive.world_SE3_camera(name, np.array([instant_ns])),
                view.distance_m,
                view.normal,
                ~((view.label == Label.EGO) | np.isin(view.object, moving)),
            )
        return images

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(render_frame, instants_ns.tolist()))
