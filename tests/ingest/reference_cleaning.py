"""The cleaning once more, plainly, by exact geodesics: written from its rules, not from the kernel."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Literal

from mirror.recordings.protocol import Track
from mirror.schema.documents import CleaningOptions
from tests.ingest.surfaces import Point, surface_of

Fate = Literal["kept", "restart", "invalid", "duplicate_time", "repeated", "outlier"]


@dataclass
class Fix:
    """A cleaned fix; ``unknown`` if the motion from the one before is not known."""

    t: int
    p: Point
    sigma: float | None
    unknown: bool


def statuses(track: Track, options: CleaningOptions, min_step_m: float = 0.5) -> tuple[list[Fate], list[int]]:
    """Return the status of every fix in time order, and the recorded row of each."""
    surface, recorded = surface_of(track)
    order = sorted(range(len(track)), key=lambda row: int(track.timestamp_ns[row]))
    stamps = [int(track.timestamp_ns[row]) for row in order]
    points = [recorded[row] for row in order]
    status: list[Fate] = ["invalid"] * len(order)

    def seconds(i: int, j: int) -> float:
        return (stamps[j] - stamps[i]) / 1e9

    def reachable(i: int, j: int) -> bool:
        reach = options.max_speed_mps * seconds(i, j) + options.noise_m
        return surface.distance(points[i], points[j]) <= reach

    def stood_until(i: int, j: int) -> bool:
        reach = min_step_m + 0.5 * options.max_acceleration_mps2 * seconds(i, j) ** 2
        return surface.distance(points[i], points[j]) <= reach

    def off_the_line(i: int, j: int) -> bool:
        following = (
            k
            for k in range(j + 1, len(order))
            if stamps[k] > stamps[j] and surface.usable(points[k]) and points[k] != points[j]
        )
        k = next(following, None)
        if k is None or not reachable(i, k):
            return False
        t1, t2 = seconds(i, j), seconds(j, k)
        on_the_line = surface.between(points[i], points[k], t1 / (t1 + t2))
        allowed = 0.5 * options.max_acceleration_mps2 * t1 * t2 + options.noise_m
        return surface.distance(on_the_line, points[j]) > allowed

    track_rows: list[int] = []  # kept fixes since the last break
    run: list[int] = []  # repetitions of the last kept fix
    rejected: list[int] = []  # failed the speed test in a row, and agree with each other
    row = 0
    while row < len(order):
        if not surface.usable(points[row]):
            status[row] = "invalid"
        elif not track_rows:
            status[row] = "kept"
            track_rows = [row]
        elif stamps[row] == stamps[run[-1] if run else track_rows[-1]]:
            status[row] = "duplicate_time"
        elif points[row] == points[track_rows[-1]]:
            status[row] = "repeated"
            run.append(row)
            rejected = []
        else:
            before = track_rows[-1]
            stood = bool(run) and stood_until(run[-1], row)
            if stood:
                before = run[-1]
            if reachable(before, row):
                rejected = []
                if off_the_line(before, row):
                    status[row] = "outlier"
                else:
                    for one in [*run, row] if stood else [row]:
                        status[one] = "kept"
                        track_rows.append(one)
                    run = []
            else:
                status[row] = "outlier"
                if rejected and not reachable(rejected[-1], row):
                    rejected = []
                rejected.append(row)
                moves = sum(points[a] != points[b] for a, b in itertools.pairwise(rejected))
                if moves == 2:
                    for one in run:
                        status[one] = "kept"
                        track_rows.append(one)
                    if len(track_rows) < 3:
                        for dropped in track_rows:
                            status[dropped] = "outlier"
                    row = rejected[0]
                    status[row] = "restart"
                    track_rows, run, rejected = [row], [], []
        row += 1
    for one in run:
        status[one] = "kept"
    return status, order


def cleaned(track: Track, options: CleaningOptions, min_step_m: float = 0.5) -> list[Fix]:
    _, recorded = surface_of(track)
    status, order = statuses(track, options, min_step_m)
    return [
        Fix(
            int(track.timestamp_ns[row]),
            recorded[row],
            None if track.sigma_m is None else float(track.sigma_m[row]),
            one == "restart",
        )
        for one, row in zip(status, order)
        if one in ("kept", "restart")
    ]
