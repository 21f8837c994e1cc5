"""The number of examples that properties are tried with: a quarter in ``make test``, all in ``make fuzz``."""

from __future__ import annotations

import os

PROFILE = os.environ.get("HYPOTHESIS_PROFILE", "mirror")
"""``mirror``: a quarter of the examples; ``whole``: all; ``explore``: others, 500 where no number is stated."""


def draws(count: int) -> int:
    """Return how many of the examples of a property are tried in this run.

    Args:
        count: how many there are in ``make fuzz`` and for mutants.
    """
    return -(-count // 4) if PROFILE == "mirror" else count
