"""Drives the recorded controls of a rollout again, without a policy and without images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybridworldsim.simulator.ego.vehicle import Controls
from hybridworldsim.simulator.simulation import start_simulation
from hybridworldsim.simulator.street.street import Street
from hybridworldsim.simulator.world import state_log
from mirror.metrics.safety import StateLog
from mirror.schema.rollout import Ending
from mirror.schema.scenario import Scenario


@dataclass(frozen=True, eq=False)
class DrivenAgain:
    """The states that result when recorded controls are driven again.

    Attributes:
        log: the states of the ego and of the agents that are present at some instant.
        steps: number of controls that were driven.
        ending: why the rollout ended; None: the controls ended before it did.
        route_m: points (x, y) of the ego's route.
    """

    log: StateLog
    steps: int
    ending: Ending | None
    route_m: tuple[tuple[float, float], ...]


def drive_again(
    street: Street, scenario: Scenario, controls: Sequence[Controls], *, ends_off_road: bool = False
) -> DrivenAgain:
    """Drive a rollout by the given controls of each step, until the rollout ends or no controls are left.

    The same street, scenario and controls give the same states as `run_rollout` with a policy that answers them.

    Args:
        street: the street.
        scenario: the scenario, whose seed is that of the rollout.
        controls: the controls.
        ends_off_road: whether the rollout ends where the whole body of the ego is off the drivable area.

    Raises:
        UsageError: the scenario does not fit on the street.
    """
    simulation = start_simulation(street, scenario, ends_off_road=ends_off_road)
    ending: Ending | None = None
    for one in controls:
        ending = simulation.advance(one)
        if ending is not None:
            break
    route = tuple((float(x), float(y)) for x, y in simulation.route.way.points)
    snapshots = simulation.recorder.snapshots
    seen = np.flatnonzero(np.any([shot.states.present for shot in snapshots], axis=0))
    return DrivenAgain(state_log(snapshots, seen), simulation.now.step, ending, route)
