"""A metric's value that says why it is not a number, where it is not."""

from __future__ import annotations

from typing import Any


class Score(float):
    """A float; where it is NaN, ``reason`` says why.

    It counts, formats and serialises as the float it is.

    Args:
        value: the score.
        reason: why the value is NaN; None where it is a number.
    """

    reason: str | None

    def __new__(cls, value: float, reason: str | None = None) -> Score:
        """Make a float with a reason."""
        score = super().__new__(cls, value)
        score.reason = reason
        return score

    def __reduce__(self) -> tuple[Any, ...]:
        return Score, (float(self), self.reason)


EMPTY_MASK = Score(float("nan"), "the mask selects no pixel")
