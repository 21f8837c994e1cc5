"""The policies: one controller, fed by a network, by the exact state, or by nothing."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmarks.studies.closed_loop.percepts import Percept, PerceptionNet, perceive, perceive_exactly
from hybridworldsim.simulator.ego.vehicle import Controls
from hybridworldsim.simulator.policies.protocol import Action, Observation, ObservationSpec
from mirror.errors import UsageError

_LEAST_GAP_M: Final = 0.1
_FREE_SHARE: Final = 0.95
"""A lead that seems farther away than this share of the sight is none."""


@dataclass(frozen=True)
class ControllerSettings:
    """Settings of the controller that all policies share; `experiment.toml` explains the numbers.

    Attributes:
        sight_m: the greatest distance of a lead.
    """

    cruise_mps: float
    lookahead_m: float
    headway_s: float
    standstill_m: float
    acceleration_mps2: float
    comfortable_mps2: float
    deceleration_mps2: float
    lane_share: float
    distance_share: float
    rate_share: float
    sight_m: float


class Controller:
    """Steers to the middle of the lane ahead, and keeps its distance: the intelligent driver model.

    It knows its own speed, and of the street only the percepts.
    """

    def __init__(self, settings: ControllerSettings, step_s: float) -> None:
        self._settings, self._step_s = settings, step_s
        self._lane: tuple[float, float] | None = None
        self._lead: tuple[float, float] | None = None

    def act(self, percept: Percept, speed_mps: float) -> Controls:
        """Return the controls of a step."""
        set_ = self._settings
        share = 1.0 if self._lane is None else set_.lane_share
        before = self._lane or (0.0, 0.0)
        offset, heading = (
            share * new + (1.0 - share) * old for new, old in zip((percept.offset_m, percept.heading_rad), before)
        )
        self._lane = offset, heading
        reach = set_.lookahead_m
        aside = reach * math.sin(heading) - offset
        curvature = 2.0 * aside / (reach * reach + aside * aside)
        free = set_.acceleration_mps2 * (1.0 - (speed_mps / set_.cruise_mps) ** 4)
        wish = min(max(free, -set_.comfortable_mps2), self._following(percept.lead_m, speed_mps))
        return Controls(max(wish, -set_.deceleration_mps2), curvature)

    def _following(self, lead_m: float, speed_mps: float) -> float:
        set_ = self._settings
        if lead_m >= _FREE_SHARE * set_.sight_m:
            self._lead = None
            return math.inf
        if self._lead is None:
            # The lead counts as standing until its motion is seen.
            self._lead = lead_m, -speed_mps
        else:
            gap, rate = self._lead
            foreseen = gap + rate * self._step_s
            surprise = lead_m - foreseen
            self._lead = foreseen + set_.distance_share * surprise, rate + set_.rate_share * surprise / self._step_s
        gap, rate = self._lead
        ease = 2.0 * math.sqrt(set_.acceleration_mps2 * set_.comfortable_mps2)
        desired = set_.standstill_m + max(speed_mps * set_.headway_s - speed_mps * rate / ease, 0.0)
        return set_.acceleration_mps2 * (1.0 - (desired / max(gap, _LEAST_GAP_M)) ** 2)


class NetworkPolicy:
    """The controller, fed by a network.

    Args:
        network: the trained perception.
        settings: the controller's.
        camera: name of the camera.
    """

    privileged = False

    def __init__(self, network: PerceptionNet, settings: ControllerSettings, camera: str) -> None:
        self.cameras: tuple[str, ...] = (camera,)
        self.percepts: list[Percept] = []
        self._network, self._settings = network, settings

    def reset(self, spec: ObservationSpec) -> None:
        """Forget earlier images."""
        self._controller, self.percepts = Controller(self._settings, spec.step_s), []

    def act(self, observation: Observation) -> Action:
        """Return the controls for an image."""
        image = observation.images[self.cameras[0]]
        self.percepts.append(Percept(*perceive(self._network, image[None], self._settings.sight_m)[0].tolist()))
        return self._controller.act(self.percepts[-1], observation.ego.speed_mps)

    def close(self) -> None:
        """Release nothing."""


class PrivilegedPolicy:
    """The controller, fed by the exact state. It asks for the image, and does not read it."""

    privileged = True

    def __init__(self, settings: ControllerSettings, camera: str) -> None:
        self.cameras: tuple[str, ...] = (camera,)
        self.percepts: list[Percept] = []
        self._settings = settings

    def reset(self, spec: ObservationSpec) -> None:
        """Forget earlier states."""
        self._spec, self.percepts = spec, []
        self._controller = Controller(self._settings, spec.step_s)

    def act(self, observation: Observation) -> Action:
        """Return the controls for the exact state.

        Raises:
            UsageError: the observation has no exact state.
        """
        self.percepts.append(exact_percept(observation, self._spec, self._settings))
        return self._controller.act(self.percepts[-1], observation.ego.speed_mps)

    def close(self) -> None:
        """Release nothing."""


class BlindPolicy(PrivilegedPolicy):
    """The controller in the middle of an empty, straight lane. It asks for the image, and does not read it."""

    privileged = False

    def act(self, observation: Observation) -> Action:
        """Return the controls for an empty lane."""
        self.percepts.append(Percept(0.0, 0.0, self._settings.sight_m))
        return self._controller.act(self.percepts[-1], observation.ego.speed_mps)


StudyPolicy = NetworkPolicy | PrivilegedPolicy
REFERENCES: Final[Mapping[str, type[PrivilegedPolicy]]] = {"blind": BlindPolicy, "privileged": PrivilegedPolicy}


def exact_percept(observation: Observation, spec: ObservationSpec, settings: ControllerSettings) -> Percept:
    """Return the percept of an observation's exact state.

    Raises:
        UsageError: the observation has none.
    """
    state = observation.privileged
    if state is None:
        raise UsageError("the percept needs the exact state", expected="an observation with `privileged`")
    return perceive_exactly(
        np.asarray(state.route_m), state.ego, state.boxes, spec.vehicle, settings.lookahead_m, settings.sight_m
    )
