"""A moving rig with tracks between its images, and the errors that its recorded poses may have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mirror.arrays import Float64
from mirror.calibration.tracking import PairTracks
from mirror.errors import UsageError
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.geometry.rolling_shutter import RollingShutter


@dataclass(frozen=True)
class PosePrior:
    """Errors that the recorded poses and mountings may have, 1-sigma.

    The position error of a frame is white noise plus a smooth drift with the autocorrelation
    ``(1 + |t| / drift_time_s) exp(-|t| / drift_time_s)``; a constant offset has no effect.

    Attributes:
        attitude_deg: rotation of a frame about each axis, independent between frames.
        position_m: white noise of a position along each axis.
        drift_m: drift of the positions along each axis.
        drift_time_s: time constant of the drift.
        mounting_m: position of a camera on the vehicle along each axis.
    """

    attitude_deg: float = 0.03
    position_m: float = 0.005
    drift_m: float = 0.03
    drift_time_s: float = 4.0
    mounting_m: float = 0.01

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value > 0.0):
                raise UsageError(f"{value}", place=name, expected="a finite number above 0")

    def position_information(self, time_s: Float64, offset_m: float = 0.0) -> Float64:
        """Return the inverse covariance (F, F) of the position errors of frames at times (F,), along one axis.

        Args:
            time_s: the times.
            offset_m: 1-sigma of an offset that all share.
        """
        lag = np.abs(time_s[:, None] - time_s[None, :]) / self.drift_time_s
        covariance = self.drift_m**2 * (1.0 + lag) * np.exp(-lag) + self.position_m**2 * np.eye(len(time_s))
        covariance += offset_m**2
        return np.asarray(np.linalg.inv(covariance), np.float64)


@dataclass(frozen=True)
class ScalePrior:
    """Errors of scale that the recorded lenses and poses may have, 1-sigma.

    In a bend an error of either looks like a rotation of the camera.

    Attributes:
        focal_percent: focal length of a camera, independent between cameras.
        way_percent: length of the way between the recorded poses, one scale for all.
    """

    focal_percent: float = 0.5
    way_percent: float = 0.5

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and 0.0 < value <= 10.0):
                raise UsageError(f"{value}", place=name, expected="a number above 0 and at most 10")


@dataclass(frozen=True)
class TimePrior:
    """Errors that the declared times of a camera may have, 1-sigma: wide, because the images are to show them.

    Attributes:
        offset_ms: offset of the camera's clock to the poses.
        readout_ms: readout over all rows, and over all columns.
    """

    offset_ms: float = 50.0
    readout_ms: float = 100.0


def declared_times_s(shutter: RollingShutter) -> tuple[float, float, float]:
    """Return the times that a shutter states, seconds: no offset, readout of rows downwards, of columns rightwards."""
    if not shutter.is_rolling:
        return 0.0, 0.0, 0.0
    sign = -1.0 if shutter.direction in ("bottom_to_top", "right_to_left") else 1.0
    readout_s = sign * 1e-9 * shutter.readout_ns
    return (0.0, 0.0, readout_s) if shutter.reads_columns else (0.0, readout_s, 0.0)


@dataclass(frozen=True, eq=False)
class TrackedRig:
    """A moving rig with the tracks between its images.

    Attributes:
        cameras: lenses by camera name.
        ego_SE3_camera: recorded mountings by camera name, one pose each.
        time_s: (F,) times of the frames, ascending.
        world_SE3_ego: recorded poses by camera name, F each: the poses at the exposures of that camera.
        pairs: tracks between images of the same camera.
        ego_twist: (F, 6) by camera name: the vehicle's angular velocity, rad/s, then its velocity, m/s, in its own
            frame at the exposures of that camera; None: not known, and all pixels count as seen at mid-exposure.
        shutters: declared shutters by camera name; a missing one is global.
    """

    cameras: Mapping[str, Camera]
    ego_SE3_camera: Mapping[str, Poses]
    time_s: Float64
    world_SE3_ego: Mapping[str, Poses]
    pairs: Sequence[PairTracks]
    ego_twist: Mapping[str, Float64] | None = None
    shutters: Mapping[str, RollingShutter] = field(default_factory=dict)

    def shutter(self, name: str) -> RollingShutter:
        """Return the declared shutter of a camera."""
        camera = self.cameras[name]
        return self.shutters.get(name, RollingShutter("global", 0, camera.width_px, camera.height_px))

    @property
    def names(self) -> list[str]:
        """Names of the cameras, in order."""
        return list(self.cameras)
