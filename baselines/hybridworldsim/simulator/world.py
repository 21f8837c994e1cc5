"""The world of a rollout: the states of the ego and of all agents, advanced step by step."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from hybridworldsim.simulator.agents.groups import AllAgents
from hybridworldsim.simulator.agents.states import Agent, AgentStates, Boxes
from hybridworldsim.simulator.ego.vehicle import (
    Controls,
    EgoState,
    VehicleParameters,
    advance,
    center_position,
    center_velocity,
)
from mirror.arrays import Float64, Int64
from mirror.metrics.safety import StateLog
from mirror.schema.road_features import SIGNAL_STATES, SignalState

EGO: Final = "ego"


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The world at one instant.

    Attributes:
        step: number of steps since the start.
        time_s: time since the start.
        stamp_ns: Unix time.
        vehicle: the ego vehicle.
        ego: state of the ego.
        agents: the agents, ordered by id.
        states: their states.
        signals: states of the signals by id.
    """

    step: int
    time_s: float
    stamp_ns: int
    vehicle: VehicleParameters
    ego: EgoState
    agents: tuple[Agent, ...]
    states: AgentStates
    signals: Mapping[str, SignalState]

    def boxes(self) -> Boxes:
        """Return the boxes of all actors, which must not be changed; the ego is the first."""
        return self._boxes

    @cached_property
    def _boxes(self) -> Boxes:
        rows = np.empty((len(self.agents) + 1, 7))
        vehicle, ego = self.vehicle, self.ego
        center = center_position(vehicle, ego)
        rows[0] = (*center, ego.yaw_rad, ego.speed_mps, 0.5 * vehicle.length_m, 0.5 * vehicle.width_m, 1.0)
        states = self.states
        rows[1:, 0], rows[1:, 1], rows[1:, 2] = states.x_m, states.y_m, states.yaw_rad
        rows[1:, 3] = states.vx_mps * np.cos(states.yaw_rad) + states.vy_mps * np.sin(states.yaw_rad)
        if self.agents:
            rows[1:, 4:6] = 0.5 * np.array([agent.size_m[:2] for agent in self.agents])
        rows[1:, 6] = states.present
        return Boxes(rows)


class SimulatedWorld:
    """The ego and all agents.

    Args:
        vehicle: the ego vehicle.
        ego: its state at the start.
        agents: all agents.
        start_ns: Unix time of the start.
        step_s: duration of a step.
        signals: returns the state of every signal at a time in seconds since the start.
    """

    def __init__(
        self,
        vehicle: VehicleParameters,
        ego: EgoState,
        agents: AllAgents,
        start_ns: int,
        step_s: float,
        signals: Callable[[float], Mapping[str, SignalState]] = lambda time_s: {},
    ) -> None:
        self._agents, self._start_ns, self._step_s, self._signals = agents, start_ns, step_s, signals
        self.now = Snapshot(0, 0.0, start_ns, vehicle, ego, agents.agents, agents.start(), signals(0.0))

    def advance(self, controls: Controls) -> Snapshot:
        """Advance the ego and all agents by one step, all from the same state; returns the new state."""
        now = self.now
        states = self._agents.advance(now.step, now.boxes())
        ego = advance(now.vehicle, now.ego, controls, self._step_s)
        step = now.step + 1
        time_s = step * self._step_s
        stamp = self._start_ns + round(time_s * 1e9)
        self.now = Snapshot(step, time_s, stamp, now.vehicle, ego, now.agents, states, self._signals(time_s))
        return self.now


class StateRecorder:
    """A recorder of the states of a rollout."""

    def __init__(self) -> None:
        self.snapshots: list[Snapshot] = []

    def add(self, snapshot: Snapshot) -> None:
        """Add the state of an instant."""
        self.snapshots.append(snapshot)

    def log(self, last: int | None = None) -> StateLog:
        """Return the log of all states, or of the last few."""
        shots = self.snapshots if last is None else self.snapshots[-last:]
        return state_log(shots)


def state_log(snapshots: list[Snapshot], rows: Int64 | None = None) -> StateLog:
    """Make a log of states; the ego is actor 0, the agents follow in the order of their ids.

    Args:
        snapshots: the states.
        rows: (K,) numbers of the agents in the log; None: all.
    """
    first = snapshots[0]
    chosen = np.arange(len(first.agents)) if rows is None else rows
    vehicle, agents = first.vehicle, [first.agents[row] for row in chosen]
    shape = len(snapshots), len(agents) + 1
    columns: dict[str, Float64] = {name: np.empty(shape) for name in ("x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps")}
    present = np.ones(shape, np.bool_)
    for row, shot in enumerate(snapshots):
        ego = (*center_position(vehicle, shot.ego), shot.ego.yaw_rad, *center_velocity(vehicle, shot.ego))
        for (name, values), value in zip(columns.items(), ego, strict=True):
            values[row, 0] = value
            values[row, 1:] = getattr(shot.states, name)[chosen]
        present[row, 1:] = shot.states.present[chosen]
    columns["yaw_rad"] = wrap_angles(columns["yaw_rad"])
    return StateLog(
        stamps_ns=np.array([shot.stamp_ns for shot in snapshots], np.int64),
        **columns,
        length_m=np.array([vehicle.length_m, *(agent.size_m[0] for agent in agents)]),
        width_m=np.array([vehicle.width_m, *(agent.size_m[1] for agent in agents)]),
        present=present,
        ids=(EGO, *(agent.agent_id for agent in agents)),
        categories=(EGO, *(agent.category for agent in agents)),
        rear_axle_to_center_m=vehicle.rear_axle_to_center_m,
        signals=tuple(first.signals),
        signal_states=np.array(
            [[SIGNAL_STATES.index(state) for state in shot.signals.values()] for shot in snapshots], np.int8
        ).reshape(len(snapshots), len(first.signals)),
    )


def wrap_angles(angles_rad: Float64) -> Float64:
    """Return angles between -pi and pi."""
    wrapped: Float64 = np.remainder(angles_rad + math.pi, 2.0 * math.pi) - math.pi
    return wrapped
