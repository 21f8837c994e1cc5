"""Comparison of two logs of one drive: the same actors at the same stamps, in the same places."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.metrics.safety.state_log import StateLog

TOLERANCE: Final = 1e-6
"""Greatest difference of positions (m), headings (rad), velocities (m/s) and sizes (m)."""


def find_difference(log: StateLog, other: StateLog) -> str | None:
    """Find the first difference of two logs, in words; None if they state the same drive to 1e-6.

    Actors may be in another order, but for the ego.

    Args:
        log: the log that is named in the words.
        other: the log that it is compared with.
    """
    if set(log.ids) != set(other.ids):
        name = min(set(log.ids) ^ set(other.ids))
        return f"actor {name!r} is {'not in the scenario' if name in log.ids else 'missing'}"
    if len(log.stamps_ns) != len(other.stamps_ns):
        return f"{len(log.stamps_ns)} instants, not {len(other.stamps_ns)}"
    order = np.array([log.ids.index(name) for name in other.ids])
    wrong = np.flatnonzero(log.stamps_ns != other.stamps_ns)
    if len(wrong):
        return f"instant {wrong[0]} is at {log.stamps_ns[wrong[0]]} ns, not {other.stamps_ns[wrong[0]]}"
    if log.signals != other.signals or not np.array_equal(log.shown_signals, other.shown_signals):
        return "the signals show other states"
    if abs(log.rear_axle_to_center_m - other.rear_axle_to_center_m) > TOLERANCE:
        return f"the rear axle is {log.rear_axle_to_center_m} m from the centre, not {other.rear_axle_to_center_m} m"
    for number, name in zip(order, other.ids):
        if log.categories[number] != other.categories[other.ids.index(name)]:
            return f"actor {name!r} is a {log.categories[number]}"
    present = log.present[:, order]
    for name in ("length_m", "width_m"):
        apart = np.abs(getattr(log, name)[order] - getattr(other, name))
        if apart.max() > TOLERANCE:
            return f"{name} of actor {other.ids[int(apart.argmax())]!r} differs by {apart.max():.3g} m"
    if not np.array_equal(present, other.present):
        row, actor = np.argwhere(present != other.present)[0]
        return f"actor {other.ids[actor]!r} is {'present' if present[row, actor] else 'absent'} at instant {row}"
    for name in ("x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps"):
        apart = np.where(present, getattr(log, name)[:, order] - getattr(other, name), 0.0)
        if name == "yaw_rad":
            apart -= 2.0 * np.pi * np.round(apart / (2.0 * np.pi))
        if np.abs(apart).max() > TOLERANCE:
            row, actor = np.argwhere(np.abs(apart) > TOLERANCE)[0]
            return f"{name} of actor {other.ids[actor]!r} differs by {abs(apart[row, actor]):.3g} at instant {row}"
    return None
