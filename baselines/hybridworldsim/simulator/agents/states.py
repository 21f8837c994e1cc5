"""The states of all agents at one instant, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Final

import numpy as np

from mirror.arrays import Bool, Float64, Int64
from mirror.errors import UsageError

if TYPE_CHECKING:
    from mirror.synth import Body

PEDESTRIAN: Final = "pedestrian"


@dataclass(frozen=True)
class Agent:
    """The constant attributes of a road user: id, category and size.

    Attributes:
        agent_id: id, unique in a rollout.
        category: ``car``, ``van``, ``truck``, ``bus``, ``motorcycle``, ``bicycle`` or ``pedestrian``.
        size_m: length, width and height of its box.
        body: its shape; None: renderers choose one of that category and size.
    """

    agent_id: str
    category: str
    size_m: tuple[float, float, float]
    body: Body | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        if not all(np.isfinite(size) and size > 0.0 for size in self.size_m):
            raise UsageError(f"size_m is {self.size_m}", place=f"agent {self.agent_id!r}", expected="positive sizes")


@dataclass(frozen=True, eq=False)
class AgentStates:
    """States of N agents at the middles of their boxes, in the world; values of absent agents are not read.

    Attributes:
        x_m: (N,) positions.
        y_m: (N,) positions.
        yaw_rad: (N,) headings, counter-clockwise from x.
        vx_mps: (N,) velocities along x.
        vy_mps: (N,) velocities along y.
        along_m: (N,) distances travelled, from which the phase of a walk follows.
        present: (N,) whether the agent exists.
    """

    x_m: Float64
    y_m: Float64
    yaw_rad: Float64
    vx_mps: Float64
    vy_mps: Float64
    along_m: Float64
    present: Bool

    def __len__(self) -> int:
        return len(self.x_m)

    @classmethod
    def absent(cls, count: int) -> AgentStates:
        """Return the states of agents that do not exist yet."""
        x, y, yaw, vx, vy, along = np.zeros((6, count))
        return cls(x, y, yaw, vx, vy, along, np.zeros(count, np.bool_))

    def put(self, rows: Int64, states: AgentStates) -> None:
        """Write the states of some agents into these arrays."""
        for column in fields(self):
            getattr(self, column.name)[rows] = getattr(states, column.name)


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes of all actors at one instant, as agents perceive them; the ego is the first.

    Attributes:
        states: (M, 7) x, y, yaw, forward speed, half length, half width, and 1 where the actor exists.
    """

    states: Float64
