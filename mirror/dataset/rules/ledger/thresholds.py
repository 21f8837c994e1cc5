"""What the trigger's thresholds make of the figures in a ledger."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.dataset.check.rows import Rows
from mirror.schema.documents import TriggerOptions


@dataclass(frozen=True)
class Threshold:
    """One of the trigger's thresholds.

    Attributes:
        rule: its name in the ledger.
        column: the figure that it looks at.
        limit: what it asks for.
        strict: the figure has to be above the limit, and not just reach it.
    """

    rule: str
    column: str
    limit: float
    strict: bool

    def met(self, passes: Rows) -> Bool:
        """(N,) True where the figure fulfils it."""
        figure = passes.floats(self.column)
        return figure > self.limit if self.strict else figure >= self.limit

    def __str__(self) -> str:
        return f"{self.column} {'above' if self.strict else 'at least'} {self.limit:g}"


def thresholds(trigger: TriggerOptions) -> tuple[Threshold, ...]:
    """The thresholds in the order in which the trigger asks them: the first that fails is named in the ledger."""
    return (
        Threshold("min_duration", "duration_s", trigger.min_duration_s, strict=False),
        Threshold("min_path", "path_m", trigger.min_path_m, strict=False),
        Threshold("min_overlap", "overlap", trigger.min_overlap, strict=True),
    )


def accepted(passes: Rows) -> Bool:
    """(N,) True where the decision is ``accepted``."""
    codes, words = passes.words("decision")
    return np.isin(codes, [code for code, word in enumerate(words) if word == "accepted"])


def figures(passes: Rows) -> dict[str, Float64]:
    """The measured columns of a ledger by name."""
    names = ("duration_s", "path_m", "inside_path_m", "overlap", "closest_m", "mean_speed_mps")
    return {name: passes.floats(name) for name in names}
