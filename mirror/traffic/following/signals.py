"""The states of traffic lights."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
import numpy.typing as npt

from mirror.arrays import Int64
from mirror.traffic.following.simulation import signal_at
from mirror.traffic.lanes.network import Network


class Signal(IntEnum):
    """State of a signal group."""

    GREEN = 0
    AMBER = 1
    RED = 2
    RED_AMBER = 3


def signal_state(network: Network, clock_s: npt.ArrayLike) -> Int64:
    """Return the states of the signals.

    Args:
        network: network of the scene.
        clock_s: (...,) times of the signal cycle: a drive's ``clock_s`` plus the time since its start.

    Returns:
        (..., groups) values of `Signal`; 0 groups for a scene without signals.
    """
    clocks = np.asarray(clock_s, np.float64)
    green = np.ascontiguousarray(network.green_s, np.float64).reshape(-1, 2)
    shown = [
        signal_at(green, network.cycle_s, group, float(clock)) for clock in clocks.flat for group in range(len(green))
    ]
    return np.array(shown, np.int64).reshape(*clocks.shape, len(green))
