"""An earlier rollout that another one repeats, or from an instant of which another policy drives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hybridworldsim.simulator.ego.vehicle import Controls
from hybridworldsim.simulator.rollout.actions import ACTIONS_FILE, read_actions
from mirror.errors import UsageError
from mirror.schema.rollout import BY_POLICY, SCENARIO_FILE, Rollout, read_rollout
from mirror.schema.scenario import Scenario, read_scenario

_GOES_ON: Final = ("duration", "interrupted", *BY_POLICY)
"""Endings after which the drive could have gone on."""


@dataclass(frozen=True, eq=False)
class EarlierDrive:
    """A complete rollout with its controls.

    Attributes:
        folder: its folder.
        rollout: its document.
        scenario: its scenario.
        controls: the controls of each step.
    """

    folder: Path
    rollout: Rollout
    scenario: Scenario
    controls: tuple[Controls, ...]

    @classmethod
    def read(cls, folder: Path) -> EarlierDrive:
        """Read a rollout.

        Raises:
            DatasetError: the folder holds no complete rollout, or the controls are missing or broken.
        """
        rollout = read_rollout(folder)
        return cls(folder, rollout, read_scenario(str(folder / SCENARIO_FILE)), read_actions(folder / ACTIONS_FILE))

    @property
    def driven_scenario(self) -> Scenario:
        """The scenario, as long as it was driven: a rollout that its policy ended has as many steps as controls."""
        steps = max(self.rollout.steps, 1)
        return self.scenario.model_copy(update={"duration_s": steps / self.scenario.rate_hz})

    def controls_until(self, at_s: float, scenario: Scenario) -> Sequence[Controls]:
        """Return the controls of the steps before an instant.

        Args:
            at_s: seconds after the start.
            scenario: the scenario of the drive that goes on from there.

        Raises:
            UsageError: it is no instant of the rollout, or nothing is left to be driven after it.
        """
        rate, driven = scenario.rate_hz, len(self.controls)
        step = round(at_s * rate)
        ends = self.rollout.ending not in _GOES_ON
        last = min(driven - ends, scenario.steps - 1)
        if abs(step - at_s * rate) > 1e-6 * rate or not 1 <= step <= last:
            ended = f"{self.folder} ended after {driven / rate:g} s ({self.rollout.ending.replace('_', ' ')})"
            raise UsageError(
                f"{at_s:g} s is no instant from which it can go on: {ended}", place="--at",
                expected=f"a multiple of its step, {1.0 / rate:g} s, up to {max(last, 0) / rate:g} s",
            )  # fmt: skip
        return self.controls[:step]

    def require_renderer(self, name: str, model_hash: str | None) -> None:
        """Require that images are those of the rollout: its renderer and its model.

        Raises:
            UsageError: the renderer or the model is another one.
        """
        if name != self.rollout.world:
            raise UsageError(
                f"the drive of {self.folder} has images by {self.rollout.world!r}, not {name!r}", place="--renderer",
                expected=f"--renderer {self.rollout.world}",
            )  # fmt: skip
        if model_hash != self.rollout.model_hash:
            raise UsageError(
                f"the drive of {self.folder} has images of another model", place="MODEL",
                expected="the model that the drive was made with",
            )  # fmt: skip
