"""Agents on ways: they follow lines of the street, keep their distance to everybody, and play their scripts."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hybridworldsim.simulator.agents.attack import Attacker, AttackPlan, search_attack
from hybridworldsim.simulator.agents.corridor import follow, place_on_way, poses_on_ways
from hybridworldsim.simulator.agents.scripts import Script
from hybridworldsim.simulator.agents.states import Agent, AgentStates, Boxes
from mirror.arrays import Float64, Int64
from mirror.traffic.following.acceleration import Users, Ways
from mirror.traffic.following.participants import Manner
from mirror.traffic.lanes.ways import Way

_BEYOND_M: Final = 200.0
_MANNERS: Final = {
    "car": (60.0, 1.7, 1.3), "van": (38.0, 1.4, 1.4), "truck": (23.5, 0.9, 1.7), "bus": (27.0, 1.0, 1.6),
    "motorcycle": (60.0, 2.2, 1.3), "cyclist": (6.0, 0.8, 0.8), "pedestrian": (1.6, 0.9, 0.4),
}  # fmt: skip
"""Greatest speed, acceleration and headway by category."""


@dataclass(frozen=True)
class WayHalt:
    """A stop line on a way.

    Attributes:
        along_m: length along the way.
        signal_id: id of the signal that closes it.
    """

    along_m: float
    signal_id: str


@dataclass(frozen=True, eq=False)
class WayAgent:
    """An agent on a way, at the start.

    Attributes:
        agent: its id, category and size.
        way: way that it follows.
        front_m: length of its front end along the way.
        speed_mps: speed along the way.
        aside_m: offset to the left of the way.
        halts: stop lines on the way.
        script: its manoeuvre; None: it only drives.
        parked: whether it stands until its script begins, or for ever.
        attack: its attack, in place of a script.
        manner: its driving style; None: drawn from its id.
    """

    agent: Agent
    way: Way
    front_m: float
    speed_mps: float
    aside_m: float = 0.0
    halts: tuple[WayHalt, ...] = ()
    script: Script | None = None
    parked: bool = False
    attack: AttackPlan | None = None
    manner: Manner | None = None


def draw_manner(category: str, agent_id: str, seed: int) -> Manner:
    """Draw the driving style of an agent from the agent's id and the seed only."""
    digest = hashlib.sha256(f"{seed}/{agent_id}".encode()).digest()
    rng = np.random.default_rng(int.from_bytes(digest[:8], "little"))
    fastest, quick, headway = _MANNERS.get(category, _MANNERS["car"])
    lively = rng.uniform(0.85, 1.15)
    return Manner(
        eager=rng.uniform(0.88, 1.04),
        fastest_mps=fastest * rng.uniform(0.95, 1.02),
        pick_up_mps2=quick * lively,
        brake_mps2=2.0 * lively,
        headway_s=headway * rng.uniform(0.85, 1.25),
        phase=rng.uniform(0.0, 6.3),
    )


class AgentsOnWays:
    """All agents that follow ways.

    Args:
        agents: the agents.
        route: the ego's route, on which scripts measure their gaps.
        seed: seed of the driving styles.
        step_s: duration of a step.
        is_red: whether a signal is not green at a time in seconds since the start.
        is_drivable: whether all of some points (P, 2) lie on the drivable area; attacks stay there.
    """

    def __init__(
        self,
        agents: Sequence[WayAgent],
        route: Way,
        seed: int,
        step_s: float,
        *,
        is_red: Callable[[str, float], bool] = lambda signal_id, time_s: False,
        is_drivable: Callable[[Float64], bool] = lambda points: True,
    ) -> None:
        self.agents = tuple(member.agent for member in agents)
        self._members, self._route, self._step_s = tuple(agents), route, step_s
        self._is_red, self._is_drivable = is_red, is_drivable
        self._scripts = [
            member.script if member.attack is None else Script(member.attack.trigger_ttc_s, member.attack.latest_s)
            for member in agents
        ]
        ways: list[Way] = []
        halts: list[tuple[WayHalt, ...]] = []
        numbers = []
        for member in agents:
            known = [n for n, way in enumerate(ways) if way is member.way and halts[n] == member.halts]
            if not known:
                ways.append(member.way)
                halts.append(member.halts)
            numbers.append(known[0] if known else len(ways) - 1)
        self._halts = [halt for per_way in halts for halt in per_way]
        self._way = np.array(numbers, np.int64)
        self._lengths = np.array([way.length_m for way in ways])
        self._points = np.concatenate([np.zeros((0, 2)), *(way.points for way in ways)])
        self._ways = Ways(
            np.cumsum([0, *(len(way.points) for way in ways)], dtype=np.int64),
            np.concatenate([np.zeros(0), *(way.pace_mps for way in ways)]),
            np.cumsum([0, *(len(per_way) for per_way in halts)], dtype=np.int64),
            np.array([halt.along_m for halt in self._halts], np.float64),
            np.zeros(len(self._halts)),
            np.zeros(len(self._halts), np.int64),
            np.zeros(len(self._halts), np.uint8),
        )
        self._length = np.array([member.agent.size_m[0] for member in agents], np.float64)
        self._half_width = np.array([0.5 * member.agent.size_m[1] for member in agents], np.float64)
        self._users = _users(agents, self._way, self._length, seed)
        self._state = np.array(
            [(member.front_m, member.speed_mps, 0.0, member.aside_m, 0.0) for member in agents], np.float64
        ).reshape(-1, 5)
        self._start_m = self._state[:, 0].copy()
        self._began_s = np.full(len(agents), math.nan)
        self._own_mps = self._state[:, 1].copy()
        self._ended = np.zeros(len(agents), np.bool_)

    def start(self) -> AgentStates:
        """Return the states at the start."""
        return self._states()

    def begun_s(self) -> dict[str, float]:
        """Return the times at which scripts began, by agent."""
        return {agent.agent_id: float(time) for agent, time in zip(self.agents, self._began_s) if not math.isnan(time)}

    def advance(self, step: int, boxes: Boxes, rows: Int64) -> AgentStates:
        """Return the states after a step.

        Args:
            step: number of the step.
            boxes: boxes of all actors before the step.
            rows: (N,) rows of these agents in ``boxes``.
        """
        if not len(self.agents):
            return self._states()
        time_s = step * self._step_s
        ordered = np.full(len(self.agents), math.nan)
        for number, (member, script) in enumerate(zip(self._members, self._scripts, strict=True)):
            if script is None:
                ordered[number] = 0.0 if member.parked else math.nan
            else:
                ordered[number] = self._play(number, script, time_s, boxes.states, rows)
        closed = np.array([self._is_red(halt.signal_id, time_s) for halt in self._halts], np.int64)
        self._state = follow(
            self._ways, self._points, self._users, self._half_width, self._state, rows, boxes.states, closed,
            ordered, self._step_s,
        )  # fmt: skip
        for number, member in enumerate(self._members):
            script = self._scripts[number]
            if script is not None and not math.isnan(self._began_s[number]):
                offset, rate = script.shift(time_s + self._step_s - self._began_s[number])
                self._state[number, 3:] = member.aside_m + offset, rate
        return self._states()

    def _play(self, number: int, script: Script, time_s: float, boxes: Float64, rows: Int64) -> float:
        """Acceleration that the script orders now; NaN: the agent decides."""
        speed = float(self._state[number, 1])
        if math.isnan(self._began_s[number]):
            if time_s < script.latest_s and not self._time_to_collision(number, script, boxes) <= script.trigger_ttc_s:
                return math.nan if script.moves_before else 0.0
            self._began_s[number], self._own_mps[number] = time_s, speed
            attack = self._members[number].attack
            if attack is not None:
                script = self._scripts[number] = self._search(number, attack, boxes, int(rows[number]))
        if self._ended[number]:
            return math.nan
        since = time_s - self._began_s[number]
        if script.follows_after and script.has_ended(since, speed, self._own_mps[number]):
            self._ended[number] = True
            return math.nan
        return script.order(speed, float(self._own_mps[number]))

    def _search(self, number: int, plan: AttackPlan, boxes: Float64, own_row: int) -> Script:
        member, (front, speed, _, aside, _) = self._members[number], self._state[number].tolist()
        attacker = Attacker(member.way, front, speed, aside, *member.agent.size_m[:2])
        ego, route = boxes[0], self._route
        start = self._on_route(ego)[0]

        def ego_line(times_s: Float64) -> Float64:
            # The route continues straight beyond its end.
            state = np.zeros((len(times_s), 5))
            state[:, 0], state[:, 1] = start + ego[4] + ego[3] * times_s, ego[3]
            first, zeros = np.array([0, len(route.points)]), np.zeros(len(times_s), np.int64)
            return poses_on_ways(route.points, first, zeros, np.full(len(times_s), 2.0 * ego[4]), state)[0]

        return search_attack(attacker, plan, boxes, own_row, ego_line=ego_line, is_drivable=self._is_drivable).script

    def _on_route(self, box: Float64) -> tuple[float, float]:
        """Length along the ego's route of the middle of a box, and the route's direction there."""
        points = self._route.points
        along, _, heading, _ = place_on_way(
            points, 0, len(points) - 1, 0.0, self._route.length_m, float(box[0]), float(box[1])
        )
        return along, heading

    def _time_to_collision(self, number: int, script: Script, boxes: Float64) -> float:
        ego = boxes[0]
        one = slice(number, number + 1)
        pose = poses_on_ways(
            self._points, self._ways.first, self._way[one], self._length[one], self._state[one]
        )[0][0]  # fmt: skip
        (ego_m, heading), (own_m, direction) = self._on_route(ego), self._on_route(pose)
        share = math.cos(pose[2] - direction)
        half = 0.5 * abs(share) * self._length[number] + abs(math.sin(pose[2] - direction)) * self._half_width[number]
        gap = own_m - (0.0 if script.is_line else half) - ego_m - ego[4]
        own_mps = 0.0 if script.stands else self._state[number, 1] * share
        closing = ego[3] * math.cos(ego[2] - heading) - own_mps
        return float(gap / closing) if closing > 0.0 and gap > 0.0 else math.inf

    def _states(self) -> AgentStates:
        poses, velocities = poses_on_ways(self._points, self._ways.first, self._way, self._length, self._state)
        return AgentStates(
            poses[:, 0],
            poses[:, 1],
            poses[:, 2],
            velocities[:, 0],
            velocities[:, 1],
            self._state[:, 0] - self._start_m,
            self._state[:, 0] - self._length < self._lengths[self._way] if len(self.agents) else np.zeros(0, np.bool_),
        )


def _users(agents: Sequence[WayAgent], way: Int64, length: Float64, seed: int) -> Users:
    manners = [member.manner or draw_manner(member.agent.category, member.agent.agent_id, seed) for member in agents]
    zeros = np.zeros(len(agents))

    def column(name: str) -> Float64:
        return np.array([getattr(manner, name) for manner in manners], np.float64)

    return Users(
        way, length, zeros, zeros, zeros + _BEYOND_M, column("eager"), column("fastest_mps"), column("pick_up_mps2"),
        column("brake_mps2"), column("headway_s"), column("phase"), zeros, zeros,
    )  # fmt: skip
