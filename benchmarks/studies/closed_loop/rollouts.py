"""One rollout of a policy: its verdicts, and how far what it perceived was from the exact state."""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmarks.studies.closed_loop.driving import ControllerSettings, StudyPolicy, exact_percept
from benchmarks.studies.closed_loop.percepts import Percept
from benchmarks.studies.closed_loop.streets import Place
from benchmarks.studies.closed_loop.worlds import World
from hybridworldsim.simulator.simulation import start_simulation
from mirror.arrays import UInt8
from mirror.metrics.safety import StateLog
from mirror.metrics.safety.report import score_rollout
from mirror.schema.scenario import Scenario

Row = dict[str, Any]
_LEAD_SHARE: Final = 0.95
_DIGITS: Final = 4


@dataclass(frozen=True, eq=False)
class Drive:
    """The result of one rollout: its record, its log and its images.

    Attributes:
        row: verdicts and errors, as they are recorded.
        log: the states.
        images: the images, if they were asked for.
        seconds: processor time by part.
    """

    row: Row
    log: StateLog
    images: list[UInt8]
    seconds: dict[str, float]


def drive(
    policy: StudyPolicy,
    scenario: Scenario,
    place: Place,
    world: World,
    settings: ControllerSettings,
    horizon_s: float,
    *,
    keep_images: bool = False,
) -> Drive:
    """Drive a scenario.

    Args:
        policy: the policy.
        scenario: the scenario.
        place: its street.
        world: the world that renders the images.
        settings: the controller's.
        horizon_s: the least time to collision is at most this.
        keep_images: keep the images.
    """
    clock = _Clock()
    simulation = start_simulation(place.street, scenario)
    spec = simulation.observation_spec(place.cameras)
    clock.add("simulation")
    renderer = world.renderer(simulation, place)
    clock.add("preparation")
    policy.reset(spec)
    exact: list[Percept] = []
    images: list[UInt8] = []
    ending = None
    while ending is None:
        shown = renderer.render(simulation.now, policy.cameras)
        clock.add("images")
        if keep_images:
            images += shown.values()
        observation = simulation.observe(shown, privileged=True)
        exact.append(exact_percept(observation, spec, settings))
        clock.add("simulation")
        if not policy.privileged:
            observation = simulation.observe(shown)
        action = policy.act(observation)
        clock.add("policy")
        ending = simulation.advance(action)
        clock.add("simulation")
    log = simulation.recorder.log()
    reference_m = settings.cruise_mps * scenario.duration_s
    report = score_rollout(
        log, place.street.road_map, simulation.route.way.points, reference_m=reference_m, horizon_s=horizon_s
    )
    clock.add("scoring")
    figures = {name: figure.value for name, figure in report.figures.items()}
    row: Row = {
        # A collision in the first steps leaves too few stamps for the comfort, but PDMS is 0 with it whatever that is.
        "score": figures["pdms"] if report.figures["pdms"].is_valid or ending != "collision" else 0.0,
        "collision": bool(figures["collisions"] > 0.0),
        "off_road": bool(figures["drivable_area"] < 1.0),
        "least_ttc_s": min(figures["least_ttc"], horizon_s),
        "margin_m": figures["drivable_margin"],
        "progress_m": figures["progress"],
        "ending": ending,
        "steps": simulation.now.step,
        **_perception_errors(policy.percepts, exact, settings.sight_m),
        "log": log_hash(log),
        "core_s": sum(clock.seconds.values()),
    }
    rounded = {name: round(value, _DIGITS) if isinstance(value, float) else value for name, value in row.items()}
    return Drive(rounded, log, images, clock.seconds)


def log_hash(log: StateLog) -> str:
    """Return the first digits of the SHA-256 of all states: equal if the logs are equal to the bit."""
    digest = hashlib.sha256(repr((log.ids, log.stamps_ns.shape)).encode())
    for name in ("stamps_ns", "x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps", "present"):
        digest.update(np.ascontiguousarray(getattr(log, name)).tobytes())
    return digest.hexdigest()[:16]


def _perception_errors(found: list[Percept], exact: list[Percept], sight_m: float) -> Row:
    """Mean offset perceived less exact, and its mean magnitude; the lead's distance where there is a lead."""
    offset = np.array([a.offset_m - b.offset_m for a, b in zip(found, exact)])
    lead = np.array([a.lead_m - b.lead_m for a, b in zip(found, exact) if b.lead_m < _LEAD_SHARE * sight_m])
    row: Row = {"offset_bias_m": float(offset.mean()), "offset_error_m": float(np.abs(offset).mean())}
    return row | {
        "lead_bias_m": float(lead.mean()) if len(lead) else None,
        "lead_error_m": float(np.abs(lead).mean()) if len(lead) else None,
        "leads": len(lead),
    }


class _Clock:
    """Processor time by part."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.process_time()

    def add(self, part: str) -> None:
        """Add the time since the last call to a part."""
        now = time.process_time()
        self.seconds[part] = self.seconds.get(part, 0.0) + now - self._last
        self._last = now
