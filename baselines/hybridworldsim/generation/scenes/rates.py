"""Whether frames are as far apart as in training: a generator knows the motion between frames at one rate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from mirror.dataset.dataset import Dataset
from mirror.protocols.views.plan import Plan

TOLERANCE: Final = 1.2
"""Factor between two rates that are taken as equal."""


def plan_rates(dataset: Dataset, plan: Plan) -> list[float]:
    """Return the rate of each rollout of a plan's views, in frames per second; none for a single frame.

    Args:
        dataset: the dataset.
        plan: the requested views; those of one group and traversal are one rollout.
    """
    numbers: dict[tuple[str, str], set[int]] = {}
    for view in plan.views:
        numbers.setdefault((view.group, view.traversal_id), set()).add(view.frame_index)
    stamps: dict[str, dict[int, int]] = {}
    rates = []
    for (_, traversal), chosen in numbers.items():
        if traversal not in stamps:
            frames = dataset.where(traversal=traversal).frames()
            stamps[traversal] = {frame.frame_index: frame.timestamp_ns for frame in frames}
        if len(chosen) > 1:
            rates.append(rate_of([stamps[traversal][number] for number in sorted(chosen)]))
    return rates


def rate_of(timestamps_ns: Sequence[int]) -> float:
    """Return the rate of frames from the median of their time differences, in frames per second."""
    return 1e9 / float(np.median(np.diff(np.array(timestamps_ns, np.int64))))


def rate_note(rates_hz: Sequence[float], trained_hz: tuple[float, float] | None) -> str:
    """Return a warning if a rate is outside the rates of the training, else an empty text.

    Args:
        rates_hz: rates at which frames are generated.
        trained_hz: lowest and highest rate of the training; None: unknown.
    """
    if not rates_hz:
        return ""
    used = _span(min(rates_hz), max(rates_hz))
    if trained_hz is None:
        return f"frames are generated at {used}; the generator's file does not state the rate of its training"
    low, high = trained_hz
    if low / TOLERANCE <= min(rates_hz) and max(rates_hz) <= high * TOLERANCE:
        return ""
    return f"frames are generated at {used}, the generator was trained at {_span(low, high)}: motion may look wrong"


def _span(low: float, high: float) -> str:
    return f"{low:.3g} Hz" if high < 1.01 * low else f"{low:.3g} to {high:.3g} Hz"
