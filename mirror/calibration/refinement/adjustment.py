"""Bundle adjustment of moving rigs: mountings, lenses, poses of frames and points, from tracks of features.

The maximum a posteriori estimate: errors of features with heavy tails (Cauchy), recorded values with normal errors.
Levenberg-Marquardt steps with eliminated points (B. Triggs et al., "Bundle Adjustment - A Modern Synthesis", 1999). The
scale of the loss starts large and shrinks, so that mountings with errors of a degree are reached; between the stages
observations that do not fit are removed.

A feature of a rolling shutter is seen at the time of its line. Before each stage its ray is replaced by that by which
its point, as far as it is known, would be seen at mid-exposure. The times of the cameras may be unknowns too.

What the images alone give is the rotation of the cameras relative to each other. The rotation of all of them together
to the vehicle comes from the recorded poses and their errors, and has a larger uncertainty.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.calibration.equations import exp_rotations
from mirror.calibration.estimate import FARTHEST_M
from mirror.calibration.refinement.equations import MOUNT, POSE, TIMES, reduce_equations, residuals_px, step_points
from mirror.calibration.refinement.exposure import ExposedFeatures
from mirror.calibration.refinement.rigs import FeatureTracks, MovingRigs, RefinementPrior
from mirror.calibration.refinement.triangulation import triangulate
from mirror.calibration.rig import TimePrior, declared_times_s
from mirror.errors import UsageError
from mirror.geometry import Poses, matrix_from_quaternion
from mirror.geometry.cameras import Camera

_STAGES: Final = ((30.0, 40.0, 6), (5.0, 8.0, 8), (1.0, 4.0, 30))
"""Factor of the loss' scale, largest residual in pixels that stays, and largest number of steps of each stage."""
_UNKNOWN_DEG: Final = 5.0
_LEAST_GAIN: Final = 1e-6
_LARGEST_DAMPING: Final = 1e8
_SETTLED_S: Final = 1e-5
_MOST_EXPOSURES: Final = 8


@dataclass(frozen=True, eq=False)
class RigState:
    """Values of all unknowns of a rig's adjustment.

    Attributes:
        frame_turns: (F, 3, 3) corrections of the rotations of the frames, about the vehicle's axes.
        frame_steps: (F, 3) corrections of their positions, in the world.
        mount_turns: (K, 3, 3) rotations ego_R_camera.
        mount_places: (K, 3) positions on the vehicle.
        lenses: (K, 3) changes of the logarithm of the focal length, and of the principal point in pixels.
        times_s: (K, 3) times of the cameras: offset of the clock, readout of the rows downwards, of the columns
            rightwards.
        points: (T, 3) points.
    """

    frame_turns: Float64
    frame_steps: Float64
    mount_turns: Float64
    mount_places: Float64
    lenses: Float64
    times_s: Float64
    points: Float64

    def moved(self, step: Float64, point_steps: Float64) -> RigState:
        """Return the state moved by a step (N,) of frames, mountings and times, and by steps (T, 3) of the points."""
        split = POSE * len(self.frame_steps)
        end = split + MOUNT * len(self.mount_places)
        frames, mounts = step[:split].reshape(-1, POSE), step[split:end].reshape(-1, MOUNT)
        return RigState(
            self.frame_turns @ exp_rotations(frames[:, :3]),
            self.frame_steps + frames[:, 3:],
            self.mount_turns @ exp_rotations(mounts[:, :3]),
            self.mount_places + mounts[:, 3:6],
            self.lenses + mounts[:, 6:],
            self.times_s + (step[end:].reshape(-1, TIMES) if len(step) > end else 0.0),
            self.points + point_steps,
        )


@dataclass(frozen=True, eq=False)
class Adjustment:
    """The rigs after adjustment.

    Attributes:
        rigs: the recorded rigs.
        tracks: the tracks that were used in the end.
        state: the adjusted values.
        covariance: (N, N) of frames and mountings: 6 numbers a frame, then 9 a mounting; with unknown times 3 more a
            camera, last of all.
        residual_px: (M,) distances of the observations from the projections of their points.
        steps: number of steps.
        converged: whether the last stage ended because nothing was gained any more.
    """

    rigs: MovingRigs
    tracks: FeatureTracks
    state: RigState
    covariance: Float64
    residual_px: Float64
    steps: int
    converged: bool

    @cached_property
    def ego_SE3_camera(self) -> Poses:  # noqa: N802
        """K adjusted mountings."""
        recorded = self.rigs.ego_SE3_camera
        turn = np.swapaxes(matrix_from_quaternion(recorded.rotation), 1, 2) @ self.state.mount_turns
        return Poses((recorded @ rotations(turn)).rotation, self.state.mount_places)

    @cached_property
    def cameras(self) -> tuple[Camera, ...]:
        """K adjusted lenses."""
        return tuple(
            replace(
                camera,
                fx_px=camera.fx_px * float(np.exp(longer)),
                fy_px=camera.fy_px * float(np.exp(longer)),
                cx_px=camera.cx_px + float(right),
                cy_px=camera.cy_px + float(down),
            )
            for camera, (longer, right, down) in zip(self.rigs.cameras, self.state.lenses)
        )

    def mounting_columns(self, mounting: int) -> slice:
        """Return the columns of a mounting's rotation (about the camera's axes) and position in the covariance."""
        first = POSE * len(self.rigs.time_s) + MOUNT * mounting
        return slice(first, first + POSE)

    def time_columns(self, mounting: int) -> slice:
        """Return the columns of a camera's times in the covariance; there are none if the times were not unknown."""
        first = POSE * len(self.rigs.time_s) + MOUNT * len(self.rigs.cameras) + TIMES * mounting
        return slice(first, first + TIMES)

    def observations(self) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """Return the number (K,) of observations of each mounting."""
        return np.bincount(self.rigs.mounting[self.tracks.image], minlength=len(self.rigs.cameras))


def rotations(matrices: Float64) -> Poses:
    """Make poses that only rotate, from matrices (N, 3, 3)."""
    whole = np.tile(np.eye(4), (len(matrices), 1, 1))
    whole[:, :3, :3] = matrices
    return Poses.from_matrix(whole)


def adjust_rigs(
    rigs: MovingRigs,
    tracks: FeatureTracks,
    prior: RefinementPrior | None = None,
    advance: Callable[[int], None] = lambda steps: None,
    times: TimePrior | None = None,
) -> Adjustment:
    """Adjust rigs to tracks.

    Args:
        rigs: the recorded rigs.
        tracks: tracks of features; those whose rays hardly meet or have no angle are left out.
        prior: errors that the recorded values may have; None: the defaults.
        advance: is called with 1 after each step.
        times: errors that the declared times of the cameras may have, which are then unknowns; None: they are exact.

    Raises:
        UsageError: no track can be triangulated, or times are unknown and the rigs state no velocities.
    """
    if times is not None and rigs.ego_twist is None:
        raise UsageError(
            "the rigs state no velocities", place="rigs.ego_twist",
            expected="velocities of the vehicle, which show the times of the cameras",
        )  # fmt: skip
    weights = prior or RefinementPrior()
    adjuster = Adjuster(rigs, weights, times)
    points, kept = triangulate(rigs, tracks)
    tracks, points = _select(tracks, points, kept)
    state = RigState(
        np.tile(np.eye(3), (len(rigs.time_s), 1, 1)),
        np.zeros((len(rigs.time_s), 3)),
        matrix_from_quaternion(rigs.ego_SE3_camera.rotation),
        rigs.ego_SE3_camera.translation.copy(),
        np.zeros((len(rigs.cameras), 3)),
        adjuster.declared_s.copy(),
        points,
    )
    steps = 0
    # the last stage again: its rays know the points better, and the times
    again = _MOST_EXPOSURES if times is not None else int(rigs.are_rolling)
    for factor, largest_px, most in (*_STAGES, *(_STAGES[-1:] * again)):
        if not len(tracks):
            break
        adjuster.expose(state, tracks)
        before_s = state.times_s
        state, taken, converged = adjuster.solve(state, tracks, factor, most, advance)
        steps += taken
        fits = np.linalg.norm(adjuster.residuals(state, tracks), axis=1) < largest_px
        tracks, points = _select(tracks, state.points, fits & adjuster.is_near(state, tracks))
        state = replace(state, points=points)
        if times is not None and factor == 1.0 and np.abs(state.times_s - before_s).max() < _SETTLED_S:
            break
    if not len(tracks):
        raise UsageError(
            "no feature is seen from two places", expected="images that overlap, of a vehicle that moves",
            remedy="choose frames in which the vehicle moves, and images with texture",
        )  # fmt: skip
    adjuster.expose(state, tracks)
    return Adjustment(
        rigs, tracks, state, adjuster.covariance(state, tracks),
        np.linalg.norm(adjuster.residuals(state, tracks), axis=1), steps, converged,
    )  # fmt: skip


class Adjuster:
    """The equations of the adjustment of some rigs."""

    def __init__(self, rigs: MovingRigs, prior: RefinementPrior, times: TimePrior | None = None) -> None:
        self.rigs, self.prior, self.times = rigs, prior, times
        self.turns = matrix_from_quaternion(rigs.world_SE3_ego.rotation)
        self.mounts = matrix_from_quaternion(rigs.ego_SE3_camera.rotation)
        self.declared_s = np.zeros((len(rigs.cameras), TIMES))
        if rigs.shutters:
            self.declared_s[:] = [declared_times_s(shutter) for shutter in rigs.shutters]
        self._features: tuple[FeatureTracks, ExposedFeatures] | None = None

    @cached_property
    def information(self) -> Float64:
        """Inverse covariance (N, N) of the recorded values."""
        rigs, prior = self.rigs, self.prior
        frames, first_time = len(rigs.time_s), POSE * len(rigs.time_s) + MOUNT * len(rigs.cameras)
        size = first_time + (0 if self.times is None else TIMES * len(rigs.cameras))
        matrix = np.zeros((size, size))
        for number in np.unique(rigs.traversal):
            own = np.flatnonzero(rigs.traversal == number)
            positions = prior.poses.position_information(rigs.time_s[own], prior.offset_m)
            for axis in range(3):
                matrix[np.ix_(POSE * own + 3 + axis, POSE * own + 3 + axis)] = positions
        diagonal = np.diag(matrix).copy()
        turn = (POSE * np.arange(frames)[:, None] + np.arange(3)).ravel()
        diagonal[turn] = np.radians(prior.poses.attitude_deg) ** -2
        width = np.array([camera.width_px for camera in rigs.cameras], np.float64)
        mount = POSE * frames + MOUNT * np.arange(len(rigs.cameras))
        for axis in range(3):
            diagonal[mount + axis] = np.radians(_UNKNOWN_DEG) ** -2
            diagonal[mount + 3 + axis] = prior.poses.mounting_m**-2
        diagonal[mount + 6] = prior.focal_share**-2
        diagonal[mount + 7] = diagonal[mount + 8] = (prior.centre_share * width) ** -2
        if self.times is not None:
            sigma_s = 1e-3 * np.array([self.times.offset_ms, self.times.readout_ms, self.times.readout_ms])
            diagonal[first_time:] = np.tile(sigma_s**-2, len(rigs.cameras))
        matrix[np.arange(size), np.arange(size)] = diagonal
        return matrix

    def deviation(self, state: RigState) -> Float64:
        """Return the deviations (N,) from the recorded values."""
        frames = np.concatenate([_logarithms(state.frame_turns), state.frame_steps], axis=1)
        turned = _logarithms(np.swapaxes(self.mounts, 1, 2) @ state.mount_turns)
        moved = state.mount_places - self.rigs.ego_SE3_camera.translation
        mounts = np.concatenate([turned, moved, state.lenses], axis=1)
        late = [] if self.times is None else [(state.times_s - self.declared_s).ravel()]
        return np.concatenate([frames.ravel(), mounts.ravel(), *late])

    def features(self, tracks: FeatureTracks) -> ExposedFeatures:
        """Return the rays of features, as they were exposed last."""
        if self._features is None or self._features[0] is not tracks:
            self._features = tracks, ExposedFeatures.of(self.rigs, tracks)
        return self._features[1]

    def expose(self, state: RigState, tracks: FeatureTracks) -> None:
        """Move the rays of features of rolling shutters to mid-exposure, by the points and times of a state."""
        twist, rigs = self.rigs.ego_twist, self.rigs
        if twist is None or not (rigs.are_rolling or self.times is not None):
            return
        turns, places = self._poses(state)
        in_ego = np.einsum("mji,mj->mi", turns[tracks.image], state.points[tracks.track] - places[tracks.image])
        exposed = self.features(tracks).exposed(
            twist[tracks.image], in_ego, state.mount_turns, state.mount_places, rigs.mounting[tracks.image],
            state.times_s, are_unknown=self.times is not None,
        )  # fmt: skip
        self._features = tracks, exposed

    def _poses(self, state: RigState) -> tuple[Float64, Float64]:
        """Rotations (I, 3, 3) and positions (I, 3) of the vehicle at all images."""
        frame = self.rigs.frame
        return self.turns @ state.frame_turns[frame], self.rigs.world_SE3_ego.translation + state.frame_steps[frame]

    def residuals(self, state: RigState, tracks: FeatureTracks) -> Float64:
        """Return the residuals (M, 2) in pixels."""
        seen = self.features(tracks)
        return residuals_px(
            tracks.image, self.rigs.frame, self.rigs.mounting, seen.ray, seen.metric, seen.from_centre, seen.late,
            tracks.track, *self._poses(state), state.mount_turns, state.mount_places, state.lenses,
            state.times_s - seen.times_s, state.points,
        )  # fmt: skip

    def is_near(self, state: RigState, tracks: FeatureTracks) -> Bool:
        """Mark the observations (M,) of near points; far points may be clouds, which move."""
        apart = state.points[tracks.track] - self.rigs.world_SE3_ego.translation[tracks.image]
        return np.asarray(np.linalg.norm(apart, axis=1) < FARTHEST_M, np.bool_)

    def _cost(self, state: RigState, tracks: FeatureTracks, sigma_px: Float64) -> float:
        off = self.deviation(state)
        square = (self.residuals(state, tracks) ** 2).sum(axis=1) / sigma_px**2
        cost = 0.5 * float(np.log1p(square).sum() + off @ self.information @ off)
        return cost if np.isfinite(cost) else np.inf

    def _equations(
        self, state: RigState, tracks: FeatureTracks, sigma_px: Float64, damping: float
    ) -> tuple[Float64, Float64, Float64, Float64, Float64, Float64, Float64]:
        seen = self.features(tracks)
        return reduce_equations(
            tracks.starts, tracks.image, self.rigs.frame, self.rigs.mounting, seen.ray, seen.metric, seen.from_centre,
            seen.late, sigma_px, *self._poses(state), state.mount_turns, state.mount_places, state.lenses,
            state.times_s - seen.times_s, state.points, len(self.rigs.time_s), damping,
        )  # fmt: skip

    def _sigma_px(self, tracks: FeatureTracks, factor: float = 1.0) -> Float64:
        return factor * self.prior.feature_px * (1.0 + tracks.scale_px)

    def solve(
        self, state: RigState, tracks: FeatureTracks, factor: float, most: int, advance: Callable[[int], None]
    ) -> tuple[RigState, int, bool]:
        """Take steps until the error falls no more; return the state, the number of steps, and convergence."""
        sigma_px, frames, damping = self._sigma_px(tracks, factor), len(self.rigs.time_s), 1e-4
        cost = self._cost(state, tracks, sigma_px)
        for number in range(most):
            off = self.information @ self.deviation(state)
            while True:
                matrix, diagonal, gradient, _, inverses, mixed, slopes = self._equations(
                    state, tracks, sigma_px, damping
                )
                matrix += self.information
                matrix[np.diag_indices(len(matrix))] += damping * (diagonal + np.diag(self.information))
                step = np.asarray(-np.linalg.solve(matrix, gradient + off), np.float64)
                moves = step_points(
                    tracks.starts, tracks.image, self.rigs.frame, self.rigs.mounting, inverses, mixed, slopes, step,
                    frames, len(self.rigs.cameras),
                )  # fmt: skip
                trial = state.moved(step, moves)
                trial_cost = self._cost(trial, tracks, sigma_px)
                if trial_cost <= cost:
                    break
                damping *= 10.0
                if damping > _LARGEST_DAMPING:
                    return state, number, True
            gain, state, cost, damping = cost - trial_cost, trial, trial_cost, max(0.1 * damping, 1e-9)
            advance(1)
            if gain < _LEAST_GAIN * max(cost, 1.0):
                return state, number + 1, True
        return state, most, False

    def covariance(self, state: RigState, tracks: FeatureTracks) -> Float64:
        """Return the sandwich covariance (N, N), whose clusters are the tracks.

        The mean curvature of Cauchy's loss in the plane is its weight times ``1 / (1 + s^2)``, s being the residual
        relative to the loss' scale; the steps use the weight alone, which is larger.
        """
        sigma_px = self._sigma_px(tracks)
        matrix, _, _, scatter, *_ = self._equations(state, tracks, sigma_px, 0.0)
        weight = 1.0 / (1.0 + (self.residuals(state, tracks) ** 2).sum(axis=1) / sigma_px**2)
        curvature = float((weight**2).sum() / weight.sum())
        inverse = np.linalg.inv(curvature * matrix + self.information)
        covariance = inverse @ (scatter + self.information) @ inverse
        return 0.5 * (covariance + covariance.T)


def _logarithms(matrices: Float64) -> Float64:
    """Rotation vectors (N, 3) of rotation matrices."""
    return rotations(matrices).log()[:, :3]


def _select(tracks: FeatureTracks, points: Float64, kept: Bool) -> tuple[FeatureTracks, Float64]:
    """The tracks with the kept observations (M,), if at least two are left, and their points."""
    count = np.bincount(tracks.track[kept], minlength=len(tracks))
    known = np.asarray(np.isfinite(points).all(axis=1), np.bool_)
    kept = kept & (count[tracks.track] >= 2) & known[tracks.track]
    numbers, track = np.unique(tracks.track[kept], return_inverse=True)
    return FeatureTracks(track, tracks.image[kept], tracks.uv_px[kept], tracks.scale_px[kept]), points[numbers]
