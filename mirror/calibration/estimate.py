"""Rotation errors of all cameras of a rig, estimated jointly from tracked pairs of images, with their uncertainty.

A threshold on residuals cannot find a wrong mounting: half a degree changes the median residual by a few hundredths of
a pixel. The error is estimated instead. All cameras share the corrections of the vehicle's poses: where one camera
alone cannot tell an error of the poses from an error of its mounting, all together can.

The covariance is the sum of two parts. The first follows from the scatter of the pairs of images and the priors of the
poses (a sandwich estimator whose clusters are the pairs, P. Huber 1967; to first order the jackknife over pairs). The
second is the bias of the tracker, which every pair shares and which no scatter shows: a share of a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.calibration.equations import JointProblem, Solution
from mirror.calibration.rig import PosePrior, TrackedRig
from mirror.calibration.tracking import pixel_rad

AXES: Final = ("roll", "pitch", "yaw")
OBSERVABLE_DEG: Final = 0.1
"""An axis is unobservable if the standard deviation of the error about it is larger."""
FARTHEST_M: Final = 200.0
"""Tracks of points farther away are left out."""
TRACKER_BIAS_PX: Final = 0.15
"""1-sigma of the error that all tracks of a camera share, about each axis, measured on the synthetic street."""


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
    """

    camera: str
    rotation_rad: Float64
    error_deg: Float64
    covariance_deg2: Float64
    tracks: int
    pairs: int
    residual_px: float

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
        """Length of the error over the observable axes; NaN if there is none."""
        known = self.observable
        return float(np.linalg.norm(self.error_deg[known])) if known.any() else float("nan")


def estimate_rotations(
    rig: TrackedRig,
    prior: PosePrior | None = None,
    *,
    tracker_bias_px: float = TRACKER_BIAS_PX,
) -> list[CameraEstimate]:
    """Estimate the rotation error of every camera of a rig.

    Args:
        rig: the rig with its tracks.
        prior: errors that the recorded poses may have; None: the defaults.
        tracker_bias_px: 1-sigma of the error that all tracks of a camera share.

    Returns:
        One estimate per camera, in the order of the rig. A camera without tracks has a standard deviation of degrees.

    Raises:
        UsageError: no pair of images has tracks and motion.
    """
    first = JointProblem(rig, prior).solve()
    near = _near_rig(first)
    # A drive of nothing but far points is estimated from these.
    solution = JointProblem(near, prior).solve() if near.pairs else first
    return summarise(solution, tracker_bias_px=tracker_bias_px)


def _near_rig(solution: Solution) -> TrackedRig:
    """The rig without tracks of far points: clouds move, and their tracks would turn the cameras that see them."""
    near = solution.distances_m() < FARTHEST_M
    ends = np.cumsum(solution.problem.counts)[:-1]
    pairs = [
        replace(pair, first_px=pair.first_px[own], second_px=pair.second_px[own])
        for pair, own in zip(solution.problem.pairs, np.split(near, ends))
        if own.any()
    ]
    return replace(solution.problem.rig, pairs=pairs)


def summarise(solution: Solution, *, tracker_bias_px: float = TRACKER_BIAS_PX) -> list[CameraEstimate]:
    """The estimates of all cameras, with covariances, from a solution."""
    problem = solution.problem
    covariance = _sandwich(solution)
    out = []
    for number, (name, camera) in enumerate(problem.rig.cameras.items()):
        own = problem.camera[problem.rows] == number
        columns = solution.columns[number]
        # Towards the given mounting: its error is the inverse of the correction.
        turn = solution.start[number]
        block = turn @ covariance[np.ix_(columns, columns)] @ turn.T
        block = block + (tracker_bias_px * pixel_rad(camera)) ** 2 * np.eye(3)
        residual = np.abs(solution.state.residual[own])
        out.append(
            CameraEstimate(
                camera=name,
                rotation_rad=solution.rotation[number],
                error_deg=-np.degrees(turn @ solution.rotation[number]),
                covariance_deg2=np.degrees(np.degrees(block)),
                tracks=int(own.sum()),
                pairs=int((problem.camera == number).sum()),
                residual_px=float(np.median(residual)) if own.any() else float("nan"),
            )
        )
    return out


def _sandwich(solution: Solution) -> Float64:
    """Covariance (P, P) of the unknowns: scatter of the pairs and priors, between two inverse information matrices."""
    state, prior = solution.state, solution.problem.prior_information
    size = len(solution.unknowns)
    scores = np.zeros((len(state.gradients), size))
    np.put_along_axis(scores, state.columns, state.gradients, axis=1)
    inverse = np.linalg.inv(state.information)
    # Cameras without tracks have no scatter, only their weak prior.
    return inverse @ (prior + scores.T @ scores) @ inverse


@dataclass(frozen=True)
class Conditions:
    """What the images and the motion of a drive are like, to explain why an axis is unobservable.

    Attributes:
        turned_deg: total change of course over the frames.
        driven_m: length of the way.
        brightness: median grey value of the static pixels of each camera, 0 to 255.
        corners: mean number of corners per image of each camera.
    """

    turned_deg: float
    driven_m: float
    brightness: dict[str, float]
    corners: dict[str, float]


_FEW_CORNERS: Final = 60.0
_DARK: Final = 35.0
_STRAIGHT_DEG: Final = 45.0
_BARELY_DEG: Final = 10.0
_SHORT_M: Final = 5.0


def explain(estimate: CameraEstimate, conditions: Conditions) -> str | None:
    """Why an axis of a camera is unobservable; None: all axes are observable."""
    if estimate.observable.all():
        return None
    if conditions.driven_m < _SHORT_M:
        return "the vehicle hardly moves"
    if not estimate.tracks:
        return "no tracks: " + _poor_images(estimate.camera, conditions)
    if conditions.turned_deg < _STRAIGHT_DEG and estimate.observable[1:].all():
        return "straight driving" if conditions.turned_deg < _BARELY_DEG else "little turning"
    return "few tracks: " + _poor_images(estimate.camera, conditions)


def _poor_images(camera: str, conditions: Conditions) -> str:
    if conditions.brightness.get(camera, 255.0) < _DARK:
        return "night"
    return "no texture" if conditions.corners.get(camera, 0.0) < _FEW_CORNERS else "few points match between images"
