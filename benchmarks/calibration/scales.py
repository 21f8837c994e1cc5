"""Coverage of the check's intervals where focal lengths and the length of the way are wrong, on exact tracks.

``python -m benchmarks calibration scales [--draws N]``: a vehicle drives straight, through a bend and straight on, with
one narrow camera or a rig of three wide ones. Its tracks are exact points with 0.1 px of noise. Every recorded focal
length is off by up to 1 % (both signs), the recorded way by up to 1 %, poses and positions of cameras by the default
priors, the mountings by 0.05 to 1 degree, and all tracks of a camera share a rotation by the tracker's bias. The check
states several priors. A trial is one rig in one draw; an interval is that of one axis of one camera. Finished trials
are kept in ``benchmarks/out/calibration_scales.jsonl``: an interrupted run continues with the same command.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import astuple, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np

import mirror
from benchmarks.report import OUT, Row
from mirror.arrays import Float64
from mirror.calibration.estimate import OBSERVABLE_DEG, TRACKER_BIAS_PX, estimate_rotations
from mirror.calibration.rig import PosePrior, ScalePrior, TrackedRig
from mirror.calibration.tracking import PairTracks, pixel_rad
from mirror.geometry import Poses, quaternion_from_matrix
from mirror.geometry.cameras import Camera
from mirror.schema.finished_work import FinishedWork, hash_values
from mirror.weights.resolve import file_sha256
from tests.calibration.exact_rig import CAMERAS, about_z, mountings

NARROW: Final = {"ahead": Camera("pinhole", 1242, 375, 721.0, 721.0, 609.0, 172.0)}
BENDS_DEG: Final = (0.0, 30.0, 98.0, 150.0)
FOCAL_PERCENT: Final = (0.0, 0.35, 0.7, 1.0)
WAY_PERCENT: Final = 1.0
PRIORS: Final = {
    "default": (PosePrior(), ScalePrior()),
    "attitude 0.1 deg": (PosePrior(attitude_deg=0.1), ScalePrior()),
    "drift 0.1 m": (PosePrior(drift_m=0.1, position_m=0.02), ScalePrior()),
    "scales 1 %": (PosePrior(), ScalePrior(1.0, 1.0)),
    "exact scales": (PosePrior(), ScalePrior(0.001, 0.001)),
}
"""Priors that the check states; the last one is what ignoring errors of scale does, and no part of the figures."""
RIGS: Final = ("one camera", "three cameras")
COVER: Final = 0.93
WIDTH: Final = 3.0
_NORMAL_95: Final = 1.96
_CHECK: Final = Path(mirror.__file__).parent / "calibration"
_CODE: Final = ("equations.py", "estimate.py", "rig.py", "uncertainty.py")
_FRAMES: Final = 16
_POINTS: Final = 150
_NOISE_PX: Final = 0.1


@dataclass(frozen=True)
class Trial:
    """One rig in one bend with one draw of errors, checked with one prior."""

    rig: str
    bend_deg: float
    focal_percent: float
    prior: str
    draw: int


def bent_way(bend_deg: float, rng: np.random.Generator) -> Poses:
    """Return the poses (F,) of a straight way with a bend in its middle, steps of 2 to 3.5 m or at most 12 degrees."""
    share = np.clip((np.arange(_FRAMES) - 3.0) / (_FRAMES - 7.0), 0.0, 1.0)
    yaw = bend_deg * share
    step_m = rng.uniform(2.0, 3.5) * np.sqrt(np.clip(1.0 - (bend_deg / 9.0 / 20.0) ** 2, 0.2, 1.0))
    middle = np.radians(0.5 * (yaw[1:] + yaw[:-1]))
    places = np.cumsum(step_m * np.stack([np.cos(middle), np.sin(middle), np.zeros(_FRAMES - 1)], axis=1), axis=0)
    return Poses(
        quaternion_from_matrix(np.stack([about_z(one) for one in yaw])), np.concatenate([np.zeros((1, 3)), places])
    )


def track_points(
    poses: Poses, cameras: dict[str, Camera], places: dict[str, Poses], rng: np.random.Generator
) -> list[PairTracks]:
    """Return the tracks of points 6 to 45 m beside the way between neighbouring images."""
    at = poses.translation[rng.integers(0, _FRAMES, 4000)]
    around, away = rng.uniform(0.0, 2.0 * np.pi, len(at)), rng.uniform(6.0, 45.0, len(at))
    height = rng.uniform(-0.5, 8.0, len(at))
    world = at + np.stack([away * np.cos(around), away * np.sin(around), height], axis=1)
    pairs = []
    for name, camera in cameras.items():
        seen = camera.project((poses @ places[name]).inverse().transform(world))
        for frame in range(_FRAMES - 1):
            both = np.flatnonzero(seen.valid[frame] & seen.valid[frame + 1])[:_POINTS]
            uv = [seen.uv_px[one, both] + rng.normal(0.0, _NOISE_PX, (len(both), 2)) for one in (frame, frame + 1)]
            pairs.append(PairTracks(name, frame, frame + 1, uv[0], uv[1]))
    return pairs


def draw_rig(trial: Trial) -> tuple[TrackedRig, Float64]:
    """Return a rig with recorded errors, and its injected rotation errors (C, 3) about the vehicle's axes, degrees."""
    # The same draws for all priors: what differs is the prior alone.
    rng = np.random.default_rng([trial.draw, int(trial.bend_deg), int(100 * trial.focal_percent), len(trial.rig)])
    cameras = NARROW if trial.rig == "one camera" else CAMERAS
    true, errors = {name: mountings()[name] for name in cameras}, PosePrior()
    poses = bent_way(trial.bend_deg, rng)
    pairs = track_points(poses, cameras, true, rng)
    time_s: Float64 = 0.4 * np.arange(_FRAMES, dtype=np.float64)
    turn = rng.normal(0.0, np.radians(errors.attitude_deg), (_FRAMES, 3))
    drift = np.linalg.cholesky(np.linalg.inv(errors.position_information(time_s))) @ rng.normal(size=(_FRAMES, 3))
    turned = poses @ Poses.exp(np.concatenate([turn, np.zeros((_FRAMES, 3))], axis=1))
    way = 1.0 + 0.01 * rng.uniform(-WAY_PERCENT, WAY_PERCENT)
    recorded = Poses(turned.rotation, way * turned.translation + drift)
    injected, lenses, places = np.empty((len(cameras), 3)), {}, {}
    for number, (name, camera) in enumerate(cameras.items()):
        axis = rng.normal(size=3)
        injected[number] = rng.uniform(0.05, 1.0) * axis / np.linalg.norm(axis)
        bias = rng.normal(0.0, TRACKER_BIAS_PX * pixel_rad(camera), 3)
        wrong = Poses.exp(np.concatenate([np.radians(injected[number]) + bias, np.zeros(3)])[None])
        rotation = (wrong @ Poses(true[name].rotation, np.zeros((1, 3)))).rotation
        places[name] = Poses(rotation, true[name].translation + rng.normal(0.0, errors.mounting_m, (1, 3)))
        lenses[name] = scale_focal(camera, 1.0 + 0.01 * trial.focal_percent * rng.choice([-1.0, 1.0]))
    return TrackedRig(lenses, places, time_s, dict.fromkeys(cameras, recorded), pairs), injected


def scale_focal(camera: Camera, scale: float) -> Camera:
    """Return the lens with all distances from the principal point scaled, for points near the axis to first order."""
    return replace(camera, fx_px=camera.fx_px * scale, fy_px=camera.fy_px * scale)


def run_trial(trial: Trial) -> dict[str, Any]:
    """Return the errors and standard deviations (C, 3), degrees, and the processor time of the estimate."""
    rig, injected = draw_rig(trial)
    start = time.process_time()
    estimates = estimate_rotations(rig, *PRIORS[trial.prior])
    return {
        "error_deg": (np.stack([one.error_deg for one in estimates]) - injected).tolist(),
        "sigma_deg": np.stack([one.sigma_deg for one in estimates]).tolist(),
        "core_s": time.process_time() - start,
    }


def scale_rows(draws: int, journal: Path = OUT / "calibration_scales.jsonl") -> Iterator[Row]:
    """Yield coverage and width of the intervals: of all trials, then by bend and by prior.

    Args:
        draws: number of draws of each combination of rig, bend, focal error and prior.
        journal: finished trials; one is used again if the code of the check and of this study is the same.
    """
    journal.parent.mkdir(parents=True, exist_ok=True)
    finished: FinishedWork[dict[str, Any]] = FinishedWork(journal, dict)
    code = [file_sha256(path) for path in (Path(__file__), *(_CHECK / name for name in _CODE))]
    found: dict[Trial, dict[str, Any]] = {}
    for values in product(RIGS, BENDS_DEG, FOCAL_PERCENT, PRIORS, range(draws)):
        trial = Trial(*values)
        name, inputs = str(astuple(trial)), hash_values(astuple(trial), code)
        known = finished.find(name, lambda inputs=inputs: inputs)  # type: ignore[misc]
        if known is None:
            known = run_trial(trial)
            finished.add(name, inputs, known, known)
        found[trial] = known
    ours = {trial: one for trial, one in found.items() if trial.prior != "exact scales"}
    yield _row("all", ours, bar=True)
    for bend in BENDS_DEG:
        yield _row(f"bend {bend:g} deg", {trial: one for trial, one in ours.items() if trial.bend_deg == bend})
    for percent in FOCAL_PERCENT:
        own = {trial: one for trial, one in ours.items() if trial.focal_percent == percent}
        yield _row(f"focal length {percent:g} % off", own)
    for prior in PRIORS:
        yield _row(f"prior: {prior}", {trial: one for trial, one in found.items() if trial.prior == prior})
    moved = [
        np.abs(np.subtract(one["error_deg"], found[replace(trial, prior="default")]["error_deg"])).max()
        for trial, one in ours.items()
        if trial.bend_deg > 0.0
    ]
    yield Row(
        "bends: another prior moves an estimate by, median (deg)", f"{len(moved)} trials", float(np.median(moved)),
        float(max(moved)), unit="deg worst",
    )  # fmt: skip
    spent = sum(one["core_s"] for one in found.values()) / 60.0
    yield Row("processor time of the estimates (min)", f"{len(found)} trials", spent, bar=15.0)


def _row(name: str, trials: dict[Trial, dict[str, Any]], *, bar: bool = False) -> Row:
    """Share of the intervals of observable axes that miss the truth; half their median width over the rms error."""
    errors = np.concatenate([np.reshape(one["error_deg"], (-1, 3)) for one in trials.values()])
    sigma = np.concatenate([np.reshape(one["sigma_deg"], (-1, 3)) for one in trials.values()])
    every = float((np.abs(errors) < _NORMAL_95 * sigma).mean())
    known = sigma <= OBSERVABLE_DEG
    errors, sigma = errors[known], sigma[known]
    missed = float((np.abs(errors) >= _NORMAL_95 * sigma).mean())
    rms = float(np.sqrt((errors**2).mean()))
    return Row(
        f"{name}: intervals miss (share)", f"{len(trials)} trials, {len(errors)} axes", missed,
        float(_NORMAL_95 * np.median(sigma)) / rms,
        unit=f"half width / rms ({rms:.3f} deg; {known.mean():.0%} observable; all axes covered {every:.3f})",
        bar=1.0 - COVER if bar else None, error_bar=WIDTH if bar else None,
    )  # fmt: skip
