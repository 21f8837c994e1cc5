"""Groups of agents that advance together, in a fixed order of rows."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from hybridworldsim.simulator.agents.states import Agent, AgentStates, Boxes
from mirror.arrays import Int64
from mirror.errors import UsageError


class AgentGroup(Protocol):
    """Agents that one rule moves."""

    @property
    def agents(self) -> tuple[Agent, ...]:
        """The agents."""
        ...

    def start(self) -> AgentStates:
        """Return the states at the start."""
        ...

    def advance(self, step: int, boxes: Boxes, rows: Int64) -> AgentStates:
        """Return the states after a step, from the boxes of all actors before it; ``rows`` index the group's boxes."""
        ...


class AllAgents:
    """The agents of a rollout, ordered by id regardless of the order of their groups.

    Args:
        groups: the groups.

    Raises:
        UsageError: two agents have the same id.
    """

    def __init__(self, groups: Sequence[AgentGroup]) -> None:
        self._groups = tuple(groups)
        agents = [agent for group in groups for agent in group.agents]
        ids = [agent.agent_id for agent in agents]
        twice = sorted({name for name in ids if ids.count(name) > 1} | ({"ego"} & set(ids)))
        if twice:
            raise UsageError(f"two actors are named {twice[0]!r}", expected="distinct ids of agents")
        order = np.argsort(np.array(ids, dtype=object), kind="stable") if ids else np.zeros(0, np.int64)
        self.agents = tuple(agents[place] for place in order)
        row_of = np.empty(len(agents), np.int64)
        row_of[order] = np.arange(len(agents))
        ends = np.cumsum([0, *(len(group.agents) for group in groups)])
        self._rows = [row_of[begin:end] for begin, end in itertools.pairwise(ends)]

    def start(self) -> AgentStates:
        """Return the states of all agents at the start."""
        return self._collect([group.start() for group in self._groups])

    def advance(self, step: int, boxes: Boxes) -> AgentStates:
        """Return the states of all agents after a step; the ego is row 0 of ``boxes``."""
        return self._collect(
            [group.advance(step, boxes, rows + 1) for group, rows in zip(self._groups, self._rows, strict=True)]
        )

    def _collect(self, parts: Sequence[AgentStates]) -> AgentStates:
        states = AgentStates.absent(len(self.agents))
        for rows, part in zip(self._rows, parts, strict=True):
            states.put(rows, part)
        return states
