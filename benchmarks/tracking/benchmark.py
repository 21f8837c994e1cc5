"""Tracking of noisy boxes against exact truth, beside greedy nearest-neighbour matching."""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from benchmarks.tracking.drives import Noise, detect, greedy, tracked, true_drives
from mirror.annotation.tracking.options import BoxTrackingOptions
from mirror.annotation.tracking.tracker import track
from mirror.metrics.tracking import TrackingScores, score_tracks

_HEAD = (
    f"{'Hz':>3} {'tracker':28} {'switches':>8} {'AMOTA':>6} {'MOTA':>6} {'IDF1':>6} {'false':>6} {'missed':>6}"
    f" {'pos. m':>6} {'vel. m/s':>8} {'s/60 s':>7}"
)


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="benchmarks tracking", description=__doc__)
    parser.add_argument("--drives", type=int, default=5, help="drives of the preset demo")
    parser.add_argument("--seconds", type=float, default=60.0, help="length of each drive")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--all", action="store_true", help="also other gates and ages of the greedy matcher")
    arguments = parser.parse_args(argv)
    print(_HEAD)
    for hz in (10.0, 2.0):
        drives = true_drives(hz, seed=arguments.seed, drives=arguments.drives, duration_s=arguments.seconds)
        truth = [drive.truth() for drive in drives]
        seconds = sum(float(np.ptp(drive.timestamp_ns)) * 1e-9 for drive in drives)
        hard = Noise()
        for name, noise in (
            ("30 %, 0.25 m + 2 %", hard),
            ("20 %, 0.3 m", replace(hard, sigma_m=0.3, sigma_share=0.0, missed=0.2)),
        ):
            print(f"misses and noise: {name}, {sum(map(len, truth))} frames")
            found = [detect(drive, noise, place) for place, drive in enumerate(drives)]
            gates = [(4.0, 3)] if not arguments.all else [(gate, age) for gate in (2.0, 4.0) for age in (3, 10, 20)]
            for gate, age in gates:
                begin = time.process_time()
                boxes = [greedy(one, drive.world_SE3_ego, gate_m=gate, age=age) for one, drive in zip(found, drives)]
                spent = time.process_time() - begin
                _row(hz, f"greedy {gate:g} m, age {age}", score_tracks(truth, boxes), 60.0 * spent / seconds)
            for name, options in (
                ("ours", BoxTrackingOptions()),
                ("ours, constant velocity", BoxTrackingOptions(turn_model=False)),
                ("ours, gaps not filled", BoxTrackingOptions(fill_gaps_s=0.0)),
            ):
                begin = time.process_time()
                tracks = [track(one, drive.world_SE3_ego, options) for one, drive in zip(found, drives)]
                spent = time.process_time() - begin
                boxes = [tracked(one, drive.world_SE3_ego) for one, drive in zip(tracks, drives)]
                _row(hz, name, score_tracks(truth, boxes), 60.0 * spent / seconds)
    return 0


def _row(hz: float, name: str, scores: TrackingScores, spent_s: float) -> None:
    print(
        f"{hz:3g} {name:28} {scores.switches:8d} {scores.amota:6.3f} {scores.mota:6.3f} {scores.idf1:6.3f}"
        f" {scores.false_per_frame:6.2f} {scores.misses:6.1%} {scores.position_error_m:6.2f}"
        f" {scores.velocity_error_mps:8.2f} {spent_s:7.2f}",
        flush=True,
    )
