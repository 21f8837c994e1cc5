"""The design of one camera of a rig: lens, sensor, position and direction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.geometry import Poses, quaternion_from_matrix
from mirror.geometry.cameras import Camera
from mirror.portable import arrays, scalars

_EGO_R_CAMERA: Final = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class SensorRaster:
    """The raster of a sensor.

    Attributes:
        share: width as a share of the preset's image width.
        aspect: width divided by height.
    """

    share: float
    aspect: float

    def size_px(self, width_px: int) -> tuple[int, int]:
        """Return width and height in pixels, both even, for a preset's image width."""
        width = max(2 * round(0.5 * self.share * width_px), 2)
        return width, max(2 * round(0.5 * width / self.aspect), 2)


@dataclass(frozen=True)
class Optics:
    """A lens, independent of the sensor.

    Attributes:
        model: name of the camera model.
        view_deg: horizontal angle of view over the full width of the sensor.
        distortion: coefficients of the model; for ``f_theta`` in units of the focal length, with ``c1`` = 1.
    """

    model: str
    view_deg: float
    distortion: tuple[float, ...] = ()

    def camera(self, raster: SensorRaster, width_px: int) -> Camera:
        """Return the camera of this lens and a sensor at a preset's image width; the optical axis is in the middle."""
        width, height = raster.size_px(width_px)
        half = math.radians(self.view_deg / 2.0)
        unit = Camera(self.model, 2, 2, 1.0, 1.0, 0.0, 0.0, self.distortion)
        edge = float(unit.project([scalars.sin(half), 0.0, scalars.cos(half)]).uv_px[0])
        focal = 0.5 * width / edge
        if self.model == "f_theta":
            scaled = tuple(focal * value for value in self.distortion)
            return Camera(self.model, width, height, 1.0, 1.0, 0.5 * width, 0.5 * height, scaled)
        return Camera(self.model, width, height, focal, focal, 0.5 * width, 0.5 * height, self.distortion)


@dataclass(frozen=True)
class Mount:
    """The design of one camera.

    Attributes:
        camera: canonical camera name.
        optics: lens of the camera.
        raster: sensor of the camera.
        place_m: position in the ego frame.
        yaw_deg: yaw of the optical axis, positive to the left of forward.
        pitch_deg: pitch of the optical axis, positive upwards.
    """

    camera: str
    optics: Optics
    raster: SensorRaster
    place_m: tuple[float, float, float]
    yaw_deg: float
    pitch_deg: float

    def ego_SE3_camera(self) -> Poses:  # noqa: N802
        """Return the pose of the camera in the ego frame."""
        yaw, pitch = math.radians(self.yaw_deg), math.radians(self.pitch_deg)
        cos, sin, up_cos, up_sin = scalars.cos(yaw), scalars.sin(yaw), scalars.cos(pitch), scalars.sin(pitch)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        tilt = np.array([[up_cos, 0.0, -up_sin], [0.0, 1.0, 0.0], [up_sin, 0.0, up_cos]])
        return Poses(
            quaternion_from_matrix((arrays.matmul(arrays.matmul(turn, tilt), _EGO_R_CAMERA))[None]),
            np.array([self.place_m]),
        )
