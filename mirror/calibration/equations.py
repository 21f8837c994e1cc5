"""The equations of tracked pairs of images: epipolar residuals, their derivatives, and the least-squares solution.

Every track between two images of a camera gives one equation: both rays and the motion of the camera lie in a plane.
The unknowns are the rotation of every camera relative to the given mounting (3 numbers each), small corrections of the
camera positions, corrections of the vehicle's pose in every frame, a scale of every focal length, and a scale of the
way between the poses; the corrections and scales have priors, the rotations practically none. With a `TimePrior` there
are three more of each camera: the offset of its clock, and its readouts along rows and columns. A pixel is seen at the
time of its line, from where the vehicle's velocities have moved the camera then. The residual is Sampson's
distance in pixels (R. Hartley, A. Zisserman, "Multiple View Geometry", 2004, section 11.4) with Cauchy's loss;
Gauss-Newton steps with Levenberg's damping.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.calibration.rig import PosePrior, ScalePrior, TimePrior, TrackedRig, declared_times_s
from mirror.calibration.tracking import PairTracks
from mirror.errors import UsageError
from mirror.geometry import Poses, matrix_from_quaternion
from mirror.geometry.cameras import Camera

_POSE: Final = 6
_TIMES: Final = 3
"""Unknown times of a camera, seconds: offset of its clock, readout of the rows downwards, of the columns rightwards."""
_COLUMNS: Final = 3 * _POSE + 2
"""Unknowns of one pair of images: two poses, the mounting, the scales of the focal length and of the way."""
_ITERATIONS: Final = 30
_LEAST_STEP_RAD: Final = 1e-7
_SHORTEST_M: Final = 0.05
_UNKNOWN_DEG: Final = 5.0
"""1-sigma of the prior of the rotations: it only keeps the equations solvable where a rotation is unobservable."""
_SCALE_STEP: Final = 0.01
"""Rays are interpolated between focal lengths that differ by this share; the error is below 0.001 px."""


class JointProblem:
    """The equations of one rig: rays are computed once, and the equations can be solved for other mountings.

    Args:
        rig: the rig with its tracks.
        prior: errors of poses and mountings; None: the defaults.
        scales: errors of focal lengths and of the length of the way; None: the defaults.
        times: errors of the times of cameras, which are then unknowns; None: the declared times are exact.
        loss_px: scale of Cauchy's loss.

    Raises:
        UsageError: no pair of images has tracks and motion.
    """

    def __init__(
        self,
        rig: TrackedRig,
        prior: PosePrior | None = None,
        scales: ScalePrior | None = None,
        *,
        times: TimePrior | None = None,
        loss_px: float = 0.25,
    ) -> None:
        self.rig = rig
        self.times = times
        self.prior = prior or PosePrior()
        self.scales = scales or ScalePrior()
        self.loss_px = loss_px
        names = rig.names
        self.pairs = [pair for pair in rig.pairs if len(pair) and self._baseline_m(pair) > _SHORTEST_M]
        if not self.pairs:
            longest = max((self._baseline_m(pair) for pair in rig.pairs), default=0.0)
            raise UsageError(
                f"no tracks between images that were taken at different places: {len(rig.pairs)} pairs of images have "
                f"tracks, the longest way between two is {longest:.3f} m",
                expected=f"at least one pair with tracks and a way above {_SHORTEST_M:g} m",
                remedy="choose frames in which the vehicle moves"
                if rig.pairs
                else "choose images that show the same points",
            )
        self.camera = np.array([names.index(pair.camera) for pair in self.pairs])
        self.first = np.array([pair.first for pair in self.pairs])
        self.second = np.array([pair.second for pair in self.pairs])
        self.counts = np.array([len(pair) for pair in self.pairs])
        self.rows = np.repeat(np.arange(len(self.pairs)), self.counts)
        self.shares = [np.empty((len(self.rows), 2)) for _ in range(2)]
        self.rays = [np.empty((len(self.rows), 3, 3)) for _ in range(2)]
        self.slopes = [np.empty((len(self.rows), 3, 3, 2)) for _ in range(2)]
        for number, name in enumerate(names):
            own = self.camera[self.rows] == number
            for side in range(2):
                points = [(one.first_px, one.second_px)[side] for one in self.pairs if one.camera == name]
                if points:
                    ray, slope = rays_at_scales(rig.cameras[name], np.concatenate(points))
                    self.rays[side][own], self.slopes[side][own] = ray, slope
                    self.shares[side][own] = line_shares(rig.cameras[name], np.concatenate(points))

    def _baseline_m(self, pair: PairTracks) -> float:
        places = self.rig.world_SE3_ego[pair.camera].translation
        return float(np.linalg.norm(places[pair.second] - places[pair.first]))

    @cached_property
    def prior_information(self) -> Float64:
        """Information matrix (P, P) of the priors of all unknowns; the information of the rotations is nearly zero."""
        frames, count = len(self.rig.time_s), len(self.rig.cameras)
        matrix = np.zeros((self.size, self.size))
        positions = self.prior.position_information(self.rig.time_s)
        for axis in range(3):
            at = _POSE * np.arange(frames) + 3 + axis
            matrix[np.ix_(at, at)] = positions
            turn = _POSE * np.arange(frames) + axis
            matrix[turn, turn] = np.radians(self.prior.attitude_deg) ** -2
        mount = _POSE * (frames + np.arange(count))
        for axis in range(3):
            matrix[mount + axis, mount + axis] = np.radians(_UNKNOWN_DEG) ** -2
            matrix[mount + 3 + axis, mount + 3 + axis] = self.prior.mounting_m**-2
        focal = self.scale_column + np.arange(count)
        matrix[focal, focal] = (0.01 * self.scales.focal_percent) ** -2
        if self.times is not None:
            sigma = 1e-3 * np.array([self.times.offset_ms, self.times.readout_ms, self.times.readout_ms])
            columns = self.time_columns
            matrix[columns, columns] = np.broadcast_to(sigma**-2, columns.shape)
        matrix[-1, -1] = (0.01 * self.scales.way_percent) ** -2
        return matrix

    @property
    def scale_column(self) -> int:
        """Position of the first focal length's scale among the unknowns; the scale of the way is the last unknown."""
        return _POSE * (len(self.rig.time_s) + len(self.rig.cameras))

    @property
    def size(self) -> int:
        """Number of unknowns P; the scale of the way is the last."""
        times = 0 if self.times is None else _TIMES
        return self.scale_column + (1 + times) * len(self.rig.cameras) + 1

    @property
    def time_columns(self) -> Int64:
        """(C, 3) positions of the unknown times among the unknowns; (C, 0) if the declared times are exact."""
        count = len(self.rig.cameras)
        first = self.scale_column + count
        return first + np.arange(count * (0 if self.times is None else _TIMES)).reshape(count, -1)

    @cached_property
    def declared_times(self) -> Float64:
        """(C, 3) declared times in seconds: no offset, and the readouts of rows downwards and columns rightwards."""
        return np.array([declared_times_s(self.rig.shutter(name)) for name in self.rig.names])

    @cached_property
    def _twists(self) -> Float64:
        """(C, F, 6) the vehicle's velocities; 0 where they are not known."""
        if self.rig.ego_twist is None:
            return np.zeros((len(self.rig.cameras), len(self.rig.time_s), _POSE))
        return np.stack([self.rig.ego_twist[name] for name in self.rig.names])

    def _exposure_times(self, unknowns: Float64) -> list[Float64]:
        """Times (M,) of the tracked pixels from mid-exposure in the first and the second images, seconds."""
        values = self.declared_times
        if self.times is not None:
            values = values + unknowns[self.time_columns]
        own = values[self.camera][self.rows]
        return [own[:, 0] + (own[:, 1:] * share).sum(axis=1) for share in self.shares]

    def solve(self, ego_R_camera: Float64 | None = None) -> Solution:
        """Estimate the unknowns.

        Args:
            ego_R_camera: (C, 3, 3) mountings to start from; None: the recorded ones.
        """
        start = self.mountings if ego_R_camera is None else ego_R_camera
        mount = slice(_POSE * len(self.rig.time_s), self.scale_column)
        unknowns = np.zeros(self.size)
        damping, state = 1e-6, self._linearise(start, unknowns)
        for _ in range(_ITERATIONS):
            while damping < 1e6:
                damped = state.information + damping * np.diag(np.diag(state.information))
                step = -np.linalg.solve(damped, state.gradient)
                trial = self._linearise(start, unknowns + step)
                if trial.cost <= state.cost:
                    break
                damping *= 10.0
            else:
                break
            unknowns, state, damping = unknowns + step, trial, max(0.1 * damping, 1e-9)
            if np.abs(step[mount].reshape(-1, _POSE)[:, :3]).max() < _LEAST_STEP_RAD:
                break
        return Solution(self, start, unknowns, state)

    @cached_property
    def mountings(self) -> Float64:
        """(C, 3, 3) rotations of the recorded mountings."""
        return np.concatenate([matrix_from_quaternion(one.rotation) for one in self.rig.ego_SE3_camera.values()])

    def _poses(self, start: Float64, unknowns: Float64) -> tuple[Float64, Float64, Float64, Float64]:
        """Mountings: rotations (C, 3, 3) and positions (C, 3); the vehicle's: rotations (C, F, 3, 3), positions."""
        rig, frames = self.rig, len(self.rig.time_s)
        poses = unknowns[: _POSE * frames].reshape(-1, _POSE)
        mount = unknowns[_POSE * frames : self.scale_column].reshape(-1, _POSE)
        ego_R_camera = start @ exp_rotations(mount[:, :3])
        ego_t_camera = np.concatenate([one.translation for one in rig.ego_SE3_camera.values()]) + mount[:, 3:]
        recorded = [rig.world_SE3_ego[name] for name in rig.names]
        turns = np.stack([matrix_from_quaternion(one.rotation) for one in recorded]) @ exp_rotations(poses[:, :3])
        places = np.stack([one.translation for one in recorded])
        way = np.exp(unknowns[-1]) * (places - places[:, :1])
        return ego_R_camera, ego_t_camera, turns, way + poses[:, 3:]

    def _at_focal(self, values: Float64, unknowns: Float64) -> tuple[Float64, Float64]:
        """Values (M, ...) at the focal lengths, and their derivatives by its logarithm, from values (M, 3, ...)."""
        shape = (-1,) + (1,) * (values.ndim - 2)
        scale = (
            unknowns[self.scale_column : self.scale_column + len(self.rig.cameras)][self.camera][self.rows].reshape(
                shape
            )
            / _SCALE_STEP
        )
        smaller, given, larger = np.moveaxis(values, 1, 0)
        slope, bend = 0.5 * (larger - smaller), larger - 2.0 * given + smaller
        return given + scale * (slope + 0.5 * scale * bend), (slope + scale * bend) / _SCALE_STEP

    def _linearise(self, start: Float64, unknowns: Float64) -> Linearised:
        rows = self.rows
        frames = len(self.rig.time_s)
        ego_R_camera, ego_t_camera, turns, places = self._poses(start, unknowns)
        arm = ego_t_camera[self.camera][rows]
        in_ego, arms, mounts, world, slopes, turn_of, at = [], [], [], [], [], [], []
        rays, world_by_focal, slopes_by_focal = [], [], []
        times = self._exposure_times(unknowns)
        twists = [self._twists[self.camera, frame][rows] for frame in (self.first, self.second)]
        for side, frame in enumerate((self.first, self.second)):
            turn = turns[self.camera, frame]
            ray, ray_by_focal = self._at_focal(self.rays[side], unknowns)
            slope, slope_by_focal = self._at_focal(self.slopes[side], unknowns)
            rays.append(ray)
            # where the vehicle is at the time of the pixel, in its frame at mid-exposure
            moves = exp_rotations(times[side][:, None] * twists[side][:, :3])
            mount = moves @ ego_R_camera[self.camera][rows]
            mounts.append(mount)
            arms.append(times[side][:, None] * twists[side][:, 3:] + np.einsum("mij,mj->mi", moves, arm))
            in_ego.append(np.einsum("mij,mj->mi", mount, ray))
            whole = turn[rows] @ mount
            world.append(np.einsum("mij,mj->mi", whole, ray))
            world_by_focal.append(np.einsum("mij,mj->mi", whole, ray_by_focal))
            slopes.append(whole @ slope)
            slopes_by_focal.append(whole @ slope_by_focal)
            turn_of.append(turn[rows])
            at.append(places[self.camera, frame][rows] + np.einsum("mij,mj->mi", turn[rows], arms[side]))
        length = np.linalg.norm(at[1] - at[0], axis=1)
        b = (at[1] - at[0]) / length[:, None]
        normal = np.cross(world[0], world[1])
        error = np.einsum("mi,mi->m", b, normal)
        by_world = [np.cross(world[1], b), np.cross(b, world[0])]
        by_pixel = [np.einsum("mi,mij->mj", one, slope) for one, slope in zip(by_world, slopes)]
        scale = np.sqrt(sum((one**2).sum(axis=1) for one in by_pixel))
        scale = np.maximum(scale, 1e-12)
        residual = error / scale
        # The motion's direction: its derivative by the camera's position is perpendicular to it.
        by_base = (normal - error[:, None] * b) / length[:, None]
        jacobian = np.empty((len(rows), _COLUMNS + (0 if self.times is None else _TIMES)))
        for side, sign in enumerate((-1.0, 1.0)):
            turn = turn_of[side]
            back = np.einsum("mji,mj->mi", turn, by_world[side])
            back_base = np.einsum("mji,mj->mi", turn, by_base)
            # The rotation of a frame turns the ray and the arm of the camera; the position is given in the world frame.
            jacobian[:, _POSE * side : _POSE * side + 3] = np.cross(in_ego[side], back) + sign * np.cross(
                arms[side], back_base
            )
            jacobian[:, _POSE * side + 3 : _POSE * side + 6] = sign * by_base
            if self.times is not None:
                # what a later pixel changes: the vehicle has turned on, and has moved on
                spin, speed = twists[side][:, :3], twists[side][:, 3:]
                late = (np.cross(spin, in_ego[side]) * back).sum(axis=1)
                carried = arms[side] - times[side][:, None] * speed
                late += sign * ((speed + np.cross(spin, carried)) * back_base).sum(axis=1)
                parts = late[:, None] * np.concatenate([np.ones((len(rows), 1)), self.shares[side]], axis=1)
                jacobian[:, _COLUMNS:] = parts if side == 0 else jacobian[:, _COLUMNS:] + parts
        jacobian[:, 12:15] = sum(
            np.cross(ray, np.einsum("mji,mj->mi", mount, np.einsum("mji,mj->mi", turn, one)))
            for ray, mount, turn, one in zip(rays, mounts, turn_of, by_world)
        )
        back_to_ego = np.swapaxes(ego_R_camera, -1, -2)[self.camera][rows]
        moved_arm = [turn @ mount @ back_to_ego for turn, mount in zip(turn_of, mounts)]
        jacobian[:, 15:18] = np.einsum("mji,mj->mi", moved_arm[1] - moved_arm[0], by_base)
        jacobian[:, 18] = sum((one * other).sum(axis=1) for one, other in zip(by_world, world_by_focal))
        moved = unknowns[: _POSE * frames].reshape(-1, _POSE)[:, 3:]
        way = np.diff([places[self.camera, at] - moved[at] for at in (self.first, self.second)], axis=0)[0]
        jacobian[:, 19] = (way[rows] * by_base).sum(axis=1)
        jacobian /= scale[:, None]
        # A larger focal length makes all angles smaller: without this term all lenses would seem too short.
        turned_by_focal = [np.cross(world_by_focal[1], b), np.cross(b, world_by_focal[0])]
        pixel_by_focal = [
            np.einsum("mi,mij->mj", a, slope) + np.einsum("mi,mij->mj", one, slope_by)
            for a, slope, one, slope_by in zip(turned_by_focal, slopes, by_world, slopes_by_focal)
        ]
        shrinks = sum((one * other).sum(axis=1) for one, other in zip(by_pixel, pixel_by_focal)) / scale**2
        jacobian[:, 18] -= residual * shrinks
        square = (residual / self.loss_px) ** 2
        weight = 1.0 / (1.0 + square) / self.loss_px**2
        starts = np.concatenate([[0], np.cumsum(self.counts)[:-1]])
        weighted = jacobian * weight[:, None]
        blocks = np.add.reduceat(np.einsum("mi,mj->mij", weighted, jacobian), starts, axis=0)
        gradients = np.add.reduceat(weighted * residual[:, None], starts, axis=0)
        columns = np.concatenate(
            [
                _POSE * self.first[:, None] + np.arange(_POSE),
                _POSE * self.second[:, None] + np.arange(_POSE),
                _POSE * (frames + self.camera)[:, None] + np.arange(_POSE),
                self.scale_column + self.camera[:, None],
                np.full((len(self.pairs), 1), self.size - 1),
                self.time_columns[self.camera],
            ],
            axis=1,
        )
        information, gradient = self.prior_information.copy(), self.prior_information @ unknowns
        np.add.at(information, (columns[:, :, None], columns[:, None, :]), blocks)
        np.add.at(gradient, columns, gradients)
        cost = float(0.5 * np.log1p(square).sum() + 0.5 * unknowns @ self.prior_information @ unknowns)
        cost = cost if np.isfinite(cost) else np.inf
        return Linearised(information, gradient, cost, gradients, blocks, columns, residual)


@dataclass(frozen=True, eq=False)
class Linearised:
    """The normal equations of P unknowns, linearised at some values of the unknowns.

    Attributes:
        information: (P, P) matrix of second derivatives, priors included.
        gradient: (P,) derivatives of the cost.
        cost: negative logarithm of the posterior density.
        gradients: (K, 20) part of the gradient of each of K pairs of images; 23 columns with unknown times.
        blocks: (K, 20, 20) their parts of the information.
        columns: (K, 20) positions of these parts among the unknowns.
        residual: (M,) distances from the epipolar lines, pixels.
    """

    information: Float64
    gradient: Float64
    cost: float
    gradients: Float64
    blocks: Float64
    columns: Int64
    residual: Float64


@dataclass(frozen=True, eq=False)
class Solution:
    """The unknowns that fit best, with their equations.

    Attributes:
        problem: what was solved.
        start: (C, 3, 3) mountings at the start.
        unknowns: (P,) corrections of poses, then of mountings, six numbers each, then logarithms of the scales of the
            focal lengths and of the way.
        state: the equations at these values.
    """

    problem: JointProblem
    start: Float64
    unknowns: Float64
    state: Linearised

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.problem.rig.time_s)

    def distances_m(self) -> Float64:
        """Return the distances (M,) of the tracked points; infinite where the two rays are parallel."""
        problem = self.problem
        ego_R_camera, ego_t_camera, turns, places = problem._poses(self.start, self.unknowns)
        ways, at = [], []
        times = problem._exposure_times(self.unknowns)
        for side, frame in enumerate((problem.first, problem.second)):
            turn = turns[problem.camera, frame]
            spin = problem._twists[problem.camera, frame][problem.rows, :3]
            moves = exp_rotations(times[side][:, None] * spin)
            whole = turn[problem.rows] @ moves @ ego_R_camera[problem.camera][problem.rows]
            ray, _ = problem._at_focal(problem.rays[side], self.unknowns)
            ways.append(np.einsum("mij,mj->mi", whole, ray))
            at.append(places[problem.camera, frame] + np.einsum("kij,kj->ki", turn, ego_t_camera[problem.camera]))
        base = (at[1] - at[0])[problem.rows]
        across = np.linalg.norm(np.cross(base, ways[1]), axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.nan_to_num(across / np.linalg.norm(np.cross(*ways), axis=1), nan=np.inf, posinf=np.inf)

    @property
    def rotation(self) -> Float64:
        """(C, 3) rotation vectors in the camera frames relative to the mountings at the start."""
        return self.unknowns[_POSE * self.frames : self.problem.scale_column].reshape(-1, _POSE)[:, :3]

    @property
    def columns(self) -> Int64:
        """(C, 3) positions of the rotations among the unknowns."""
        count = len(self.problem.rig.cameras)
        return _POSE * (self.frames + np.arange(count))[:, None] + np.arange(3)


def line_shares(camera: Camera, uv_px: Float64) -> Float64:
    """Compute the place (N, 2) of points among the rows and among the columns, from -0.5 to 0.5."""
    rows = (uv_px[:, 1] - 0.5) / max(camera.height_px - 1, 1) - 0.5
    columns = (uv_px[:, 0] - 0.5) / max(camera.width_px - 1, 1) - 0.5
    return np.stack([rows, columns], axis=1)


def rays_with_slopes(camera: Camera, uv_px: Float64) -> tuple[Float64, Float64]:
    """Compute unit rays (N, 3) of points (N, 2), and their derivatives (N, 3, 2) by the pixel (central differences)."""
    step = 0.25
    slopes = [
        (camera.unproject(uv_px + aside).direction - camera.unproject(uv_px - aside).direction) / (2.0 * step)
        for aside in step * np.eye(2)
    ]
    return camera.unproject(uv_px).direction, np.stack(slopes, axis=-1)


def rays_at_scales(camera: Camera, uv_px: Float64) -> tuple[Float64, Float64]:
    """Compute the rays of points (N, 2) and their derivatives by the pixel for three focal lengths.

    Returns:
        Rays (N, 3, 3) and derivatives (N, 3, 3, 2): along the second axis with a focal length that is 1 % smaller, as
        given, and 1 % larger.
    """
    middle = np.array([camera.cx_px, camera.cy_px])
    given, given_slope = rays_with_slopes(camera, uv_px)
    rays, slopes = [given], [given_slope]
    for scale in (-_SCALE_STEP, _SCALE_STEP):
        shrinks = np.exp(-scale)
        at = middle + (uv_px - middle) * shrinks
        ray, slope = rays_with_slopes(camera, at)
        # A lens may be undefined a few pixels beyond its image.
        rays.append(np.where(np.isfinite(ray), ray, given + np.einsum("nij,nj->ni", given_slope, at - uv_px)))
        slopes.append(shrinks * np.where(np.isfinite(slope), slope, given_slope))
    order = [1, 0, 2]
    return np.stack([rays[one] for one in order], axis=1), np.stack([slopes[one] for one in order], axis=1)


def exp_rotations(vectors: Float64) -> Float64:
    """Return the rotation matrices (N, 3, 3) of rotation vectors (N, 3)."""
    return matrix_from_quaternion(Poses.exp(np.concatenate([vectors, np.zeros_like(vectors)], axis=1)).rotation)
