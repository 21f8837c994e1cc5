"""Moving rigs with exact features of 3D points, for the adjustment."""

from __future__ import annotations

import numpy as np

from mirror.calibration.refinement.rigs import FeatureTracks, MovingRigs
from mirror.geometry import Poses
from tests.calibration.exact_rig import CAMERAS, mountings, way


def stack(poses: list[Poses]) -> Poses:
    return Poses(np.concatenate([one.rotation for one in poses]), np.concatenate([one.translation for one in poses]))


def true_mountings() -> Poses:
    return stack([mountings()[name] for name in CAMERAS])


def moving_rigs(
    turn_deg: float, *, frames: int = 8, errors_deg: np.ndarray | None = None, seed: int = 3, points: int = 500,
    noise_px: float = 0.0, offset: tuple[float, float, float] = (0.0, 0.0, 0.0), step_m: float = 2.0,
) -> tuple[MovingRigs, FeatureTracks]:  # fmt: skip
    """Three cameras with mountings that are wrong about the vehicle's axes, and the tracks of the true mountings."""
    rng = np.random.default_rng(seed)
    poses, true, count = way(turn_deg, frames, step_m), true_mountings(), len(CAMERAS)
    poses = Poses(poses.rotation, poses.translation + np.array(offset))
    around, distance = rng.uniform(0.0, 2.0 * np.pi, points), rng.uniform(6.0, 35.0, points)
    world = poses.translation.mean(axis=0) + np.stack(
        [distance * np.cos(around), distance * np.sin(around), rng.uniform(-0.5, 8.0, points)], axis=1
    )
    rows = []
    for number, camera in enumerate(CAMERAS.values()):
        seen = camera.project((poses @ true[np.full(frames, number)]).inverse().transform(world))
        for frame, point in zip(*np.nonzero(seen.valid)):
            rows.append((point, frame * count + number, *(seen.uv_px[frame, point] + rng.normal(0.0, noise_px, 2))))
    table = np.array(sorted(rows))
    often = np.bincount(table[:, 0].astype(int))[table[:, 0].astype(int)] >= 2
    table = table[often]
    track = np.unique(table[:, 0], return_inverse=True)[1].astype(np.int64)
    tracks = FeatureTracks(track, table[:, 1].astype(np.int64), table[:, 2:], np.ones(len(table)))
    errors = np.zeros((count, 3)) if errors_deg is None else errors_deg
    turned = Poses.exp(np.concatenate([np.radians(errors), np.zeros((count, 3))], axis=1))
    wrong = Poses((turned @ Poses(true.rotation, np.zeros((count, 3)))).rotation, true.translation)
    frame = np.repeat(np.arange(frames), count)
    rigs = MovingRigs(
        list(CAMERAS.values()), wrong, poses[frame], frame, np.tile(np.arange(count), frames),
        0.4 * np.arange(frames, dtype=np.float64), np.zeros(frames, np.int64),
    )  # fmt: skip
    return rigs, tracks
