"""Calibration checking and refinement on the synthetic street, compared with injected errors.

``python -m benchmarks calibration [check|refine|gain|scales|shutters|align|poses] [--draws N]``; for ``refine`` see
`benchmarks.calibration.refinement`, for ``gain`` `benchmarks.calibration.gain`, for ``scales``
`benchmarks.calibration.scales`, for ``shutters`` `benchmarks.calibration.shutters`, for ``align``
`benchmarks.calibration.alignment`, for ``align --reconstruct`` `benchmarks.calibration.align_gain`, for ``poses``
`benchmarks.calibration.pose_errors`.
Check: drives of three vehicle types by day and by night: 20 frames of 7 cameras on a turn, stored as JPEG, tracked
once. Then rotation errors of 0.05 to 1.0 degrees are injected into every mounting, and poses, lenses and mounting
positions get recorded errors, many times. Figures are total angles of the remaining error; the column ``error`` has the
worst camera. A trial is one camera in one draw.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.calibration.align_gain import Training, align_gain_rows
from benchmarks.calibration.alignment import align_rows
from benchmarks.calibration.gain import gain_rows
from benchmarks.calibration.pose_errors import pose_rows
from benchmarks.calibration.recording import (
    DriveTracks,
    choose_instants,
    make_drive,
    recorded_rig,
    straightest_instants,
    track_drive,
)
from benchmarks.calibration.refinement import refine_rows
from benchmarks.calibration.scales import scale_rows
from benchmarks.calibration.shutters import shutter_rows
from benchmarks.report import OUT, Row, report
from mirror.arrays import Bool, Float64
from mirror.calibration.estimate import estimate_rotations
from mirror.calibration.frame_choice import FrameChoice
from mirror.calibration.refinement.run import DEFAULT_CHOICE
from mirror.calibration.statistics import LIMIT_DEG

VEHICLES: Final = ("saloon", "suv", "hatchback")
LIGHTS: Final = ("day", "night")
INJECTED_DEG: Final = (0.05, 1.0)
_CHECK_S: Final = 20.0


def estimate_draws(
    tracks: DriveTracks, draws: int, angle_deg: tuple[float, float], *, exact: bool = False
) -> tuple[Float64, Float64, Float64, float]:
    """Estimate many draws of recorded errors.

    Returns:
        Remaining errors (D, C, 3) and their stated standard deviations (D, C, 3) about the vehicle's axes, estimated
        angles (D, C), all in degrees, and the processor time of one estimate, seconds.
    """
    errors, sigma, angles = [], [], []
    start = time.process_time()
    for draw in range(draws):
        rig, injected = recorded_rig(tracks, draw, angle_deg, exact=exact)
        estimates = estimate_rotations(rig)
        errors.append(np.stack([one.error_deg for one in estimates]) - injected)
        sigma.append(np.stack([one.sigma_deg for one in estimates]))
        angles.append(np.array([one.angle_deg for one in estimates]))
    return np.stack(errors), np.stack(sigma), np.stack(angles), (time.process_time() - start) / draws


def rms_angle(errors: Float64) -> Float64:
    """Return the root mean square angles (C,) of each camera over the draws, from errors (D, C, 3)."""
    return np.asarray(np.sqrt((errors**2).sum(axis=2).mean(axis=0)), np.float64)


def turn_rows(draws: int) -> Iterator[Row]:
    """Yield errors, intervals and alarms of turns, by day and by night."""
    cover: list[Bool] = []
    alarms: dict[float, list[Bool]] = {0.1: [], 0.5: []}
    for light in LIGHTS:
        rms, exact_rms, times = [], [], []
        for vehicle in VEHICLES:
            drive = make_drive("turn", light, vehicle)
            tracks = track_drive(drive, choose_instants(drive, FrameChoice()))
            drive.forget()
            errors, sigma, _, solve_s = estimate_draws(tracks, draws, INJECTED_DEG)
            rms.append(rms_angle(errors))
            cover.append((np.abs(errors) < 1.96 * sigma).ravel())
            exact_rms.append(rms_angle(estimate_draws(tracks, 2, INJECTED_DEG, exact=True)[0]))
            for angle, found in alarms.items():
                angles = estimate_draws(tracks, max(draws // 2, 1), (angle, angle))[2]
                found.append((angles > LIMIT_DEG).ravel())
            times.append(tracks.track_s + solve_s)
        size = f"{len(VEHICLES)} rigs, {draws} draws"
        for what, values, bar, worst_bar in (("recorded", rms, 0.07, 0.12), ("exact", exact_rms, 0.05, None)):
            yield Row(
                f"{light}, {what} poses: rms angle of a camera, median (deg)", size, float(np.median(values)),
                float(np.max(values)), unit="deg worst", bar=bar, error_bar=worst_bar,
            )  # fmt: skip
        yield Row(f"{light}: processor time of a check, worst (s)", "7 x 20", float(np.max(times)), bar=_CHECK_S)
    inside = np.concatenate(cover)
    size = f"{len(inside) // 3} trials"
    yield Row("95 % intervals cover (share)", size, float(inside.mean()), bar=0.99)
    yield Row("95 % intervals miss (share)", size, float(1.0 - inside.mean()), bar=0.10)
    wrong, right = (np.concatenate(alarms[angle]) for angle in (0.1, 0.5))
    yield Row("a true 0.1 deg alarms (share)", f"{len(wrong)} trials", float(wrong.mean()), bar=0.01 + 1e-9)
    yield Row(
        "a true 0.5 deg does not alarm (share)", f"{len(right)} trials", float(1.0 - right.mean()), bar=0.05 + 1e-9
    )


def straight_rows(draws: int) -> Iterator[Row]:
    """Yield the errors by axis of straight driving."""
    drive = make_drive("along", "day", "saloon")
    tracks = track_drive(drive, straightest_instants(drive, FrameChoice()))
    errors, sigma, _, _ = estimate_draws(tracks, draws, INJECTED_DEG)
    for number, axis in enumerate(("roll", "pitch", "yaw")):
        rms = np.sqrt((errors[..., number] ** 2).mean(axis=0))
        hidden = float((sigma[..., number] > 0.1).mean())
        yield Row(
            f"straight, {axis}: rms, median of the cameras (deg)", f"{draws} draws", float(np.median(rms)),
            float(rms.max()), unit=f"deg worst; unobservable in {hidden:.0%}",
        )  # fmt: skip


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks calibration")
    parser.add_argument(
        "what",
        nargs="?",
        choices=("check", "refine", "gain", "scales", "shutters", "align", "poses"),
        default="check",
        help="default: check",
    )
    parser.add_argument("--vehicles", default=",".join(VEHICLES), help="rigs of the refinement, separated by commas")
    parser.add_argument("--lights", default=",".join(LIGHTS), help="light of the refinement, separated by commas")
    parser.add_argument("--draws", type=int, default=20, help="number of draws of the recorded errors for each drive")
    parser.add_argument("--frames", type=int, default=DEFAULT_CHOICE.frames, help="frames of a refined traversal")
    parser.add_argument("--traversals", type=int, default=1, help="traversals that are refined together")
    parser.add_argument("--data", type=Path, help="working folder of the gain or the alignment")
    parser.add_argument("--steps", type=int, default=2000, help="training images of each model of a gain")
    parser.add_argument("--reconstruct", action="store_true", help="compare reconstructions on aligned and exact poses")
    options = parser.parse_args(argv)
    if options.what == "gain":
        return report("calibration_gain", {"gain": gain_rows(options.data or OUT / "calibration_gain", options.steps)})
    if options.what == "align" and options.reconstruct:
        gains = align_gain_rows(options.data or OUT / "calibration_align", Training(options.steps))
        return report("calibration_align_gain", {"reconstruction": gains})
    if options.what == "align":
        rows = align_rows(options.draws, options.data or OUT / "calibration_align")
        return report("calibration_align", {"alignment": rows}, errors="median error")
    if options.what == "poses":
        return report("calibration_poses", {"poses": pose_rows(options.data or OUT / "calibration_poses")})
    if options.what == "scales":
        return report("calibration_scales", {"scales": scale_rows(options.draws)}, errors="half width")
    if options.what == "shutters":
        return report("calibration_shutters", {"shutters": shutter_rows(options.draws)}, errors="worst")
    if options.what == "refine":
        rows = refine_rows(
            options.draws, options.vehicles.split(","), options.lights.split(","),
            frames=options.frames, traversals=options.traversals,
        )  # fmt: skip
        return report("calibration_refine", {"refinement": rows}, errors="worst error")
    return report(
        "calibration",
        {"straight": straight_rows(options.draws), "turns": turn_rows(options.draws)},
        errors="worst error",
    )
