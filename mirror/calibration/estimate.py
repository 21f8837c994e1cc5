"""Rotation errors of all cameras of a rig, estimated jointly from tracked pairs of images, with their uncertainty.

A threshold on residuals cannot find a wrong mounting: half a degree changes the median residual by a few hundredths of
a pixel. The error is estimated instead. All cameras share the corrections of the vehicle's poses: where one camera
alone cannot tell an error of the poses from an error of its mounting, all together can.

A focal length or a length of the way that is wrong by a share of a percent looks like a rotation in a bend. Both are
unknowns with priors: their uncertainty is a part of that of the rotations.

The covariance is the sum of two parts. The first follows from the scatter of the pairs of images and the priors
(`mirror.calibration.uncertainty`). The second is the bias of the tracker, which every pair shares and which no scatter
shows: a share of a pixel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.calibration.equations import JointProblem, Solution
from mirror.calibration.rig import PosePrior, ScalePrior, TrackedRig
from mirror.calibration.spacing import ImageSpacing
from mirror.calibration.tracking import pixel_rad
from mirror.calibration.uncertainty import MOTION, TRACKS, Uncertainty

AXES: Final = ("roll", "pitch", "yaw")
OBSERVABLE_DEG: Final = 0.1
"""An axis is unobservable if the standard deviation of the error about it is larger."""
FARTHEST_M: Final = 200.0
"""Tracks of points farther away are left out."""
TRACKER_BIAS_PX: Final = 0.15
"""1-sigma of the error that all tracks of a camera share, about each axis, measured on the synthetic street."""


@dataclass(frozen=True)
class ScaleEstimate:
    """The estimated error of a scale.

    Attributes:
        error_percent: by how much the recorded value is too large.
        sigma_percent: its standard deviation.
    """

    error_percent: float
    sigma_percent: float


@dataclass(frozen=True, eq=False)
class CameraEstimate:
    """The estimated error of one camera's mounting.

    Attributes:
        camera: name of the camera.
        rotation_rad: (3,) rotation vector in the camera frame: ``ego_R_camera @ exp(rotation_rad)`` fits the images.
        error_deg: (3,) the error of the given mounting about the vehicle's axes: roll (x, forward), pitch (y, left)
            and yaw (z, up).
        covariance_deg2: (3, 3) covariance of ``error_deg``.
        tracks: number of tracks.
        pairs: number of pairs of images.
        residual_px: median distance from the epipolar lines; NaN without tracks.
        focal: error of the recorded focal length.
        way: error of the length of the recorded way, the same for all cameras.
        variance_share: (3,) share of the variance of each axis by its source, 0 to 1; the shares of an axis sum to 1.
    """

    camera: str
    rotation_rad: Float64
    error_deg: Float64
    covariance_deg2: Float64
    tracks: int
    pairs: int
    residual_px: float
    focal: ScaleEstimate
    way: ScaleEstimate
    variance_share: Mapping[str, Float64]

    @property
    def sigma_deg(self) -> Float64:
        """(3,) standard deviations about roll, pitch and yaw."""
        return np.sqrt(np.diagonal(self.covariance_deg2))

    @property
    def observable(self) -> Bool:
        """(3,) whether the error about roll, pitch and yaw is known well enough."""
        return self.sigma_deg <= OBSERVABLE_DEG

    @property
    def angle_deg(self) -> float:
        """Length of the error over the observable axes; NaN if no axis is observable."""
        known = self.observable
        return float(np.linalg.norm(self.error_deg[known])) if known.any() else float("nan")

    @property
    def main_sources(self) -> tuple[tuple[str, float], ...]:
        """Largest source of the variance of each axis, with its share."""
        names = list(self.variance_share)
        shares = np.stack([self.variance_share[name] for name in names])
        return tuple((names[one], float(shares[one, axis])) for axis, one in enumerate(shares.argmax(axis=0)))


def estimate_rotations(
    rig: TrackedRig,
    prior: PosePrior | None = None,
    scales: ScalePrior | None = None,
    *,
    tracker_bias_px: float = TRACKER_BIAS_PX,
) -> list[CameraEstimate]:
    """Estimate the rotation error of every camera of a rig.

    Args:
        rig: the rig with its tracks.
        prior: errors that the recorded poses may have; None: the defaults.
        scales: errors that focal lengths and the length of the way may have; None: the defaults.
        tracker_bias_px: 1-sigma of the error that all tracks of a camera share.

    Returns:
        One estimate per camera, in the order of the rig. A camera without tracks has a standard deviation of degrees.

    Raises:
        UsageError: no pair of images has tracks and motion.
    """
    first = JointProblem(rig, prior, scales).solve()
    near = near_rig(first)
    # A drive of nothing but far points is estimated from these.
    solution = JointProblem(near, prior, scales).solve() if near.pairs else first
    return summarise(solution, tracker_bias_px=tracker_bias_px)


def near_rig(solution: Solution) -> TrackedRig:
    """Return the rig without tracks of far points: clouds move, and their tracks would turn cameras that see them."""
    near = solution.distances_m() < FARTHEST_M
    ends = np.cumsum(solution.problem.counts)[:-1]
    pairs = [
        replace(pair, first_px=pair.first_px[own], second_px=pair.second_px[own])
        for pair, own in zip(solution.problem.pairs, np.split(near, ends))
        if own.any()
    ]
    return replace(solution.problem.rig, pairs=pairs)


def summarise(solution: Solution, *, tracker_bias_px: float = TRACKER_BIAS_PX) -> list[CameraEstimate]:
    """Return the estimates of all cameras, with covariances, from a solution."""
    problem = solution.problem
    uncertainty = Uncertainty(solution)
    covariance = uncertainty.covariance
    out = []
    for number, (name, camera) in enumerate(problem.rig.cameras.items()):
        own = problem.camera[problem.rows] == number
        columns = solution.columns[number]
        # Towards the given mounting: its error is the inverse of the correction.
        turn = solution.start[number]
        block = turn @ covariance[np.ix_(columns, columns)] @ turn.T
        bias = (tracker_bias_px * pixel_rad(camera)) ** 2
        block = block + bias * np.eye(3)
        sources = uncertainty.variance_by_source(columns, turn) | {"tracker": np.full(3, bias)}
        residual = np.abs(solution.state.residual[own])
        focal, way = (
            _scale(solution.unknowns[at], covariance[at, at])
            for at in (problem.scale_column + number, problem.size - 1)
        )
        out.append(
            CameraEstimate(
                camera=name,
                rotation_rad=solution.rotation[number],
                error_deg=-np.degrees(turn @ solution.rotation[number]),
                covariance_deg2=np.degrees(np.degrees(block)),
                tracks=int(own.sum()),
                pairs=int((problem.camera == number).sum()),
                residual_px=float(np.median(residual)) if own.any() else float("nan"),
                focal=focal,
                way=way,
                variance_share={name: part / np.diagonal(block) for name, part in sources.items()},
            )
        )
    return out


def _scale(unknown: float, variance: float) -> ScaleEstimate:
    """The error of a recorded scale; it is too large if the images need a smaller one."""
    return ScaleEstimate(float(100.0 * np.expm1(-unknown)), float(100.0 * np.sqrt(variance)))


@dataclass(frozen=True)
class ObservingConditions:
    """Figures of a drive's images and motion that explain why an axis is unobservable.

    Attributes:
        turned_deg: total change of course over the frames.
        driven_m: length of the way.
        brightness: median grey value of the static pixels of each camera, 0 to 255.
        corners: mean number of corners per image of each camera.
        spacing: how far apart the images are; None: not measured.
    """

    turned_deg: float
    driven_m: float
    brightness: dict[str, float]
    corners: dict[str, float]
    spacing: ImageSpacing | None = None


_FEW_CORNERS: Final = 60.0
_DARK: Final = 35.0
_STRAIGHT_DEG: Final = 45.0
_BARELY_DEG: Final = 10.0
_SHORT_M: Final = 5.0


def explain(estimate: CameraEstimate, conditions: ObservingConditions) -> str | None:
    """Explain why an axis of a camera is unobservable; None if all axes are observable."""
    if estimate.observable.all():
        return None
    if conditions.driven_m < _SHORT_M:
        return "the vehicle hardly moves"
    if not estimate.tracks:
        return "no tracks: " + _poor_images(estimate.camera, conditions)
    if conditions.turned_deg < _STRAIGHT_DEG and estimate.observable[1:].all():
        return "straight driving" if conditions.turned_deg < _BARELY_DEG else "little turning"
    worst = int(np.argmax(estimate.sigma_deg))
    source, share = estimate.main_sources[worst]
    if source == MOTION:
        return f"the motion does not show {AXES[worst]}"
    if source == TRACKS:
        return "few tracks: " + _poor_images(estimate.camera, conditions)
    return f"{share:.0%} of the variance of {AXES[worst]} are possible errors of the {source}"


def _poor_images(camera: str, conditions: ObservingConditions) -> str:
    if conditions.brightness.get(camera, 255.0) < _DARK:
        return "night"
    if conditions.corners.get(camera, 0.0) < _FEW_CORNERS:
        return "no texture"
    spacing = conditions.spacing
    if spacing is not None and spacing.is_too_far:
        return f"images are {spacing} apart; tracking needs {spacing.needed()}"
    return "few points match between images"
