"""Agents that repeat what was recorded, whatever the ego does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybridworldsim.simulator.agents.states import Agent, AgentStates, Boxes
from mirror.arrays import Float64, Int64
from mirror.errors import UsageError

_HALF_STEP_S = 0.05


@dataclass(frozen=True, eq=False)
class RecordedTrack:
    """The recorded track of a road user.

    Attributes:
        agent: its id, category and size.
        times_s: (T,) times since the start of the recording, strictly increasing.
        poses: (T, 3) x, y of the middle of its box in the world, and yaw.
    """

    agent: Agent
    times_s: Float64
    poses: Float64

    def __post_init__(self) -> None:
        if len(self.times_s) != len(self.poses) or not len(self.times_s) or (np.diff(self.times_s) <= 0.0).any():
            raise UsageError(
                "times do not increase or have another length than the poses", place=f"track {self.agent.agent_id!r}"
            )

    def at(self, time_s: Float64) -> Float64:
        """Return poses (K, 3) at times (K,), linear in time; before the first and after the last, the nearest pose."""
        yaw = np.unwrap(self.poses[:, 2])
        columns = (self.poses[:, 0], self.poses[:, 1], yaw)
        return np.column_stack([np.interp(time_s, self.times_s, values) for values in columns])


class ReplayedAgents:
    """Agents that replay recorded tracks.

    Args:
        tracks: the tracks.
        start_s: time of the recording at the start of the rollout.
        step_s: duration of a step.
        steps: number of steps.
    """

    def __init__(self, tracks: Sequence[RecordedTrack], start_s: float, step_s: float, steps: int) -> None:
        self.agents = tuple(track.agent for track in tracks)
        times: Float64 = start_s + step_s * np.arange(steps + 1, dtype=np.float64)
        count = len(tracks)
        self._poses = np.zeros((steps + 1, count, 3))
        self._velocities = np.zeros((steps + 1, count, 2))
        self._along = np.zeros((steps + 1, count))
        self._present = np.zeros((steps + 1, count), np.bool_)
        for column, track in enumerate(tracks):
            self._poses[:, column] = track.at(times)
            low = np.clip(times - _HALF_STEP_S, track.times_s[0], track.times_s[-1])
            high = np.clip(times + _HALF_STEP_S, track.times_s[0], track.times_s[-1])
            change = track.at(high)[:, :2] - track.at(low)[:, :2]
            span = high - low
            moving = span > 0.0
            self._velocities[moving, column] = change[moving] / span[moving, None]
            steps_m = np.linalg.norm(np.diff(self._poses[:, column, :2], axis=0), axis=1)
            self._along[1:, column] = np.cumsum(steps_m)
            # A track of one instant is that of something that stands there throughout.
            if len(track.times_s) == 1:
                self._present[:, column] = True
            else:
                self._present[:, column] = (times >= track.times_s[0]) & (times <= track.times_s[-1])

    def start(self) -> AgentStates:
        """Return the states at the start."""
        return self._at(0)

    def advance(self, step: int, boxes: Boxes, rows: Int64) -> AgentStates:
        """Return the states after a step; ``boxes`` are not read."""
        return self._at(min(step + 1, len(self._poses) - 1))

    def _at(self, row: int) -> AgentStates:
        poses, velocities = self._poses[row], self._velocities[row]
        return AgentStates(
            poses[:, 0].copy(),
            poses[:, 1].copy(),
            poses[:, 2].copy(),
            velocities[:, 0].copy(),
            velocities[:, 1].copy(),
            self._along[row].copy(),
            self._present[row].copy(),
        )
