"""Measures how often intervals of ranks hold all true ranks of simulated boards, beside pairs judged one by one.

``python -m benchmarks rank_intervals [--boards N]``: a board has twelve methods of known order with ties and near ties,
10, 20, 30 or 60 clusters, and ten drives in each. Five kinds of boards follow each other; board k is drawn from seed
(``--seed``, k), and resampled with seed k. A board is covered if every one of its twelve intervals holds the true rank,
and of a tie all of its places. The exit code is 1 if fewer than 95 % are, by more than two Monte Carlo errors.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Final

import numpy as np

from benchmarks.report import OUT
from mirror.arrays import Bool, Float64, Int64
from mirror.errors import ExitCode
from mirror.metrics.images.bootstrap import mean_interval
from mirror.metrics.ranks import rank_intervals

CLUSTERS: Final = (10, 20, 30, 60)
DRIVES: Final = 10
CONFIDENCE: Final = 0.95

_MEANS: Final = np.array([0.9, 0.9, 0.9, 0.89, 0.88, 0.8, 0.8, 0.78, 0.6, 0.6, 0.59, 0.3])
"""Twelve methods: ties of three, of two and of two, and neighbours that differ by 0.01."""
_LADDER: Final = np.linspace(0.9, 0.35, 12)

Draw = Callable[[np.random.Generator, Float64, int], Float64]


def _normal(rng: np.random.Generator, means: Float64, clusters: int) -> Float64:
    """Noise of clusters, which all methods share, of methods in clusters, and of drives."""
    shape = (len(means), clusters)
    hard = rng.normal(0.0, 0.15, clusters)
    own = rng.normal(0.0, 0.05, shape)
    drives = rng.normal(0.0, 0.1, (*shape, DRIVES))
    return means[:, None, None] + hard[:, None] + own[..., None] + drives


def _unequal(rng: np.random.Generator, means: Float64, clusters: int) -> Float64:
    """Methods whose spread over clusters differs by a factor of ten, with long tails."""
    spread = rng.permutation(np.geomspace(0.02, 0.2, len(means)))
    own = spread[:, None] * rng.standard_t(4, (len(means), clusters)) / math.sqrt(2.0)
    return _normal(rng, means, clusters) + own[..., None]


def _failures(rng: np.random.Generator, means: Float64, clusters: int) -> Float64:
    """Drives that have the score 1 or, more often in some clusters, fail with 0."""
    hard = rng.uniform(0.0, 2.0, clusters)
    shared = np.minimum((1.0 - means)[:, None] * hard, 1.0)
    # Where twice a share of failures is above 1, it does not follow the cluster: its mean must be exact.
    share = np.where((means < 0.5)[:, None], (1.0 - means)[:, None], shared)
    return (rng.uniform(size=(*share.shape, DRIVES)) >= share[..., None]).astype(np.float64)


KINDS: Final[Mapping[str, tuple[Draw, Float64]]] = {
    "ties and near ties": (_normal, _MEANS),
    "one tie of twelve": (_normal, np.full(12, 0.8)),
    "twelve steps of 0.05": (_normal, _LADDER),
    "unequal spread, long tails": (_unequal, _MEANS),
    "drives that succeed or fail": (_failures, _MEANS),
}


@dataclass(frozen=True)
class Count:
    """Counts of boards of one kind.

    Attributes:
        kind: name of the kind.
        boards: number of boards.
        covered: boards whose intervals all hold their true ranks.
        places: mean number of places in an interval.
        separated: share of the truly different pairs that are separated.
        covered_by_pairs: the same as ``covered`` if each pair is judged by its own interval.
        ms: mean time of a board.
    """

    kind: str
    boards: int
    covered: int
    places: float
    separated: float
    covered_by_pairs: int
    ms: float


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="benchmarks rank_intervals", description=__doc__)
    parser.add_argument("--boards", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="board k is drawn from the seed (SEED, k)")
    parser.add_argument("--resamples", type=int, default=2000)
    arguments = parser.parse_args(argv)
    print(
        f"{arguments.boards} boards of 12 methods, seed {arguments.seed}, {arguments.resamples} resamplings, "
        f"confidence {CONFIDENCE:.0%}; clusters {', '.join(map(str, CLUSTERS))}, {DRIVES} drives in each"
    )
    print(
        f"{'boards':28} {'n':>4} {'covered':>8} {'error':>6} {'places':>7} {'separated':>10} {'by pairs':>9} {'ms':>6}"
    )
    names = list(KINDS)
    counts = []
    for start, name in enumerate(names):
        counts.append(measure(name, range(start, arguments.boards, len(names)), arguments.seed, arguments.resamples))
        _print(counts[-1])
    total = _add(counts)
    _print(total)
    OUT.mkdir(exist_ok=True)
    (OUT / "rank_intervals.json").write_text(json.dumps([asdict(one) for one in (*counts, total)], indent=1) + "\n")
    least = CONFIDENCE - 2.0 * math.sqrt(CONFIDENCE * (1.0 - CONFIDENCE) / total.boards)
    return ExitCode.DONE if total.covered / total.boards >= least else ExitCode.FINDINGS


def measure(kind: str, boards: Sequence[int], seed: int, resamples: int) -> Count:
    """Draw boards of one kind by their numbers, and count those whose intervals hold all true ranks."""
    draw, means = KINDS[kind]
    covered, by_pairs, places, separated, spent = 0, 0, 0.0, [], 0.0
    best, worst = true_ranks(means)
    different = means[:, None] > means
    for number in boards:
        rng = np.random.default_rng((seed, number))
        scores = draw(rng, means, CLUSTERS[number // len(KINDS) % len(CLUSTERS)])
        order = rng.permutation(len(means))
        begin = time.process_time()
        found = rank_intervals(scores[order], confidence=CONFIDENCE, resamples=resamples, seed=number)
        spent += time.process_time() - begin
        covered += _holds(found.low, found.high, best[order], worst[order])
        places += float(np.mean(found.high - found.low + 1))
        separated.extend(found.is_better[different[np.ix_(order, order)]].tolist())
        by_pairs += _holds(*_judge_pairs(scores.mean(axis=2)), best, worst)
    share = float(np.mean(separated)) if separated else math.nan
    n = len(boards)
    return Count(kind, n, covered, places / n, share, by_pairs, 1e3 * spent / n)


def true_ranks(means: Float64) -> tuple[Int64, Int64]:
    """Return the best and the worst true rank (M,) of methods; they differ for ties."""
    better = means[:, None] < means
    return 1 + better.sum(axis=1), len(means) - better.sum(axis=0)


def _judge_pairs(scores: Float64) -> tuple[Int64, Int64]:
    """Judge each pair of methods by an interval of its own, as if it were the only one."""
    methods, clusters = scores.shape
    is_better: Bool = np.zeros((methods, methods), bool)
    for one, other in zip(*np.triu_indices(methods, 1)):
        interval = mean_interval(scores[one] - scores[other], np.arange(clusters), confidence=CONFIDENCE, resamples=500)
        is_better[one, other], is_better[other, one] = interval.low > 0.0, interval.high < 0.0
    return 1 + is_better.sum(axis=0), methods - is_better.sum(axis=1)


def _holds(low: Int64, high: Int64, best: Int64, worst: Int64) -> bool:
    return bool(np.all((low <= best) & (worst <= high)))


def _add(counts: Sequence[Count]) -> Count:
    boards = sum(one.boards for one in counts)

    def mean(name: str) -> float:
        return float(np.nansum([getattr(one, name) * one.boards for one in counts])) / boards

    known = [one for one in counts if not math.isnan(one.separated)]
    share = sum(one.separated * one.boards for one in known) / sum(one.boards for one in known)
    covered, by_pairs = (sum(getattr(one, name) for one in counts) for name in ("covered", "covered_by_pairs"))
    return Count("all", boards, covered, mean("places"), share, by_pairs, mean("ms"))


def _print(one: Count) -> None:
    share = one.covered / one.boards
    # The error of a share as expected, which is not 0 where all are covered.
    error = math.sqrt(CONFIDENCE * (1.0 - CONFIDENCE) / one.boards)
    print(
        f"{one.kind:28} {one.boards:4d} {share:8.1%} {error:6.1%} {one.places:7.2f} {one.separated:10.1%} "
        f"{one.covered_by_pairs / one.boards:9.1%} {one.ms:6.1f}",
        flush=True,
    )
