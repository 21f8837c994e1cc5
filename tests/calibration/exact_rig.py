"""A rig of three cameras on an exact turn or a straight road, with exact image points of 3D points around it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.calibration.rig import TrackedRig
from mirror.calibration.tracking import PairTracks
from mirror.geometry import Poses, quaternion_from_matrix
from mirror.geometry.cameras import Camera

CAMERAS = {
    "ahead": Camera("kannala_brandt", 960, 540, 420.0, 420.0, 481.0, 268.0, (-0.012, 0.004, -0.002, 0.0005)),
    "left": Camera("f_theta", 960, 540, 1.0, 1.0, 478.0, 271.0, (0.0, 430.0, 0.0, -15.0)),
    "right": Camera("brown_conrady", 960, 540, 430.0, 430.0, 480.0, 270.0, (-0.13, 0.012, 0.0003, -0.0002, 0.0)),
}
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def about_z(yaw_deg: npt.ArrayLike) -> np.ndarray:
    """Rotations (..., 3, 3) by angles (...)."""
    yaw = np.radians(yaw_deg)
    cos, sin, zero, one = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw), np.ones_like(yaw)
    rows = np.stack([cos, -sin, zero, sin, cos, zero, zero, zero, one], axis=-1)
    return rows.reshape(*yaw.shape, 3, 3)


def mountings() -> dict[str, Poses]:
    places = {"ahead": (1.8, 0.0, 1.4), "left": (2.2, 0.9, 1.0), "right": (2.2, -0.9, 1.0)}
    yaws = {"ahead": 0.0, "left": 60.0, "right": -60.0}
    return {
        n: Poses(quaternion_from_matrix((about_z(yaws[n]) @ OPTICAL)[None]), np.array([places[n]])) for n in CAMERAS
    }


def way(turn_deg: float, frames: int, step_m: float = 2.0) -> Poses:
    """Poses on an arc that turns by ``turn_deg`` in all, with a little pitch and roll."""
    yaws = np.linspace(0.0, turn_deg, frames)
    headings = np.radians(yaws)
    steps = step_m * np.stack([np.cos(headings), np.sin(headings), np.zeros(frames)], axis=1)
    places = np.cumsum(steps, axis=0)
    return Poses(quaternion_from_matrix(about_z(yaws)), places)


def exact_rig(
    turn_deg: float,
    *,
    frames: int = 12,
    errors_deg: dict[str, np.ndarray] | None = None,
    noise_px: float = 0.0,
    points: int = 900,
    seed: int = 3,
) -> TrackedRig:
    """A rig whose given mountings have errors about the vehicle's axes; its tracks are those of the true mountings."""
    rng = np.random.default_rng(seed)
    poses, true = way(turn_deg, frames), mountings()
    middle = poses.translation.mean(axis=0)
    around, distance = rng.uniform(0.0, 2.0 * np.pi, points), rng.uniform(8.0, 45.0, points)
    world = middle + np.stack(
        [distance * np.cos(around), distance * np.sin(around), rng.uniform(-0.5, 10.0, points)], axis=1
    )
    pairs = []
    for name, camera in CAMERAS.items():
        seen = camera.project((poses @ true[name]).inverse().transform(world))
        for frame in range(frames - 1):
            both = seen.valid[frame] & seen.valid[frame + 1]
            uv = [seen.uv_px[at][both] + rng.normal(0.0, noise_px, (both.sum(), 2)) for at in (frame, frame + 1)]
            pairs.append(PairTracks(name, frame, frame + 1, uv[0], uv[1]))
    given = {
        name: Poses.exp(np.concatenate([np.radians((errors_deg or {}).get(name, np.zeros(3))), np.zeros(3)])[None])
        for name in CAMERAS
    }
    wrong = {name: Poses((given[name] @ Poses(true[name].rotation, np.zeros((1, 3)))).rotation, true[name].translation)
             for name in CAMERAS}  # fmt: skip
    times = 0.4 * np.arange(frames, dtype=np.float64)
    return TrackedRig(CAMERAS, wrong, times, dict.fromkeys(CAMERAS, poses), pairs)
