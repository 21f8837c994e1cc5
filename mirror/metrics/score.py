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

    def _repr_html_(self) -> str:
        """Return the score as HTML for notebooks: the number, or why there is none."""
        from mirror.pages.notebook import show_rows

        return show_rows("Score", ("value",), [(f"{self:.4f}" if self.reason is None else f"none: {self.reason}",)])

    def __reduce__(self) -> tuple[Any, ...]:
        return Score, (float(self), self.reason)


EMPTY_MASK = Score(float("nan"), "the mask selects no pixel")
