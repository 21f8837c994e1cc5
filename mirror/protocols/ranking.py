"""The ranking key of a protocol: the one figure that orders a board, leads a report and decides a comparison."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Final

from pydantic import Field, model_validator

from mirror.schema.documents import Document

ALL: Final = "all"
"""The group of figures that are means over several groups of a protocol."""


_SHIFT: Final = re.compile(r"(?:(left|right)-)?([0-9.]+)m")
_GROUPS: Final[Mapping[str, str]] = {
    "training": "Training traversals",
    "novel": "Novel traversals",
    "all": "All",
    "reported": "Stated",
    "measured": "Measured here",
}


def group_title(group: str) -> str:
    """Return the title of a protocol's group in reports and on boards."""
    shift = _SHIFT.fullmatch(group)
    if shift is not None:
        return " ".join(filter(None, (shift[2], "m", shift[1])))
    return _GROUPS.get(group, group.replace("-", " "))


class Gate(Document):
    """A second figure that a row must reach in order to be ranked; rows that miss it follow all ranked rows.

    Attributes:
        metric: name of the figure, of the same group as the ranking figure.
        at_least: smallest value that is ranked; None: no lower bound.
        at_most: largest value that is ranked; None: no upper bound.
    """

    metric: str
    at_least: float | None = None
    at_most: float | None = None

    @model_validator(mode="after")
    def _bounded(self) -> Gate:
        if self.at_least is None and self.at_most is None:
            raise ValueError("a gate needs at_least or at_most")
        return self


class Ranking(Document):
    """The figure that ranks results. Its direction is the metric's own.

    Attributes:
        metric: name of the figure.
        groups: groups whose mean ranks; each group counts equally.
        gate: a second figure that a row must reach in order to be ranked; None: every row with a value is ranked.
    """

    metric: str
    groups: tuple[str, ...] = Field(min_length=1)
    gate: Gate | None = Field(default=None, exclude_if=lambda gate: gate is None)

    @property
    def group(self) -> str:
        """The group of the figure that ranks: the only one, or `ALL` for a mean over several."""
        return self.groups[0] if len(self.groups) == 1 else ALL

    @property
    def column(self) -> tuple[str, str]:
        """Group and metric of the figure that ranks."""
        return self.group, self.metric

    def passes_gate(self, find_value: Callable[[tuple[str, str]], float | None]) -> bool:
        """Return whether a row meets the gate, given a function that finds its figures; False without the figure."""
        if self.gate is None:
            return True
        value = find_value((self.group, self.gate.metric))
        if value is None:
            return False
        is_low = self.gate.at_least is not None and value < self.gate.at_least
        is_high = self.gate.at_most is not None and value > self.gate.at_most
        return not (is_low or is_high)
