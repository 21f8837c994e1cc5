"""Tracks and features of rolling shutters on a bend of changing speed."""

from __future__ import annotations

from functools import cache

import numpy as np

from mirror.calibration.refinement.rigs import FeatureTracks, MovingRigs
from mirror.calibration.rig import TrackedRig
from mirror.calibration.tracking import PairTracks
from mirror.geometry import Poses, quaternion_from_matrix
from mirror.geometry.rolling_shutter import RollingShutter, project_rolling
from tests.calibration.exact_rig import CAMERAS, about_z, mountings
from tests.calibration.moving_rigs import stack

FRAMES, STEP_S = 14, 0.4


@cache
def _way(turning: bool) -> np.ndarray:
    """Times in seconds, headings in radians, x and y in metres, (4, 4001), of a drive of 6 m/s and more.

    Its rate of turn grows from 0 to 40 degrees a second and falls again.
    """
    grid = np.linspace(-0.2, FRAMES * STEP_S + 0.2, 4001)
    rate = (
        np.radians(40.0) * np.sin(np.pi * np.clip(grid / (FRAMES * STEP_S), 0.0, 1.0)) ** 2 if turning else 0.0 * grid
    )
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(grid))])
    speed = 6.0 + (0.8 * grid if turning else 0.0 * grid)
    steps = [speed * np.cos(yaw), speed * np.sin(yaw)]
    x, y = (np.concatenate([[0.0], np.cumsum(0.5 * (one[1:] + one[:-1]) * np.diff(grid))]) for one in steps)
    return np.stack([grid, yaw, x, y])


def poses_at(times_s: np.ndarray, turning: bool) -> Poses:
    """Poses of the drive at times."""
    grid, yaw, x, y = _way(turning)
    heading = np.degrees(np.interp(times_s, grid, yaw))
    places = np.stack([np.interp(times_s, grid, x), np.interp(times_s, grid, y), 0.0 * times_s], axis=1)
    return Poses(quaternion_from_matrix(about_z(heading)), places)


def rolling_rig(
    shutters: dict[str, RollingShutter],
    offset_ms: float = 0.0,
    noise_px: float = 0.15,
    turning: bool = True,
    noise_seed: int | None = None,
) -> TrackedRig:
    """A rig whose tracks are those of true shutters and of a clock that is late; it declares global shutters."""
    rng = np.random.default_rng(5)
    stamps = STEP_S * np.arange(FRAMES, dtype=np.float64)
    poses, true = poses_at(stamps, turning), mountings()
    world = street_points(rng, 900, turning)
    rng = rng if noise_seed is None else np.random.default_rng(noise_seed)
    pairs, twists = [], {}
    for name, camera in CAMERAS.items():
        shutter = shutters.get(name, RollingShutter("global", 0, camera.width_px, camera.height_px))
        seen = []
        for stamp in stamps:

            def points_at(offsets_ns: np.ndarray, stamp: float = float(stamp), name: str = name) -> np.ndarray:
                cameras = poses_at(stamp + 1e-3 * offset_ms + 1e-9 * offsets_ns, turning) @ true[name]
                return np.asarray(cameras.inverse().transform(world[:, None])[:, 0])

            seen.append(project_rolling(camera, shutter, len(world), points_at))
        for frame in range(FRAMES - 1):
            both = seen[frame][1] & seen[frame + 1][1]
            uv = [seen[at][0][both] + rng.normal(0.0, noise_px, (both.sum(), 2)) for at in (frame, frame + 1)]
            pairs.append(PairTracks(name, frame, frame + 1, uv[0], uv[1]))
        ends = [poses_at(stamps + side, turning) for side in (-0.05, 0.05)]
        twists[name] = (ends[0].inverse() @ ends[1]).log() / 0.1
    return TrackedRig(CAMERAS, true, stamps, dict.fromkeys(CAMERAS, poses), pairs, twists)


def shutter(name: str, direction: str, readout_ms: float) -> RollingShutter:
    camera = CAMERAS[name]
    return RollingShutter(direction, round(1e6 * readout_ms), camera.width_px, camera.height_px)  # type: ignore[arg-type]


TRUE = {
    "ahead": shutter("ahead", "top_to_bottom", 30.0),
    "left": shutter("left", "right_to_left", 20.0),
    "right": shutter("right", "bottom_to_top", 25.0),
}


def street_points(rng: np.random.Generator, count: int, turning: bool = True) -> np.ndarray:
    """Points (count, 3) around the drive, 8 to 45 m from its middle."""
    middle = poses_at(STEP_S * np.arange(FRAMES), turning).translation.mean(axis=0)
    around, distance = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(8.0, 45.0, count)
    return middle + np.stack(
        [distance * np.cos(around), distance * np.sin(around), rng.uniform(-0.5, 10.0, count)], axis=1
    )


def rolling_features(
    shutters: dict[str, RollingShutter],
    offset_ms: float = 0.0,
    noise_px: float = 0.0,
    *,
    seed: int = 7,
    points: int = 400,
    frames: int = FRAMES,
    alone: bool = False,
    turning: bool = True,
) -> tuple[MovingRigs, FeatureTracks]:
    """The same drive as features that a track has one of in an image; the rigs state no shutters.

    Args:
        shutters: the true shutters.
        offset_ms: how late the clock of the cameras is.
        noise_px: standard deviation of each coordinate of a feature.
        seed: of the noise.
        points: number of points.
        frames: number of frames.
        alone: whether the features of a point in two cameras are two tracks.
        turning: whether the vehicle turns.
    """
    rng, world = np.random.default_rng(seed), street_points(np.random.default_rng(5), points, turning)
    stamps, true, count = STEP_S * np.arange(frames, dtype=np.float64), mountings(), len(CAMERAS)
    ends = [poses_at(stamps + side, turning) for side in (-0.05, 0.05)]
    twist = (ends[0].inverse() @ ends[1]).log() / 0.1
    rows = []
    for number, (name, camera) in enumerate(CAMERAS.items()):
        own = shutters.get(name, RollingShutter("global", 0, camera.width_px, camera.height_px))
        for frame, stamp in enumerate(stamps):

            def points_at(offsets_ns: np.ndarray, stamp: float = float(stamp), name: str = name) -> np.ndarray:
                cameras = poses_at(stamp + 1e-3 * offset_ms + 1e-9 * offsets_ns, turning) @ true[name]
                return np.asarray(cameras.inverse().transform(world[:, None])[:, 0])

            uv, valid, _ = project_rolling(camera, own, points, points_at)
            first = points * number if alone else 0
            rows += [(first + point, frame * count + number, *uv[point]) for point in np.flatnonzero(valid)]
    table = np.array(sorted(rows))
    table = table[np.bincount(table[:, 0].astype(int))[table[:, 0].astype(int)] >= 2]
    track = np.unique(table[:, 0], return_inverse=True)[1].astype(np.int64)
    uv_px = table[:, 2:] + rng.normal(0.0, noise_px, (len(table), 2))
    tracks = FeatureTracks(track, table[:, 1].astype(np.int64), uv_px, np.ones(len(table)))
    frame_of = np.repeat(np.arange(frames), count)
    rigs = MovingRigs(
        list(CAMERAS.values()), stack([true[name] for name in CAMERAS]), poses_at(stamps, turning)[frame_of], frame_of,
        np.tile(np.arange(count), frames), stamps, np.zeros(frames, np.int64), twist[frame_of],
    )  # fmt: skip
    return rigs, tracks
