"""Vehicle types with seven cameras: lenses, mounting, and what the factory and the vehicle itself believe of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np

from mirror.arrays import Float64, Records
from mirror.geometry import Poses, quaternion_from_matrix
from mirror.geometry.cameras import Camera
from mirror.schema.documents import CANONICAL_CAMERAS
from mirror.synth.render.primitives import PAINT, solid

Stage = Literal["factory", "online"]

ERROR_DEG: Final[dict[Stage, float]] = {"factory": 0.25, "online": 0.04}
"""1-sigma of the rotation about each axis that a stage's mounting is off the truth."""
ERROR_M: Final[dict[Stage, float]] = {"factory": 0.010, "online": 0.004}
_INSTALLED_DEG: Final = 0.4
_EGO_R_CAMERA: Final = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class Mount:
    """One camera as designed.

    Attributes:
        camera: canonical name.
        model: camera model.
        view_deg: horizontal angle of view.
        place_m: in the ego frame.
        yaw_deg: of the optical axis, to the left of forward.
        pitch_deg: of the optical axis, upwards.
        distortion: the model's coefficients.
    """

    camera: str
    model: str
    view_deg: float
    place_m: tuple[float, float, float]
    yaw_deg: float
    pitch_deg: float = 0.0
    distortion: tuple[float, ...] = ()

    def lens(self, width_px: int, height_px: int) -> Camera:
        """The camera at a resolution: the angle of view fills the width."""
        half = math.radians(self.view_deg / 2.0)
        edge = half if self.model == "kannala_brandt" else math.tan(half)
        powers = (self.distortion[0], self.distortion[1]) if self.distortion else (0.0, 0.0)
        edge *= 1.0 + powers[0] * edge**2 + powers[1] * edge**4
        focal = 0.5 * width_px / edge
        centre = 0.5 * width_px, 0.5 * height_px
        return Camera(self.model, width_px, height_px, focal, focal, *centre, self.distortion)

    def ego_SE3_camera(self) -> Poses:  # noqa: N802
        """The mounting."""
        yaw, pitch = math.radians(self.yaw_deg), math.radians(self.pitch_deg)
        cos, sin, up_cos, up_sin = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        tilt = np.array([[up_cos, 0.0, -up_sin], [0.0, 1.0, 0.0], [up_sin, 0.0, up_cos]])
        return Poses(quaternion_from_matrix((turn @ tilt @ _EGO_R_CAMERA)[None]), np.array([self.place_m]))


@dataclass(frozen=True)
class VehicleType:
    """A make of vehicle with its rig.

    Attributes:
        name: the vehicle type.
        rig_id: its rig.
        mounts: seven cameras in canonical order.
        bonnet: solids of the vehicle itself that its cameras see, in the ego frame.
        stagger_ns: each camera exposes this much later than the one before.
        exposure_ns: length of an exposure.
    """

    name: str
    rig_id: str
    mounts: Sequence[Mount]
    bonnet: Records
    stagger_ns: int
    exposure_ns: int


def _rig(front: Mount, narrow: Mount, spread_m: float, height_m: float, rear_m: float, nose_m: float) -> list[Mount]:
    """A front pair, four cameras on the flanks, one at the back: together they look all round."""
    flank = 0.5 * spread_m
    return [
        front,
        narrow,
        Mount("front_left", "pinhole", 92.0, (nose_m, flank, height_m), 62.0, -4.0),
        Mount("front_right", "pinhole", 92.0, (nose_m, -flank, height_m), -62.0, -4.0),
        Mount("rear_left", "pinhole", 84.0, (nose_m + 0.3, flank, height_m - 0.1), 138.0, -4.0),
        Mount("rear_right", "pinhole", 84.0, (nose_m + 0.3, -flank, height_m - 0.1), -138.0, -4.0),
        Mount("rear", "pinhole", 96.0, (rear_m, 0.0, height_m), 180.0, -6.0),
    ]


SALOON: Final = VehicleType(
    name="saloon",
    rig_id="saloon-7",
    mounts=_rig(
        Mount("front_wide", "kannala_brandt", 122.0, (1.75, 0.0, 1.36), 0.0, -2.0, (-0.012, 0.004, -0.002, 0.0)),
        Mount("front_narrow", "pinhole", 34.0, (1.75, 0.08, 1.36), 0.0, 0.0),
        spread_m=1.86,
        height_m=1.05,
        rear_m=-1.05,
        nose_m=2.2,
    ),
    bonnet=solid((2.75, 0.0, 0.73), (1.60, 1.66, 0.22), (0.05, 0.10, 0.24), PAINT, slope=(0.9, 0.0)),
    stagger_ns=0,
    exposure_ns=8_000_000,
)
VAN: Final = VehicleType(
    name="van",
    rig_id="van-7",
    mounts=_rig(
        Mount("front_wide", "brown_conrady", 100.0, (3.05, 0.0, 1.92), 0.0, -5.0, (-0.17, 0.022, 0.0006, -0.0004, 0.0)),
        Mount("front_narrow", "pinhole", 30.0, (3.05, -0.08, 1.92), 0.0, -2.0),
        spread_m=2.10,
        height_m=1.75,
        rear_m=-1.30,
        nose_m=2.6,
    ),
    bonnet=SALOON.bonnet[:0],
    stagger_ns=3_000_000,
    exposure_ns=6_000_000,
)


@dataclass(frozen=True)
class Vehicle:
    """One vehicle: its cameras sit where they were installed, which is not quite where they were designed.

    Attributes:
        vehicle_id: pseudonym.
        kind: its type.
        width_px: of every picture.
        height_px: of every picture.
        seed: of tolerances and calibration errors.
    """

    vehicle_id: str
    kind: VehicleType
    width_px: int
    height_px: int
    seed: int

    @cached_property
    def cameras(self) -> dict[str, Camera]:
        """Lenses by camera name."""
        return {mount.camera: mount.lens(self.width_px, self.height_px) for mount in self.kind.mounts}

    @cached_property
    def ego_SE3_camera(self) -> dict[str, Poses]:  # noqa: N802
        """True mounting by camera name."""
        rng = np.random.default_rng([self.seed, 2])
        return {mount.camera: mount.ego_SE3_camera() @ _error(rng, _INSTALLED_DEG, 0.01) for mount in self.kind.mounts}

    def calibration(self, stage: Stage) -> list[dict[str, Any]]:
        """What a stage says of every camera: entries of ``calibrations/<stage>.json``."""
        rng = np.random.default_rng([self.seed, 3, list(ERROR_DEG).index(stage)])
        sigma = [math.radians(ERROR_DEG[stage]) ** 2] * 3 + [ERROR_M[stage] ** 2] * 3
        entries = []
        for name in CANONICAL_CAMERAS:
            camera, believed = (
                self.cameras[name],
                self.ego_SE3_camera[name] @ _error(rng, ERROR_DEG[stage], ERROR_M[stage]),
            )
            entries.append(
                {
                    "camera": name,
                    "model": camera.model,
                    "width_px": camera.width_px,
                    "height_px": camera.height_px,
                    "fx_px": camera.fx_px,
                    "fy_px": camera.fy_px,
                    "cx_px": camera.cx_px,
                    "cy_px": camera.cy_px,
                    "distortion": list(camera.distortion),
                    "ego_SE3_camera": [*believed.rotation[0].tolist(), *believed.translation[0].tolist()],
                    "valid_from_ns": None,
                    "valid_to_ns": None,
                    "time_offset_ns": 0,
                    "shutter_direction": "global",
                    "readout_ns": 0,
                    "covariance": np.diag(sigma).ravel().tolist(),
                    "method": f"synthetic, {stage} error",
                }
            )
        return entries


def _error(rng: np.random.Generator, angle_deg: float, distance_m: float) -> Poses:
    twist: Float64 = np.concatenate([rng.normal(0, math.radians(angle_deg), 3), rng.normal(0, distance_m, 3)])
    return Poses.exp(twist[None])
