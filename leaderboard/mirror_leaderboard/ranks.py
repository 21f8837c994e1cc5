"""Ranks of the rows of a board, with intervals from the figure that ranks in each scene or scenario."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from mirror.arrays import Float64
from mirror.counting import count_of
from mirror.evaluation.figures import linearise_mean
from mirror.metrics.ranks import MIN_CLUSTERS, rank_intervals
from mirror_leaderboard.entry import Entry, Measured

_EQUAL: Final = 1e-12
"""Values that differ by less than this share are equal."""


@dataclass(frozen=True)
class Rank:
    """The rank of a row.

    Attributes:
        rank: the rank; rows that are not separated share one. None: the row has none.
        low: best rank that the row can have; None: there is no interval.
        high: worst rank that it can have.
        reason: why the row is not ranked beside the others; None: it is, or it has no value to be ranked by.
    """

    rank: int | None = None
    low: int | None = None
    high: int | None = None
    reason: str | None = None


@dataclass(frozen=True)
class BoardRanks:
    """The ranks of a board.

    Attributes:
        rows: one for each entry, in the board's order.
        cluster: what is resampled: ``scene`` or ``scenario``.
        n_clusters: number of those from which the intervals are computed; 0: there are no intervals.
        reason: why there are no intervals; None: there are.
    """

    rows: tuple[Rank, ...]
    cluster: str
    n_clusters: int
    reason: str | None


def rank_rows(
    entries: Sequence[Entry], values: Sequence[float | None], better: Literal["higher", "lower"], cluster: str
) -> BoardRanks:
    """Rank the rows of a board.

    Rows with values of the same clusters are ranked among themselves, and others not beside them. Without intervals,
    ranks are places that equal values share: where no two rows have such values, or in fewer than `MIN_CLUSTERS`
    clusters.

    Args:
        entries: the entries.
        values: the figure that ranks of each entry; None: the entry is not ranked.
        better: direction of the figure.
        cluster: name of a cluster.
    """
    keys = [_list_keys(entry) if value is not None else () for entry, value in zip(entries, values)]
    known = Counter(filter(None, keys))
    common = max(known, key=lambda one: (known[one], len(one), one), default=())
    reason = None
    if not known:
        reason = f"the entries keep no values of single {cluster}s"
    elif known[common] < 2:
        reason = f"no two rows keep the values of the same {cluster}s"
    elif len(common) < MIN_CLUSTERS:
        reason = f"{count_of(len(common), cluster)}, of which they need {MIN_CLUSTERS}"
    if reason is not None:
        return BoardRanks(tuple(Rank(place) for place in _list_places(values, better)), cluster, 0, reason)
    compared = [place for place, one in enumerate(keys) if one == common]
    found = rank_intervals(np.array([_spread_clusters(entries[place]) for place in compared]), better=better)
    rows = [Rank(reason=_describe_lack(one, common, cluster)) for one in keys]
    for place, rank, low, high in zip(compared, found.ranks, found.low, found.high):
        rows[place] = Rank(int(rank), int(low), int(high))
    unranked = [Rank() if value is None else row for row, value in zip(rows, values)]
    return BoardRanks(tuple(unranked), cluster, len(common), None)


def _list_keys(entry: Entry) -> tuple[str, ...]:
    return tuple(one.key for one in entry.clusters) if isinstance(entry, Measured) else ()


def _spread_clusters(entry: Entry) -> Float64:
    """Return values of clusters whose plain mean is the figure, and whose deviations are those of its weighted mean."""
    clusters = entry.clusters if isinstance(entry, Measured) else ()
    values, weights = (np.array([getattr(one, name) for one in clusters]) for name in ("value", "weight"))
    return linearise_mean(values, weights / math.fsum(weights))


def _describe_lack(keys: tuple[str, ...], common: tuple[str, ...], cluster: str) -> str:
    lack = f"no values of single {cluster}s" if not keys else f"values of other {cluster}s"
    return f"not ranked beside the others: the entry keeps {lack}"


def _list_places(values: Sequence[float | None], better: Literal["higher", "lower"]) -> list[int | None]:
    """List the place of each value: one more than the number of better values."""
    sign = 1.0 if better == "higher" else -1.0
    signed = [None if value is None else sign * value for value in values]
    known = [value for value in signed if value is not None]

    def place(value: float) -> int:
        return 1 + sum(other > value and not math.isclose(other, value, rel_tol=_EQUAL) for other in known)

    return [None if value is None else place(value) for value in signed]
