"""Bundle adjustment of a rig: poses of frames, mountings, lenses and points, from tracks and recorded values.

The maximum a posteriori estimate: feature errors of some tenths of a pixel with heavy tails (Cauchy), recorded values
with normal errors. Levenberg-Marquardt with eliminated points (B. Triggs et al., "Bundle Adjustment - A Modern
Synthesis", 1999). It supports any lens of `mirror.geometry` and priors of all values; pycolmap's has neither.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from benchmarks.synth_matching.tracks import Rig, Tracks
from mirror.arrays import Float64, Int64
from mirror.errors import UsageError
from mirror.geometry import Poses, matrix_from_quaternion

_POSE: Final = 6
_LENS: Final = 3
_STEP: Final = 1e-6
_ITERATIONS: Final = 40
_LEAST_GAIN: Final = 1e-5


@dataclass(frozen=True)
class Spread:
    """Standard deviations of the recorded values.

    Attributes:
        position_m: positions of the frames, along each axis.
        attitude_rad: rotations of the frames, about each axis.
        mounting_rad: rotations of the mountings.
        mounting_m: positions of the mountings.
        focal_share: focal lengths, as a share.
        centre_share: principal points along each axis, as a share of the width.
        feature_px: position of a feature of size 0; it grows in proportion to 1 + size.
    """

    position_m: float
    attitude_rad: float
    mounting_rad: float
    mounting_m: float
    focal_share: float
    centre_share: float
    feature_px: float = 0.15


class _NormalEquations(NamedTuple):
    """Normal equations: blocks of the rig, of rig and points, and of each point; and the gradients."""

    rig: Float64
    mixed: Any
    points: Float64
    gradient: Float64
    gradient_points: Float64


def adjust_rig(recorded: Rig, tracks: Tracks, spread: Spread) -> tuple[Rig, Float64]:
    """Adjust a rig to tracks.

    Args:
        recorded: recorded rig.
        tracks: tracks, triangulated with the recorded rig.
        spread: standard deviations of the recorded rig and the features.

    Returns:
        The rig, and the distances (M,) of observations from the projections of their points, pixels.

    Raises:
        UsageError: there are no tracks, or a point of a track cannot be projected into its camera.
    """
    rig, points, damping = recorded, tracks.points, 1e-4
    cost = _cost(rig, points, tracks, recorded, spread)
    if not len(points) or not np.isfinite(cost):
        raise UsageError(f"{len(points)} points", expected="at least one, each in front of the cameras of its track")
    for _ in range(_ITERATIONS):
        normal = _build_normal_equations(rig, points, tracks, recorded, spread)
        while damping < 1e8:
            step, step_points = _solve(normal, damping)
            trial, trial_points = _apply_step(rig, step), points + step_points
            trial_cost = _cost(trial, trial_points, tracks, recorded, spread)
            if trial_cost < cost:
                break
            damping *= 10.0
        else:
            break
        gain, cost, rig, points = cost - trial_cost, trial_cost, trial, trial_points
        damping = max(0.1 * damping, 1e-9)
        if gain < _LEAST_GAIN * cost:
            break
    return rig, np.linalg.norm(_observe(rig, points, tracks).uv_px - tracks.uv_px, axis=1)


class _Observations(NamedTuple):
    """The points of observations in the ego frame and in the camera frame, and their projections."""

    in_ego: Float64
    in_camera: Float64
    uv_px: Float64


def _observe(rig: Rig, points: Float64, tracks: Tracks) -> _Observations:
    ego, mount = rig.world_SE3_ego[tracks.frame], rig.ego_SE3_camera[tracks.camera]
    in_ego = _transform_into(ego, points[tracks.point])
    in_camera = _transform_into(mount, in_ego)
    return _Observations(in_ego, in_camera, _project(rig, in_camera, tracks.camera))


def _transform_into(poses: Poses, points: Float64) -> Float64:
    return np.einsum("mji,mj->mi", matrix_from_quaternion(poses.rotation), points - poses.translation)


def _project(rig: Rig, in_camera: Float64, which: Int64) -> Float64:
    uv = np.empty((len(in_camera), 2))
    for number, camera in enumerate(rig.cameras.values()):
        uv[which == number] = camera.project(in_camera[which == number]).uv_px
    return uv


def _cost(rig: Rig, points: Float64, tracks: Tracks, recorded: Rig, spread: Spread) -> float:
    square = (((_observe(rig, points, tracks).uv_px - tracks.uv_px) / _sigma_px(tracks, spread)) ** 2).sum(axis=1)
    off, weight = _prior_residuals(rig, recorded, spread)
    cost = np.log1p(square).sum() + (weight * off**2).sum()
    return float(cost) if np.isfinite(cost) else np.inf


def _sigma_px(tracks: Tracks, spread: Spread) -> Float64:
    return spread.feature_px * (1.0 + tracks.scale_px)[:, None]


def _build_normal_equations(
    rig: Rig, points: Float64, tracks: Tracks, recorded: Rig, spread: Spread
) -> _NormalEquations:
    frames, count = len(rig.world_SE3_ego), len(rig.cameras)
    observed = _observe(rig, points, tracks)
    sigma = _sigma_px(tracks, spread)
    error = (observed.uv_px - tracks.uv_px) / sigma
    root = 1.0 / np.sqrt(1.0 + (error**2).sum(axis=1))
    scale = root[:, None, None] / sigma[..., None]
    by_camera = _projection_jacobian(rig, observed.in_camera, tracks.camera) * scale
    by_ego = by_camera @ np.swapaxes(matrix_from_quaternion(rig.ego_SE3_camera.rotation), 1, 2)[tracks.camera]
    by_point = by_ego @ np.swapaxes(matrix_from_quaternion(rig.world_SE3_ego.rotation), 1, 2)[tracks.frame]
    centres = np.array([(camera.cx_px, camera.cy_px) for camera in rig.cameras.values()])[tracks.camera]
    lens = np.concatenate(
        [(observed.uv_px - centres)[..., None], np.broadcast_to(np.eye(2), (len(root), 2, 2))], axis=2
    )
    parts = [
        by_ego @ _cross_matrices(observed.in_ego),
        -by_ego,
        by_camera @ _cross_matrices(observed.in_camera),
        -by_camera,
        lens * scale,
    ]
    firsts = [
        (_POSE * tracks.frame, _POSE),
        (_POSE * (frames + tracks.camera), _POSE),
        (_POSE * (frames + count) + _LENS * tracks.camera, _LENS),
    ]
    a = _to_sparse(np.concatenate(parts, axis=2), firsts, _POSE * (frames + count) + _LENS * count)
    b = _to_sparse(by_point, [(3 * tracks.point, 3)], 3 * len(points))
    residual = (error * root[:, None]).ravel()
    off, weight = _prior_residuals(rig, recorded, spread)
    blocks = np.zeros((len(points), 3, 3))
    np.add.at(blocks, tracks.point, np.swapaxes(by_point, 1, 2) @ by_point)
    return _NormalEquations(
        (a.T @ a).toarray() + np.diag(weight), a.T @ b, blocks, a.T @ residual + weight * off, b.T @ residual
    )


def _projection_jacobian(rig: Rig, in_camera: Float64, which: Int64) -> Float64:
    """Derivatives (M, 2, 3) of projections by points in the camera frame: central differences."""
    out = np.empty((len(in_camera), 2, 3))
    step = _STEP * np.linalg.norm(in_camera, axis=1)
    for axis in range(3):
        aside = step[:, None] * np.eye(3)[axis]
        apart = _project(rig, in_camera + aside, which) - _project(rig, in_camera - aside, which)
        out[..., axis] = apart / (2.0 * step[:, None])
    return out


def _prior_residuals(rig: Rig, recorded: Rig, spread: Spread) -> tuple[Float64, Float64]:
    """Deviations from the recorded values, and their weights."""
    ego = (recorded.world_SE3_ego.inverse() @ rig.world_SE3_ego).log()
    mount = (recorded.ego_SE3_camera.inverse() @ rig.ego_SE3_camera).log()
    lenses = [
        (np.log(now.fx_px / was.fx_px), now.cx_px - was.cx_px, now.cy_px - was.cy_px)
        for was, now in zip(recorded.cameras.values(), rig.cameras.values())
    ]
    centre = [spread.centre_share * camera.width_px for camera in rig.cameras.values()]
    sigma = np.concatenate(
        [
            np.tile(np.repeat([spread.attitude_rad, spread.position_m], 3), len(ego)),
            np.tile(np.repeat([spread.mounting_rad, spread.mounting_m], 3), len(mount)),
            np.stack([np.full(len(centre), spread.focal_share), centre, centre], axis=1).ravel(),
        ]
    )
    return np.concatenate([ego.ravel(), mount.ravel(), np.ravel(lenses)]), sigma**-2.0


def _solve(normal: _NormalEquations, damping: float) -> tuple[Float64, Float64]:
    from scipy import sparse

    count, diagonal = len(normal.points), np.arange(3)
    damped = normal.points.copy()
    damped[:, diagonal, diagonal] *= 1.0 + damping
    inverse = sparse.bsr_matrix((np.linalg.inv(damped), np.arange(count), np.arange(count + 1)))
    through = (normal.mixed @ inverse).toarray()
    reduced = normal.rig + damping * np.diag(np.diag(normal.rig)) - through @ normal.mixed.toarray().T
    step = -np.linalg.solve(reduced, normal.gradient - through @ normal.gradient_points)
    step_points = -(inverse @ (normal.gradient_points + normal.mixed.T @ step))
    return step, step_points.reshape(-1, 3)


def _apply_step(rig: Rig, step: Float64) -> Rig:
    frames, count = len(rig.world_SE3_ego), len(rig.cameras)
    ego, mount, lens = np.split(step, [_POSE * frames, _POSE * (frames + count)])
    cameras = {
        name: replace(
            camera,
            fx_px=camera.fx_px * np.exp(longer),
            fy_px=camera.fy_px * np.exp(longer),
            cx_px=camera.cx_px + right,
            cy_px=camera.cy_px + down,
        )
        for (name, camera), (longer, right, down) in zip(rig.cameras.items(), lens.reshape(-1, _LENS))
    }
    return Rig(
        cameras,
        rig.ego_SE3_camera @ Poses.exp(mount.reshape(-1, _POSE)),
        rig.world_SE3_ego @ Poses.exp(ego.reshape(-1, _POSE)),
    )


def _to_sparse(rows: Float64, firsts: Sequence[tuple[Int64, int]], width: int) -> Any:
    """A sparse matrix with two rows per observation (M, 2, K); the K columns form contiguous blocks."""
    from scipy import sparse

    count, two, wide = rows.shape
    columns = np.concatenate([first[:, None] + np.arange(length) for first, length in firsts], axis=1)
    indices = np.repeat(columns, two, axis=0).ravel()
    return sparse.csr_matrix((rows.ravel(), indices, wide * np.arange(two * count + 1)), (two * count, width))


def _cross_matrices(vectors: Float64) -> Float64:
    """Matrices (M, 3, 3) of the cross product with vectors (M, 3)."""
    x, y, z = vectors.T
    out = np.zeros((len(vectors), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -z, y, -x
    out[:, 1, 0], out[:, 2, 0], out[:, 2, 1] = z, -y, x
    return out
