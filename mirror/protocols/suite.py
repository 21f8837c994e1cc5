"""Suites of closed-loop drives: the streets, scenarios and starts of a protocol, and the drives that follow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field, model_validator

from mirror.schema.documents import Document, Identifier
from mirror.schema.scenario import LaneStart, Light, Scenario, Weather, read_scenario


class SuiteStreet(Document):
    """A street of a suite.

    Attributes:
        source: name of a synthetic street, ``synth:PRESET:SEED:DRIVE``.
        scene: its scene.
    """

    source: Annotated[str, Field(pattern=r"^synth:[a-z0-9-]+:[0-9]+:[a-z0-9-]+$")]
    scene: Identifier


class SuiteStart(Document):
    """A start of the ego, in each scenario on each street.

    Attributes:
        seed: seed of the drive, which names it.
        along_m: distance from the beginning of the lane.
        speed_mps: speed at the start.
        light: light of the images.
        weather: weather of the images.
    """

    seed: int = Field(ge=0)
    along_m: float = Field(ge=0)
    speed_mps: float = Field(gt=0, le=60)
    light: Light = "day"
    weather: Weather = "clear"


class Suite(Document):
    """The drives of a protocol: every scenario, from every start, on every street.

    Attributes:
        renderer: what renders the images.
        rate_hz: steps in a second.
        duration_s: duration of a drive.
        cameras: cameras that a policy may ask for.
        width_px: width of their images.
        deadline_s: longest time that a policy may take for an action.
        failed: PDMS and EPDMS of a drive that the policy ends, by an error or past the deadline.
        scenarios: names of scenarios that come with the toolkit.
        streets: the streets; each has a scene of its own.
        starts: the starts; each has a seed of its own.
    """

    renderer: Literal["boxes", "exact"]
    rate_hz: float = Field(gt=0, le=100)
    duration_s: float = Field(gt=0, le=3600)
    cameras: tuple[str, ...] = ()
    width_px: int = Field(default=240, ge=16, le=4096)
    deadline_s: float = Field(gt=0, le=3600)
    failed: float = Field(default=0.0, ge=0, le=1)
    scenarios: tuple[Identifier, ...] = Field(min_length=1)
    streets: tuple[SuiteStreet, ...] = Field(min_length=1)
    starts: tuple[SuiteStart, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _distinct(self) -> Suite:
        for what, names in (
            ("scenario", list(self.scenarios)),
            ("scene", [street.scene for street in self.streets]),
            ("seed", [start.seed for start in self.starts]),
        ):
            if len(set(names)) < len(names):
                raise ValueError(f"the suite has a {what} twice")
        return self


@dataclass(frozen=True)
class SuiteDrive:
    """A drive of a suite.

    Attributes:
        street: its street.
        scenario: its scenario, with the start and the seed.
    """

    street: SuiteStreet
    scenario: Scenario

    @property
    def key(self) -> tuple[str, str, int]:
        """Scene, scenario and seed, which identify it."""
        return self.street.scene, self.scenario.name, self.scenario.seed

    @property
    def folder(self) -> str:
        """Folder of its rollout, relative to that of the suite."""
        return f"{self.street.scene}/{self.scenario.name}-{self.scenario.seed}"


def list_drives(suite: Suite) -> list[SuiteDrive]:
    """List the drives of a suite by street, scenario and start.

    Raises:
        UsageError: no scenario has one of the names.
    """
    return [
        SuiteDrive(street, _make_scenario(suite, name, start))
        for street in suite.streets
        for name in suite.scenarios
        for start in suite.starts
    ]


def _make_scenario(suite: Suite, name: str, start: SuiteStart) -> Scenario:
    scenario = read_scenario(name)
    ego = scenario.ego.model_copy(
        update={"start": LaneStart(kind="lane", along_m=start.along_m), "speed_mps": start.speed_mps}
    )
    return scenario.model_copy(
        update={
            "seed": start.seed,
            "duration_s": suite.duration_s,
            "rate_hz": suite.rate_hz,
            "light": start.light,
            "weather": start.weather,
            "ego": ego,
        }
    )
