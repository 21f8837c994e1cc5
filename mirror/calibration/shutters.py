"""Readouts and time offsets of cameras, estimated from the tracks of a rig that turns, beside its mountings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from mirror.arrays import Float64
from mirror.calibration.equations import JointProblem, Solution
from mirror.calibration.estimate import TRACKER_BIAS_PX, near_rig
from mirror.calibration.rig import PosePrior, ScalePrior, TimePrior, TrackedRig
from mirror.calibration.tracking import pixel_rad
from mirror.calibration.uncertainty import jackknife_variance
from mirror.geometry.rolling_shutter import RollingShutter, ShutterDirection

KNOWN_MS: Final = 2.0
"""A time is known if its standard deviation is at most this."""
LEAST_MS: Final = 2.0
SIGMAS: Final = 4.0
"""A declared readout is wrong if it is this much from the estimate: at least `LEAST_MS`, and `SIGMAS` deviations."""

_DEVIATIONS_A_MEDIAN: Final = 1.4826
"""Standard deviation of a normal distribution whose absolute values have the median 1."""
_DOWN: Final[tuple[ShutterDirection, ShutterDirection]] = ("top_to_bottom", "bottom_to_top")
_RIGHT: Final[tuple[ShutterDirection, ShutterDirection]] = ("left_to_right", "right_to_left")


@dataclass(frozen=True)
class ShutterEstimate:
    """The estimated times of one camera.

    Attributes:
        camera: name of the camera.
        declared: declared direction.
        declared_ms: declared readout.
        direction: direction that the images show; None: they show no direction.
        readout_ms: readout in that direction, or in the declared one.
        readout_sigma_ms: its standard deviation.
        offset_ms: how much later than its timestamps the camera exposes.
        offset_sigma_ms: its standard deviation. On a straight road, or in a bend of constant speed, an offset acts like
            an error of the mounting, and the deviation is large.
        problem: a declared readout or direction that the images contradict; None: there is none, or it is not known.
    """

    camera: str
    declared: ShutterDirection
    declared_ms: float
    direction: ShutterDirection | None
    readout_ms: float
    readout_sigma_ms: float
    offset_ms: float
    offset_sigma_ms: float
    problem: str | None

    @property
    def readout_known(self) -> bool:
        """Return whether the images show the readout."""
        return self.readout_sigma_ms <= KNOWN_MS

    @property
    def offset_known(self) -> bool:
        """Return whether the images show the offset; else it is an interval."""
        return self.offset_sigma_ms <= KNOWN_MS

    def to_dict(self) -> dict[str, Any]:
        """Return the estimate as plain values, for JSON."""
        return vars(self) | {"readout_known": self.readout_known, "offset_known": self.offset_known}

    def __str__(self) -> str:
        readout, offset = (self.readout_ms, self.readout_sigma_ms), (self.offset_ms, self.offset_sigma_ms)
        return say_times(self.direction, readout, offset, self.problem)


def say_times(
    direction: str | None, readout_ms: tuple[float, float], offset_ms: tuple[float, float], problem: str | None
) -> str:
    """Return the readout and the time offset of a camera in words; both are values with standard deviations."""
    readout = f"readout {readout_ms[0]:.1f} +- {readout_ms[1]:.1f} ms {direction or ''}".rstrip()
    offset = f"time offset {offset_ms[0]:+.1f} +- {offset_ms[1]:.1f} ms"
    return f"{readout}; {offset}" + (f"; wrong shutter: {problem}" if problem else "")


def estimate_shutters(
    rig: TrackedRig, prior: PosePrior | None = None, scales: ScalePrior | None = None, times: TimePrior | None = None
) -> list[ShutterEstimate]:
    """Estimate readout and time offset of every camera, jointly with mountings, poses and scales.

    Args:
        rig: the rig with its tracks and the vehicle's velocities.
        prior: errors that the recorded poses may have; None: the defaults.
        scales: errors of focal lengths and of the way; None: the defaults.
        times: errors that the declared times may have; None: the defaults.

    Returns:
        One estimate per camera, in the order of the rig. Where the tracks of a camera have more noise than the loss
        expects (`JointProblem.loss_px`, 0.25 px), the scatter of pairs understates the errors of the times: their
        deviations are infinite, and no problem is named. `mirror calibrate refine` follows features over many images,
        and holds its intervals there.

    Raises:
        UsageError: no pair of images has tracks and motion.
    """
    times = times or TimePrior()
    solution = JointProblem(rig, prior, scales, times=times).solve()
    near = near_rig(solution)
    if near.pairs:
        solution = JointProblem(near, prior, scales, times=times).solve()
    problem = solution.problem
    variance = jackknife_variance(solution)
    out = []
    for number, name in enumerate(rig.names):
        columns = problem.time_columns[number]
        values = problem.declared_times[number] + solution.unknowns[columns]
        bias_s = _tracker_bias_s(rig, name) if _noise_px(solution, number) <= problem.loss_px else np.inf
        sigma = np.sqrt(variance[columns] + bias_s**2)
        out.append(describe_times(name, rig.shutter(name), values, sigma))
    return out


def _noise_px(solution: Solution, camera: int) -> float:
    """Return the standard deviation of the tracks of a camera, from the median of their residuals."""
    problem = solution.problem
    own = solution.state.residual[problem.camera[problem.rows] == camera]
    return float(_DEVIATIONS_A_MEDIAN * np.median(np.abs(own))) if len(own) else 0.0


def _tracker_bias_s(rig: TrackedRig, name: str) -> float:
    """The time in which the vehicle turns by the bias of the tracker, which no scatter of tracks shows."""
    if rig.ego_twist is None:
        return np.inf
    spin = float(np.sqrt((rig.ego_twist[name][:, :3] ** 2).sum(axis=1).mean()))
    return TRACKER_BIAS_PX * pixel_rad(rig.cameras[name]) / max(spin, 1e-6)


def describe_times(camera: str, shutter: RollingShutter, times_s: Float64, sigma_s: Float64) -> ShutterEstimate:
    """Name the direction that the readouts of rows and columns show, and what the calibration declares otherwise.

    Args:
        camera: name of the camera.
        shutter: its declared shutter.
        times_s: (3,) offset of its clock, readout of the rows downwards, readout of the columns rightwards.
        sigma_s: (3,) their standard deviations.
    """
    declared: ShutterDirection = shutter.direction if shutter.is_rolling else "global"
    declared_ms = 1e-6 * shutter.readout_ns if shutter.is_rolling else 0.0
    offset, down, right = (1e3 * times_s).tolist()
    offset_sigma, down_sigma, right_sigma = (1e3 * sigma_s).tolist()
    shown: list[tuple[float, float, ShutterDirection]] = []
    for value, sigma, names in ((down, down_sigma, _DOWN), (right, right_sigma, _RIGHT)):
        if abs(value) > max(SIGMAS * sigma, LEAST_MS):
            shown.append((abs(value), sigma, names[int(value < 0.0)]))
    if shown:
        readout, sigma, direction = max(shown)
    else:
        direction = None
        sideways = declared in _RIGHT
        value, sigma = (right, right_sigma) if sideways else (down, down_sigma)
        readout = -value if declared in ("bottom_to_top", "right_to_left") else value
    problem = None
    found = "a global shutter" if direction is None else f"{direction}, {readout:.1f} +- {sigma:.1f} ms"
    said = "a global shutter" if declared == "global" else f"{declared}, {declared_ms:.1f} ms"
    if (direction or declared) != declared or abs(readout - declared_ms) > max(SIGMAS * sigma, LEAST_MS):
        problem = f"the calibration declares {said}; the images show {found}"
    return ShutterEstimate(
        camera, declared, declared_ms, direction, readout, sigma, offset, offset_sigma, problem
    )  # fmt: skip
