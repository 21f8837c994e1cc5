"""Measurement errors of synthetic recordings: positions, attitudes, calibrations, clocks, lost images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final, Literal

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.errors import UsageError
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.portable import arrays

Stage = Literal["factory", "online"]

MAX_SIGMA: Final = 3.0
"""Largest mounting error, in standard deviations. Larger draws are repeated, so the calibration error is bounded."""


def _require(given: object, fits: bool, expected: str) -> None:
    if not fits:
        raise UsageError(f"{given}", expected=expected)


@dataclass(frozen=True)
class MountingError:
    """Size of the error of a camera's calibrated mounting.

    Attributes:
        angle_deg: 1-sigma of the rotation about each axis; the total angle is at most MAX_SIGMA times this.
        distance_m: 1-sigma of the translation along each axis; the total length is at most MAX_SIGMA times this.
    """

    angle_deg: float
    distance_m: float

    def __post_init__(self) -> None:
        _require(self, self.angle_deg >= 0.0 and self.distance_m >= 0.0, "angles and distances of at least 0")

    def draw(self, rng: np.random.Generator) -> Poses:
        """Draw one error, as one pose to be applied in the camera's own frame."""
        turn = _draw_truncated_normal(rng, math.radians(self.angle_deg))
        shift = _draw_truncated_normal(rng, self.distance_m)
        return Poses.exp(np.concatenate([turn, shift])[None])

    def covariance(self) -> list[float]:
        """Return the 6x6 covariance, row-major: rotation (rad), then translation (m)."""
        return np.diag([math.radians(self.angle_deg) ** 2] * 3 + [self.distance_m**2] * 3).ravel().tolist()


@dataclass(frozen=True)
class CameraClock:
    """The clock of a camera.

    Attributes:
        offset_ns: offset that the vehicle knows and corrects: ``time_offset_ns`` of the calibration.
        error_ns: offset that the vehicle does not know: corrected timestamps are later than the true time by this.
    """

    offset_ns: int
    error_ns: int


@dataclass(frozen=True)
class Errors:
    """Sizes of the errors of a recording; each may be 0. `Errors.none` sets all to 0.

    Attributes:
        position_noise_m: 1-sigma of the white noise of each position along each axis.
        position_drift_m: 1-sigma along each axis of a smooth drift, a second-order Gauss-Markov process.
        drift_time_s: time constant of the drift.
        position_bias_m: 1-sigma along each axis of an offset that is constant over a drive.
        attitude_noise_deg: 1-sigma of the white noise of each rotation about each axis.
        factory: error of the mountings in ``calibrations/factory.json``, the same in all drives of a vehicle.
        online: error of the mountings in ``calibrations/online.json``, drawn for every drive.
        focal_share: 1-sigma of the focal length, as a share of it; the same in both stages.
        centre_share: 1-sigma of the principal point along each axis, as a share of the image width.
        clock_offset_ns: 1-sigma of the known offset between the cameras' clocks and the vehicle's clock.
        clock_error_ns: 1-sigma of the unknown part of that offset.
        dropped: share of the images that are lost.
    """

    position_noise_m: float = 0.003
    position_drift_m: float = 0.03
    drift_time_s: float = 4.0
    position_bias_m: float = 0.02
    attitude_noise_deg: float = 0.02
    factory: MountingError = MountingError(0.25, 0.010)
    online: MountingError = MountingError(0.04, 0.004)
    focal_share: float = 2e-4
    centre_share: float = 2e-4
    clock_offset_ns: int = 1_000_000
    clock_error_ns: int = 100_000
    dropped: float = 0.0

    def __post_init__(self) -> None:
        numbers = [value for setting in fields(self) if isinstance(value := getattr(self, setting.name), int | float)]
        _require(self, min(numbers) >= 0.0, "numbers of at least 0")
        _require(self, self.drift_time_s > 0.0, "drift_time_s above 0")
        _require(self, self.dropped < 1.0, "a share of dropped images below 1")

    @classmethod
    def none(cls) -> Errors:
        """Return errors of size 0: the recording equals the truth."""
        exact = MountingError(0.0, 0.0)
        return cls(
            position_noise_m=0.0,
            position_drift_m=0.0,
            position_bias_m=0.0,
            attitude_noise_deg=0.0,
            factory=exact,
            online=exact,
            focal_share=0.0,
            centre_share=0.0,
            clock_offset_ns=0,
            clock_error_ns=0,
            dropped=0.0,
        )

    @property
    def sigma_m(self) -> float:
        """1-sigma of a position along each axis, as a receiver states it."""
        return math.sqrt(self.position_noise_m**2 + self.position_drift_m**2 + self.position_bias_m**2)

    def mounting_error(self, stage: Stage) -> MountingError:
        """Return the error of the mountings of a calibration stage."""
        return self.factory if stage == "factory" else self.online

    def perturb_poses(self, truth: Poses, time_s: Float64, rng: np.random.Generator) -> Poses:
        """Add the errors of a receiver to true poses.

        Args:
            truth: N poses in a level frame.
            time_s: (N,) times, ascending.
            rng: source of the errors.

        Returns:
            N measured poses in the same frame.
        """
        shape = (len(time_s), 3)
        off = rng.normal(0.0, self.position_bias_m, 3)
        off = off + self.position_drift_m * draw_drift(time_s, self.drift_time_s, rng)
        off = off + rng.normal(0.0, self.position_noise_m, shape)
        turn = rng.normal(0.0, math.radians(self.attitude_noise_deg), shape)
        turned = truth @ Poses.exp(np.concatenate([turn, np.zeros(shape)], axis=1))
        return Poses(turned.rotation, truth.translation + off)

    def perturb_camera(self, camera: Camera, rng: np.random.Generator) -> Camera:
        """Add calibration errors to the intrinsics of a camera."""
        return perturb_intrinsics(camera, self.focal_share, self.centre_share, rng)

    def draw_clocks(self, cameras: Sequence[str], rng: np.random.Generator) -> dict[str, CameraClock]:
        """Draw the clock of each camera, by camera name."""
        errors = np.round(rng.normal(0.0, self.clock_error_ns, len(cameras))).astype(int)
        known = np.round(rng.normal(0.0, self.clock_offset_ns, len(cameras))).astype(int)
        return {name: CameraClock(int(offset), int(error)) for name, offset, error in zip(cameras, known, errors)}

    def draw_losses(self, count: int, rng: np.random.Generator) -> Bool:
        """Draw the lost images of a camera: (count,), True where lost."""
        return rng.random(count) < self.dropped


def draw_drift(time_s: Float64, over_s: float, rng: np.random.Generator) -> Float64:
    """Draw three smooth random processes of unit variance: second-order Gauss-Markov, critically damped.

    The autocorrelation is ``(1 + |t| / over_s) exp(-|t| / over_s)``. The processes are once differentiable, as the
    errors of a filter are. The discretisation is exact for any time steps (A. Gelb, "Applied Optimal Estimation",
    MIT Press 1974).

    Args:
        time_s: (N,) times, ascending.
        over_s: time constant.
        rng: source of the random numbers.

    Returns:
        (N, 3) values of the processes.
    """
    rate = 1.0 / over_s
    spread = np.diag([1.0, rate**2])
    states = rng.normal(size=(len(time_s), 2, 3))
    if not len(states):
        return states[:, 0]
    states[0] *= np.sqrt(np.diag(spread))[:, None]
    steps, which = np.unique(np.diff(time_s), return_inverse=True)
    onward = arrays.exp(-rate * steps)[:, None, None] * (
        np.array([[1.0, 0.0], [0.0, 1.0]]) + steps[:, None, None] * np.array([[rate, 1.0], [-(rate**2), -rate]])
    )
    added = spread - arrays.matmul(arrays.matmul(onward, spread), np.swapaxes(onward, 1, 2))
    root = _cholesky(added)
    for i, step in enumerate(which, start=1):
        states[i] = arrays.matmul(onward[step], states[i - 1]) + arrays.matmul(root[step], states[i])
    return states[:, 0]


def perturb_intrinsics(camera: Camera, focal_share: float, centre_share: float, rng: np.random.Generator) -> Camera:
    """Add random errors to the focal length and the principal point of a camera.

    Args:
        camera: the true camera.
        focal_share: 1-sigma of the focal length, as a share of it.
        centre_share: 1-sigma of the principal point along each axis, as a share of the image width.
        rng: source of the errors.
    """
    longer = 1.0 + rng.normal(0.0, focal_share)
    aside, down = rng.normal(0.0, centre_share * camera.width_px, 2)
    return Camera(
        camera.model,
        camera.width_px,
        camera.height_px,
        camera.fx_px * longer,
        camera.fy_px * longer,
        camera.cx_px + aside,
        camera.cy_px + down,
        camera.distortion,
    )


def _cholesky(covariance: Float64) -> Float64:
    """Lower Cholesky factors (N, 2, 2) of positive semi-definite matrices (N, 2, 2); zeros for time steps of 0."""
    first = np.sqrt(np.maximum(covariance[:, 0, 0], 0.0))
    cross = covariance[:, 0, 1] / np.where(first > 0.0, first, 1.0)
    second = np.sqrt(np.maximum(covariance[:, 1, 1] - cross**2, 0.0))
    return np.stack([np.stack([first, np.zeros_like(first)], axis=1), np.stack([cross, second], axis=1)], axis=1)


def _draw_truncated_normal(rng: np.random.Generator, sigma: float) -> Float64:
    """Draw a normal vector (3,) no longer than MAX_SIGMA standard deviations."""
    while True:
        vector = rng.normal(size=3)
        if arrays.norm(vector) <= MAX_SIGMA:
            return sigma * vector
