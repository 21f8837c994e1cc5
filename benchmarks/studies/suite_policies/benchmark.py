"""Twelve policies of spread skill on the suite `closed-loop`, with intervals of their ranks.

``python -m benchmarks suite_policies --out FOLDER [--workers N]``. The policies of `policies` drive all drives of the
suite without images; what is complete in the folder is kept. The table has their scores with intervals, and their ranks
as a board shows them, from the thirty clusters of scenario and street. Declared before the first drive: three policies
are deliberately low (Blind, BlindHasty, Straying), three deliberately high (Anticipating, Cautious, Smooth), and all
twelve take at most 60 minutes of core.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.studies.suite_policies.policies import POLICIES
from hybridworldsim.simulator.isolation.choice import PolicyChoice
from hybridworldsim.simulator.suite import drive_suite
from mirror.evaluation.result import GroupFigure, Result
from mirror.evaluation.rollouts import evaluate_rollouts
from mirror.metrics.ranks import rank_intervals
from mirror.progress import progress_bar
from mirror.protocols.document import load_protocol

SUITE: Final = "closed-loop"
_FILE: Final = Path(__file__).with_name("policies.py")


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks suite_policies", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args(argv)
    protocol, results = load_protocol(SUITE), {}
    for policy in POLICIES:
        name = policy.__name__
        runs = arguments.out / name.lower()
        with progress_bar(quiet=False) as bar:
            choice = PolicyChoice(f"{_FILE}:{name}")
            drive_suite(protocol, choice, runs, workers=arguments.workers, reporter=bar)
            results[name] = evaluate_rollouts(runs, protocol, arguments.out / f"{name.lower()}-results", bar).result
    print("\n".join(list_rows(results)))
    return 0


def list_rows(results: dict[str, Result]) -> list[str]:
    """List the rows of the table, best first; policies below the gate of the protocol have no rank."""
    ranked = {name: one for name, one in results.items() if _is_ranked(one)}
    scores = np.array([[cluster.value for cluster in one.clusters] for one in ranked.values()])
    found = rank_intervals(scores)
    ranks = {name: f"{found.ranks[row]} ({found.low[row]}-{found.high[row]})" for row, name in enumerate(ranked)}
    order = sorted(results, key=lambda name: (name not in ranked, -_value(results[name], "epdms")))
    lines = [
        "| rank | policy | EPDMS, 95 % interval | collisions | off the road | progress |",
        "|---|---|---|---|---|---|",
    ]
    for name in order:
        one, score = results[name], _figure(results[name], "epdms")
        between = "" if score.low is None or score.high is None else f" ({score.low:.3f} to {score.high:.3f})"
        values = [_value(one, "collisions"), 1.0 - _value(one, "drivable_area"), _value(one, "progress_share")]
        cells = [
            ranks.get(name, "none"),
            f"`{name}`",
            f"{score.value:.3f}{between}",
            *(f"{value:.2f}" for value in values),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _is_ranked(result: Result) -> bool:
    ranking = result.protocol.ranking
    return ranking is None or ranking.passes_gate(lambda column: _figure(result, column[1]).value)


def _figure(result: Result, metric: str) -> GroupFigure:
    return next(one for one in result.figures if one.level == "group" and one.metric == metric)


def _value(result: Result, metric: str) -> float:
    value = _figure(result, metric).value
    return float("nan") if value is None else value
