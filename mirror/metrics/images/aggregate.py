"""Many scores in one line: how many, how many finite, infinite and missing, and the mean of the finite ones.

The mean over images is the default of the field (DriveStudio, MTGS within a traversal). MTGS goes on to average the
means of traversals: ``summarise(summary.mean for summary in by_group(scores, traversals).values())``.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from mirror.errors import UsageError
from mirror.metrics.score import Score

_Group = TypeVar("_Group", bound=Hashable)


@dataclass(frozen=True)
class Summary:
    """The mean and the counts of a set of scores.

    Attributes:
        n: number of scores.
        n_finite: of those, how many the mean is of.
        n_inf: how many are infinite: PSNR of equal images. They are never in the mean.
        n_nan: how many are missing.
        mean: of the finite scores; NaN with a reason if there is none.
        reasons: why scores are missing, and how often.
    """

    n: int
    n_finite: int
    n_inf: int
    n_nan: int
    mean: Score
    reasons: Mapping[str, int]


def summarise(scores: Iterable[float]) -> Summary:
    """Summarise scores; the result does not depend on their order.

    Args:
        scores: floats, or `Score` of which NaN has a reason.

    Returns:
        Their counts and mean.
    """
    scores = list(scores)
    missing = [score for score in scores if math.isnan(score)]
    finite = [float(score) for score in scores if math.isfinite(score)]
    n_inf = len(scores) - len(missing) - len(finite)
    reasons = Counter(getattr(score, "reason", None) or "not a number" for score in missing)
    return Summary(len(scores), len(finite), n_inf, len(missing), _mean(finite, n_inf, reasons), dict(reasons))


def by_group(scores: Iterable[float], groups: Iterable[_Group]) -> dict[_Group, Summary]:
    """Summarise scores by group: a camera, a traversal, a scene, a condition.

    Args:
        scores: one an image.
        groups: what each belongs to.

    Returns:
        A summary a group, in the order in which the groups first appear.

    Raises:
        UsageError: there are not as many groups as scores.
    """
    members: dict[_Group, list[float]] = {}
    scores, groups = list(scores), list(groups)
    if len(scores) != len(groups):
        raise UsageError(f"{len(groups)} groups of {len(scores)} scores", expected="a group for each score")
    for score, group in zip(scores, groups, strict=True):
        members.setdefault(group, []).append(score)
    return {group: summarise(found) for group, found in members.items()}


class Scores:
    """An accumulator of scores of one metric."""

    def __init__(self) -> None:
        self.values: list[float] = []

    def update(self, score: float) -> None:
        """Add a score."""
        self.values.append(score)

    def merge(self, other: Scores) -> None:
        """Add the scores of another accumulator."""
        self.values.extend(other.values)

    def compute(self) -> Summary:
        """Return the summary so far."""
        return summarise(self.values)


def _mean(finite: list[float], n_inf: int, reasons: Mapping[str, int]) -> Score:
    if finite:
        return Score(math.fsum(finite) / len(finite))
    why = [f"{n_inf} infinite"] if n_inf else []
    why += [f"{count} times: {reason}" for reason, count in reasons.items()]
    return Score(math.nan, f"no score is finite ({'; '.join(why)})" if why else "there is no score")
