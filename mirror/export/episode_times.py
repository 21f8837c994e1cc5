"""Times of episodes: LeRobot takes the time of a row for its number in the episode divided by the rate."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

GAP_STEPS: Final = 1.5
"""A longer step, in median steps of its traversal, is a gap."""


def rates(episodes: Sequence[Sequence[int]]) -> tuple[float, int]:
    """Return the median rate of rows in hertz, and the whole number for LeRobot's document.

    Args:
        episodes: times of the rows of each episode, nanoseconds.
    """
    steps = np.concatenate([np.diff(stamps) for stamps in episodes])
    rate_hz = 1e9 / float(np.median(steps)) if len(steps) else 1.0
    return rate_hz, max(1, round(rate_hz))


def drift_s(stamps: Sequence[int], fps: int) -> float:
    """Return the largest difference, in seconds, between the times (N,) of an episode and its row numbers / ``fps``."""
    seconds = (np.array(stamps, np.int64) - stamps[0]) * 1e-9
    return float(np.abs(seconds - np.arange(len(stamps)) / fps).max())


def split_at_gaps(stamps: Sequence[int]) -> list[slice]:
    """Split a traversal into runs without a step longer than `GAP_STEPS` median steps.

    Args:
        stamps: (N,) increasing times, nanoseconds.
    """
    steps = np.diff(np.array(stamps, np.int64))
    if not len(steps):
        return [slice(0, len(stamps))]
    cuts = [0, *(np.flatnonzero(steps > GAP_STEPS * np.median(steps)) + 1).tolist(), len(stamps)]
    return [slice(first, last) for first, last in pairwise(cuts)]
