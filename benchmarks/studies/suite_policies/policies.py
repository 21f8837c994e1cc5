"""Twelve analytic policies of spread skill: the lane keeper with less, or with more, of what it sees.

Each class drives by the exact state, so that no image is rendered. ``--policy
benchmarks/studies/suite_policies/policies.py:Anticipating`` drives one of them.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Final

import numpy as np

from hybridworldsim.simulator.ego.vehicle import Controls
from hybridworldsim.simulator.policies.protocol import Observation, ObservationSpec, PrivilegedState
from hybridworldsim.simulator.policies.references import LaneKeeping
from mirror.arrays import Float64
from mirror.errors import UsageError


class _Altered(LaneKeeping):
    """The lane keeper, which gets another state than the exact one.

    Attributes:
        sight_m: road users that are farther away are not seen.
        delay_steps: age of the seen road users.
        pace_share: desired speed as a share of what the route allows.
        foresight_s: road users are also seen where they would be up to this time from now.
        heeds_signals: whether it stops at closed stop lines.
        throttle: greatest acceleration.
        sway_radpm: amplitude of a slow swaying of its curvature.
    """

    sight_m = 100.0
    delay_steps = 0
    pace_share = 1.0
    foresight_s = 0.0
    heeds_signals = True
    throttle = 10.0
    sway_radpm = 0.0

    def reset(self, spec: ObservationSpec) -> None:
        """Forget what was seen."""
        super().reset(spec)
        self._seen: deque[Float64] = deque(maxlen=self.delay_steps + 1)
        self._steps = 0

    def act(self, observation: Observation) -> Controls:
        """Return the controls of the lane keeper in the altered state."""
        state = observation.privileged
        if state is None:
            raise UsageError("the policy needs the exact state", expected="an observation with `privileged`")
        self._seen.append(state.boxes[1:])
        altered = replace(
            state,
            boxes=np.concatenate([state.boxes[:1], self._look(state, self._seen[0])]),
            route_pace_mps=self.pace_share * state.route_pace_mps,
            stop_m=state.stop_m if self.heeds_signals else np.inf,
        )
        action = super().act(replace(observation, privileged=altered))
        self._steps += 1
        sway = self.sway_radpm * float(np.sin(0.4 * self._steps))
        return Controls(min(action.acceleration_mps2, self.throttle), action.curvature_radpm + sway)

    def _look(self, state: PrivilegedState, boxes: Float64) -> Float64:
        near = np.hypot(boxes[:, 0] - state.ego.x_m, boxes[:, 1] - state.ego.y_m) <= self.sight_m
        seen = [boxes[near]]
        for ahead_s in np.arange(0.4, self.foresight_s + 1e-9, 0.4):
            moved = boxes[near].copy()
            moved[:, 0] += ahead_s * moved[:, 3] * np.cos(moved[:, 2])
            moved[:, 1] += ahead_s * moved[:, 3] * np.sin(moved[:, 2])
            # Whoever drives the same way is seen where it is: it makes room as it moves.
            across = np.abs(np.sin(moved[:, 2] - state.ego.yaw_rad)) > 0.3
            seen.append(moved[across])
        return np.concatenate(seen)


class Keeping(_Altered):
    """The lane keeper itself."""


class Anticipating(_Altered):
    """A policy that sees where crossing road users will be: deliberately high."""

    foresight_s = 2.0


class Cautious(_Altered):
    """A policy that anticipates, and keeps to nine tenths of the speed: deliberately high."""

    foresight_s = 2.8
    pace_share = 0.9


class Smooth(_Altered):
    """A policy that anticipates a little, and accelerates gently: deliberately high."""

    foresight_s = 1.2
    throttle = 1.0


class Slow(_Altered):
    """A policy at six tenths of the speed."""

    pace_share = 0.6


class Hasty(_Altered):
    """A policy at five quarters of the speed."""

    pace_share = 1.25


class Shortsighted(_Altered):
    """A policy that sees as far as twelve metres."""

    sight_m = 12.0


class Delayed(_Altered):
    """A policy that sees road users as they were a second ago."""

    delay_steps = 5


class Swaying(_Altered):
    """A policy that sways in its lane."""

    sway_radpm = 0.02


class Blind(_Altered):
    """A policy that follows its route and sees no road user: deliberately low."""

    sight_m = 0.0


class BlindHasty(_Altered):
    """A policy that sees neither road users nor signals, at five quarters of the speed: deliberately low."""

    sight_m = 0.0
    heeds_signals = False
    pace_share = 1.25


class Straying(_Altered):
    """A policy that sways out of its lane, and is shortsighted: deliberately low."""

    sight_m = 8.0
    sway_radpm = 0.08


POLICIES: Final = (
    Anticipating, Cautious, Smooth, Keeping, Slow, Hasty, Shortsighted, Delayed, Swaying, Blind, BlindHasty, Straying
)  # fmt: skip
"""All twelve."""
