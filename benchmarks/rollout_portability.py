"""Rollouts that are driven again under the instruction sets of other x86-64 processors, compared with their logs.

``python -m benchmarks rollout_portability [--streets SOURCE ...] [--seeds N]``. All scenarios of the toolkit are driven
in each street with a built-in policy, with all instructions. Then their recorded controls are driven again with a
restricted instruction set, as in `synth_portability`: in another process, whose street is its own. The error is the
largest difference of a position; the bar is the tolerance of `mirror leaderboard add` (1e-6 m). A second table counts
the rollouts with another ending, map or event. Times include start and compilation.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.processors import INSTRUCTION_SETS, restricted
from benchmarks.report import Row, report

_COLUMNS: Final = ("x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps")


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; returns 1 if a rollout differs."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks rollout_portability", description=__doc__)
    parser.add_argument("--streets", nargs="+", default=["synth:tiny", "synth:block"], metavar="SOURCE")
    parser.add_argument("--seeds", type=int, default=1, help="seeds of each scenario (default: 1)")
    parser.add_argument("--again", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    if arguments.again is not None:
        print(json.dumps(_drive_again(arguments.again, arguments.streets)))
        return 0
    with tempfile.TemporaryDirectory() as folder:
        _drive(Path(folder), arguments.streets, arguments.seeds)
        found = list(_compare(Path(folder), arguments.streets))
    apart = [Row(name, size, ms, worst, unit="m", error_bar=1e-6) for name, size, ms, worst, _ in found]
    others = [Row(name, size, ms, count, unit="rollouts", error_bar=0.5) for name, size, ms, _, count in found]
    return report("rollout_portability", {"positions": apart, "other events": others}, errors="difference")


def _drive(folder: Path, streets: Sequence[str], seeds: int) -> None:
    """Drive all scenarios that fit; each run lies in a folder of its street's number, scenario and seed."""
    from hybridworldsim.simulator.policy_registry import make_policy
    from hybridworldsim.simulator.renderers.registry import RendererFactory
    from hybridworldsim.simulator.rollout.run import RolloutRequest, run_rollout
    from hybridworldsim.simulator.street.opening import open_street
    from mirror.errors import UsageError
    from mirror.schema.scenario import read_scenario, scenario_names

    for number, source in enumerate(streets):
        street = open_street(source)
        for name in scenario_names():
            for seed in range(seeds):
                scenario = read_scenario(name)
                scenario = scenario.model_copy(update={"seed": scenario.seed + seed})
                policy = make_policy("log" if scenario.ego.start.kind == "recorded" else "idm")
                request = RolloutRequest(street, scenario, policy, "idm", {}, RendererFactory("boxes"))
                try:
                    run_rollout(request, folder / f"{number}-{name}-{seed}")
                except UsageError as error:
                    print(f"{source}, {name}: left out: {error}", file=sys.stderr)


def _compare(folder: Path, streets: Sequence[str]) -> Iterator[tuple[str, str, float, float, int]]:
    for name, features in INSTRUCTION_SETS.items():
        command = [
            sys.executable,
            "-m",
            "benchmarks",
            "rollout_portability",
            "--again",
            str(folder),
            "--streets",
            *streets,
        ]
        cache = folder.parent / f"{folder.name}-{name.replace(' ', '_')}.cache"
        begin = time.perf_counter()
        done = subprocess.run(command, env=restricted(features, cache), check=True, capture_output=True, text=True)
        ms = 1e3 * (time.perf_counter() - begin)
        runs: list[dict[str, Any]] = json.loads(done.stdout.splitlines()[-1])
        for run in runs:
            print(f"{name}: {run['name']}: {run['apart']:.3g}, {run['events'] or 'same events'}", file=sys.stderr)
        worst = max(run["apart"] for run in runs)
        yield name, f"{len(runs)} rollouts", ms, worst, sum(bool(run["events"]) for run in runs)


def _drive_again(folder: Path, streets: Sequence[str]) -> list[dict[str, Any]]:
    """Compare each rollout of a folder with a new drive of its controls."""
    from hybridworldsim.simulator.rollout.actions import ACTIONS_FILE, read_actions
    from hybridworldsim.simulator.rollout.driven_again import drive_again
    from hybridworldsim.simulator.street.opening import open_street
    from mirror.metrics.safety import read_state_log
    from mirror.metrics.safety.report import score_rollout
    from mirror.schema.files import sha256_bytes
    from mirror.schema.road_map import encode_road_map
    from mirror.schema.rollout import MAP_FILE, SCENARIO_FILE, STATES_FILE, read_rollout
    from mirror.schema.scenario import read_scenario
    from mirror_leaderboard.rollouts import EVENTS

    found = []
    for run in sorted(path for path in folder.iterdir() if path.is_dir()):
        street = open_street(streets[int(run.name.partition("-")[0])])
        rollout, log = read_rollout(run), read_state_log(run / STATES_FILE)
        scenario = read_scenario(run / SCENARIO_FILE)
        driven = drive_again(street, scenario, read_actions(run / ACTIONS_FILE))
        events = []
        if driven.ending != rollout.ending:
            events.append(f"ending {driven.ending}, not {rollout.ending}")
        if sha256_bytes(encode_road_map(street.road_map)) != rollout.files[MAP_FILE].sha256:
            events.append("another map")
        apart = float("inf")
        if log.stamps_ns.shape == driven.log.stamps_ns.shape and set(log.ids) == set(driven.log.ids):
            order = [log.ids.index(name) for name in driven.log.ids]
            pairs = [(getattr(log, name)[:, order], getattr(driven.log, name)) for name in _COLUMNS]
            apart = max(float(np.nanmax(np.abs(np.where(driven.log.present, one - two, 0.0)))) for one, two in pairs)
            before, after = (score_rollout(one, street.road_map, rollout.route_m).figures for one in (log, driven.log))
            events += [
                f"{name} {after[name].value}, not {before[name].value}"
                for name in EVENTS
                if not np.array_equal(before[name].value, after[name].value, equal_nan=True)
            ]
        found.append({"name": run.name, "apart": apart, "events": "; ".join(events)})
    return found
