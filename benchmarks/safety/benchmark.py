"""Safety metrics of state logs against references with shapely and SciPy, and fitted maps against exact ones.

The logs have 20 s at 10 Hz on an urban street of 200 m. References look at finely interpolated logs. Bars: all metrics
of a log with 60 agents below 20 ms, first contacts within 1 ms, and the least time to collision of a log and of its
interpolation to 100 Hz within 5 ms.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.report import Peer, Row, best_ms, report
from benchmarks.safety import fitted_maps, reference
from benchmarks.safety.logs import near_misses, resample, traffic_log
from mirror.arrays import Float64
from mirror.metrics.safety import (
    StateLog,
    drivable_area_compliance,
    find_collisions,
    least_time_to_collision,
    locate_on_lanes,
    measure_comfort,
    navsim_time_to_collision,
    nuplan_time_to_collision,
    route_progress,
    score_rollout,
    time_to_collision,
)
from mirror.metrics.safety.comfort import differentiate
from mirror.schema.road_map import RoadMap
from mirror.synth.fleet.places import TORONTO_URBAN
from mirror.synth.maps import street_map
from mirror.synth.street.plan import plan_scene

_FINE = 100
_ACCURACY_AGENTS = 12


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks safety", description=__doc__)
    parser.add_argument("--agents", type=int, default=60, help="agents of the timed log (default: 60)")
    parser.add_argument("--logs", type=int, default=10, help="logs for accuracy (default: 10)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the street and of the first log (default: 0)")
    parser.add_argument("--maps", default="demo", help="preset of the drives that a map is fitted to (default: demo)")
    arguments = parser.parse_args(argv)
    road_map = street_map(plan_scene(TORONTO_URBAN, 20.0, arguments.seed))
    return report(
        "safety",
        {
            "time and error": _kernels(arguments, road_map),
            "rate of the log": _rates(arguments),
            "fitted maps": fitted_maps.rows(arguments.maps, arguments.seed),
        },
        errors="error",
    )


def _kernels(arguments: argparse.Namespace, road_map: RoadMap) -> Iterator[Row]:
    timed = traffic_log(road_map, arguments.agents, arguments.seed)
    seeds = range(arguments.seed, arguments.seed + arguments.logs)
    hits = [near_misses(_ACCURACY_AGENTS, seed, touching=True) for seed in seeds]
    misses = [near_misses(_ACCURACY_AGENTS, seed, touching=False) for seed in seeds]
    size = f"{arguments.agents} agents, {len(timed.stamps_ns)} stamps"
    lane = max(road_map.lanes_of(), key=lambda one: one.length_m)
    route = lane.center_m[:, :2]
    # A log whose arrays for the kernels are not prepared yet, as a caller has it.
    everything = _processor_ms(lambda: score_rollout(replace(timed), road_map, route))
    yield Row("all figures of a rollout, processor time", size, everything, bar=20.0)
    yield _contacts(timed, hits, size)
    yield from _times_to_collision(timed, misses, size)
    margin = drivable_area_compliance(timed, road_map.drivable_rings).margin_m
    yield Row(
        "drivable margin",
        f"{len(timed.stamps_ns)} stamps, {sum(map(len, road_map.drivable_rings))} corners",
        best_ms(lambda: drivable_area_compliance(timed, road_map.drivable_rings)),
        float(np.abs(margin - reference.drivable_margin(timed, road_map)).max()),
        (Peer("shapely", best_ms(lambda: reference.drivable_margin(timed, road_map))),),
        "m",
        error_bar=1e-6,
    )
    ours = np.abs(locate_on_lanes(timed, road_map).center_offset_m)
    yield Row(
        "position on lanes",
        f"{len(timed.stamps_ns)} stamps, {len(road_map.lanes_of())} lanes",
        best_ms(lambda: locate_on_lanes(timed, road_map)),
        _difference(ours, reference.lane_offsets(timed, road_map)),
        (Peer("shapely", best_ms(lambda: reference.lane_offsets(timed, road_map))),),
        "m",
        error_bar=1e-6,
    )
    yield _comfort(timed)
    yield Row("progress", f"{len(route)} points", best_ms(lambda: route_progress(timed, route)))


def _processor_ms(call: Callable[[], object], repeats: int = 15) -> float:
    """Median processor time of a call in one thread, which other programs on the machine disturb less."""
    call()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append((time.process_time() - start) * 1e3)
    return float(np.median(times))


def _contacts(timed: StateLog, logs: Sequence[StateLog], size: str) -> Row:
    ours_error, stamps_error, count = 0.0, 0.0, 0
    for log in logs:
        found = {one.agent: (one.stamp_ns - int(log.stamps_ns[0])) * 1e-9 for one in find_collisions(log)}
        fine, coarse = reference.first_contacts(resample(log, _FINE)), reference.first_contacts(log)
        for agent, time_s in fine.items():
            # The reference sees a contact at its first stamp, 1 ms apart, after it.
            ours_error = max(ours_error, abs(found[agent] - time_s + 0.5 * 0.1 / _FINE))
            stamps_error = max(stamps_error, abs(coarse.get(agent, math.inf) - time_s))
            count += 1
    return Row(
        f"first contacts ({count})",
        size,
        best_ms(lambda: find_collisions(timed)),
        ours_error,
        (Peer("shapely at stamps", best_ms(lambda: reference.first_contacts(timed)), stamps_error),),
        "s",
        error_bar=1e-3,
    )


def _times_to_collision(timed: StateLog, logs: Sequence[StateLog], size: str) -> Iterator[Row]:
    errors: dict[str, float] = {"least": 0.0, "stamps": 0.0, "nuplan": 0.0, "gap": 0.0}
    for log in logs:
        none = np.zeros(len(log.stamps_ns), np.bool_)
        all_around = ~none
        fine = time_to_collision(resample(log, _FINE)).min()
        least = least_time_to_collision(log).value_s
        nuplan = nuplan_time_to_collision(log, between_lanes=none, in_junction=all_around).least_s
        for name, value in (("least", least), ("stamps", time_to_collision(log).min()), ("nuplan", nuplan)):
            if fine <= 3.0:
                errors[name] = max(errors[name], min(abs(value - fine), 3.0))
        errors["gap"] = max(errors["gap"], reference.gap_at_contact(log, time_to_collision(log)))
    none = np.zeros(len(timed.stamps_ns), np.bool_)
    nuplan_ms = best_ms(lambda: nuplan_time_to_collision(timed, between_lanes=none, in_junction=~none))
    yield Row(
        "least time to collision",
        size,
        best_ms(lambda: least_time_to_collision(timed)),
        errors["least"],
        (
            Peer("ours at stamps", best_ms(lambda: time_to_collision(timed)), errors["stamps"]),
            Peer("nuPlan's steps (preset)", nuplan_ms, errors["nuplan"]),
        ),
        "s",
        error_bar=5e-3,
    )
    peer = best_ms(lambda: reference.time_to_collision(timed, 1.0, 0.1), 1)
    yield Row(
        "time to collision at stamps",
        size,
        best_ms(lambda: time_to_collision(timed)),
        errors["gap"],
        (Peer("shapely, steps of 0.1 s to 1 s", peer),),
        "m",
        error_bar=1e-6,
    )
    yield Row(
        "NAVSIM v2 preset", size, best_ms(lambda: navsim_time_to_collision(timed, between_lanes=none, in_junction=none))
    )


def _comfort(log: StateLog) -> Row:
    from scipy.signal import savgol_filter

    values = np.stack([log.vx_mps[:, 0], log.vy_mps[:, 0]], axis=1)

    def peer() -> Float64:
        return np.asarray(savgol_filter(values, 9, 2, deriv=1, delta=0.1, axis=0))

    ours = differentiate(log.times_s, values, window=9, degree=2, order=1)
    return Row(
        "comfort, acceleration",
        f"{len(log.stamps_ns)} stamps",
        best_ms(lambda: measure_comfort(log)),
        float(np.abs(ours - peer()).max()),
        (Peer("scipy", best_ms(peer)),),
        "m/s2",
        error_bar=1e-9,
    )


def _rates(arguments: argparse.Namespace) -> Iterator[Row]:
    worst, contact, count = 0.0, 0.0, 10 * arguments.logs
    for one in range(count):
        hit, miss = (near_misses(_ACCURACY_AGENTS, arguments.seed + 1000 + one, touching=way) for way in (True, False))
        least, other = (least_time_to_collision(log).value_s for log in (miss, resample(miss, 10)))
        if math.isfinite(least) or math.isfinite(other):
            worst = max(worst, abs(least - other))
        for first, second in zip(find_collisions(hit), find_collisions(resample(hit, 10)), strict=True):
            contact = max(contact, abs(first.stamp_ns - second.stamp_ns) * 1e-9)
    hit, miss = (resample(near_misses(_ACCURACY_AGENTS, arguments.seed, touching=way), 10) for way in (True, False))
    size = f"{count} logs of {_ACCURACY_AGENTS} agents"
    took = best_ms(lambda: least_time_to_collision(miss))
    yield Row("least time, 10 and 100 Hz", size, took, worst, (), "s", error_bar=5e-3)
    took = best_ms(lambda: find_collisions(hit))
    yield Row("first contact, 10 and 100 Hz", size, took, contact, (), "s", error_bar=1e-3)


def _difference(ours: Float64, other: Float64) -> float:
    """Largest difference where both have a value; where only one has, the ego is on an edge within rounding."""
    both = np.isfinite(ours) & np.isfinite(other)
    if (np.isfinite(ours) != np.isfinite(other)).any():
        return math.inf
    return float(np.abs(ours[both] - other[both]).max(initial=0.0))
