"""One camera of a rig as it was designed: lens, raster, place and direction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.geometry import Poses, quaternion_from_matrix
from mirror.geometry.cameras import Camera

_EGO_R_CAMERA: Final = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class Raster:
    """A sensor.

    Attributes:
        share: its width, as a share of the preset's.
        aspect: width over height.
    """

    share: float
    aspect: float

    def size_px(self, width_px: int) -> tuple[int, int]:
        """Width and height, both even, for a preset's width."""
        width = max(2 * round(0.5 * self.share * width_px), 2)
        return width, max(2 * round(0.5 * width / self.aspect), 2)


@dataclass(frozen=True)
class Optics:
    """A lens, whatever sensor is behind it.

    Attributes:
        model: camera model.
        view_deg: horizontal angle of view, which fills the sensor's width.
        distortion: the model's coefficients; of ``f_theta``: in focal lengths, ``c1`` = 1.
    """

    model: str
    view_deg: float
    distortion: tuple[float, ...] = ()

    def camera(self, raster: Raster, width_px: int) -> Camera:
        """The camera that it makes with a sensor at a preset's width, its axis in the middle."""
        width, height = raster.size_px(width_px)
        half = math.radians(self.view_deg / 2.0)
        unit = Camera(self.model, 2, 2, 1.0, 1.0, 0.0, 0.0, self.distortion)
        edge = float(unit.project([math.sin(half), 0.0, math.cos(half)]).uv_px[0])
        focal = 0.5 * width / edge
        if self.model == "f_theta":
            scaled = tuple(focal * value for value in self.distortion)
            return Camera(self.model, width, height, 1.0, 1.0, 0.5 * width, 0.5 * height, scaled)
        return Camera(self.model, width, height, focal, focal, 0.5 * width, 0.5 * height, self.distortion)


@dataclass(frozen=True)
class Mount:
    """One camera.

    Attributes:
        camera: canonical name.
        optics: its lens.
        raster: its sensor.
        place_m: in the ego frame.
        yaw_deg: of the optical axis, to the left of forward.
        pitch_deg: of the optical axis, upwards.
    """

    camera: str
    optics: Optics
    raster: Raster
    place_m: tuple[float, float, float]
    yaw_deg: float
    pitch_deg: float

    def ego_SE3_camera(self) -> Poses:  # noqa: N802
        """Its pose."""
        yaw, pitch = math.radians(self.yaw_deg), math.radians(self.pitch_deg)
        cos, sin, up_cos, up_sin = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        tilt = np.array([[up_cos, 0.0, -up_sin], [0.0, 1.0, 0.0], [up_sin, 0.0, up_cos]])
        return Poses(quaternion_from_matrix((turn @ tilt @ _EGO_R_CAMERA)[None]), np.array([self.place_m]))
