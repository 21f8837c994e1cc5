"""Suites of closed-loop drives: the streets, scenarios and starts of a protocol, and the drives that follow."""

from __future__ import annotations

import hashlib
import hmac
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, ValidationError, model_validator

from mirror.errors import UsageError
from mirror.protocols.sensor_faults import SensorFault
from mirror.schema.documents import Document, Identifier
from mirror.schema.problems import describe_problems
from mirror.schema.scenario import LaneStart, Light, Scenario, Weather, read_scenario

_DRAWN: Final = ("ahead_m", "speed_mps", "ttc_s", "latest_s")
"""Parameters of behaviours that a suite draws."""
_LEAST_SECRET: Final = 32
_MOST_SECRET: Final = 4096
_DECIMALS: Final = 3


class SuiteStreet(Document):
    """A street of a suite.

    Attributes:
        source: name of a synthetic street, ``synth:PRESET:SEED:DRIVE``.
        scene: its scene, to which ``-WORD`` may be added: streets of one scene and several seeds differ by it.
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
        sensors: name of the fault of the sensors; None: they have none. The hash omits None.
    """

    seed: int = Field(ge=0)
    along_m: float = Field(ge=0)
    speed_mps: float = Field(gt=0, le=60)
    light: Light = "day"
    weather: Weather = "clear"
    sensors: Identifier | None = Field(default=None, exclude_if=lambda name: name is None)


class SuiteDraw(Document):
    """The draws by which each drive varies the parameters of its scenario, from a public seed or from a secret.

    Distances, speeds and times of the agents are multiplied by 1 + ``spread`` u, each with its own u of -1 to 1; the
    start lies up to ``along_m`` farther, and its speed is multiplied by 1 + ``speed_share`` u. A draw is the
    HMAC-SHA-256 of the names of street, scenario, seed and parameter under the key, so that no draw tells another one.

    Attributes:
        seed: public seed; None: the draws are secret.
        commitment: SHA-256 of the secret of an organiser, in which white space at its end does not count; None: the
            seed is public.
        spread: greatest relative change of the agents' parameters.
        along_m: greatest distance that a start is moved forward.
        speed_share: greatest relative change of the ego's speed.
    """

    seed: int | None = Field(default=None, ge=0, exclude_if=lambda seed: seed is None)
    commitment: str | None = Field(
        default=None, pattern="^[0-9a-f]{64}$", exclude_if=lambda commitment: commitment is None
    )
    spread: float = Field(ge=0, le=0.5)
    along_m: float = Field(default=0.0, ge=0, le=100)
    speed_share: float = Field(default=0.0, ge=0, le=0.5)

    @model_validator(mode="after")
    def _one_key(self) -> SuiteDraw:
        if (self.seed is None) == (self.commitment is None):
            raise ValueError("draws have either a public seed or the commitment to a secret")
        return self


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
        ends_off_road: whether a drive ends where the whole body of the ego is off the drivable area. The hash omits
            False.
        draw: how drives vary the parameters of scenarios; None: not at all. The hash omits None.
        sensors: faults of sensors that starts name. The hash omits an empty list.
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
    ends_off_road: bool = Field(default=False, exclude_if=lambda ends: not ends)
    draw: SuiteDraw | None = Field(default=None, exclude_if=lambda draw: draw is None)
    sensors: tuple[SensorFault, ...] = Field(default=(), exclude_if=lambda sensors: not sensors)
    scenarios: tuple[Identifier, ...] = Field(min_length=1)
    streets: tuple[SuiteStreet, ...] = Field(min_length=1)
    starts: tuple[SuiteStart, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _distinct(self) -> Suite:
        faults = [fault.name for fault in self.sensors]
        for what, names in (
            ("scenario", list(self.scenarios)),
            ("scene", [street.scene for street in self.streets]),
            ("seed", [start.seed for start in self.starts]),
            ("fault of sensors", faults),
        ):
            if len(set(names)) < len(names):
                raise ValueError(f"the suite has a {what} twice")
        unknown = [start.sensors for start in self.starts if start.sensors not in (None, *faults)]
        if unknown:
            raise ValueError(f"a start names the fault of sensors {unknown[0]!r}, which the suite does not have")
        lost = [camera for fault in self.sensors for camera in fault.dropped if camera not in self.cameras]
        if lost:
            raise ValueError(f"a fault drops the camera {lost[0]!r}, which the suite does not have")
        return self

    @property
    def is_secret(self) -> bool:
        """Return whether the drives follow from the secret of an organiser."""
        return self.draw is not None and self.draw.commitment is not None


@dataclass(frozen=True)
class SuiteDrive:
    """A drive of a suite.

    Attributes:
        street: its street.
        scenario: its scenario, with the start and the seed.
        sensors: the fault of its sensors; None: they have none.
    """

    street: SuiteStreet
    scenario: Scenario
    sensors: SensorFault | None = None

    @property
    def key(self) -> tuple[str, str, int]:
        """Scene, scenario and seed, which identify it."""
        return self.street.scene, self.scenario.name, self.scenario.seed

    @property
    def folder(self) -> str:
        """Folder of its rollout, relative to that of the suite."""
        return f"{self.street.scene}/{self.scenario.name}-{self.scenario.seed}"


def read_secret(path: Path | None, suite: Suite, name: str) -> bytes | None:
    """Read the secret of a suite from the organiser's file, and compare it with the suite's commitment.

    Args:
        path: the file; None: there is none.
        suite: the suite.
        name: its name, for messages.

    Returns:
        The secret; None for a suite without one.

    Raises:
        UsageError: the suite has a secret and there is no file, or the reverse, or the file holds another secret. No
            message shows the secret.
    """
    commitment = None if suite.draw is None else suite.draw.commitment
    if commitment is None:
        if path is not None:
            raise UsageError(
                f"the suite {name} has no secret", place="--secret", expected="a suite with a commitment",
                remedy="leave --secret out",
            )  # fmt: skip
        return None
    if path is None:
        raise UsageError(
            f"the drives of the suite {name} follow from the organiser's secret", place="--secret",
            expected="the file of the secret, which the organiser alone has",
            remedy="practise with the suite closed-loop, and send the policy to the organiser",
        )  # fmt: skip
    try:
        with path.open("rb") as file:
            secret = file.read(_MOST_SECRET + 1).rstrip()
    except OSError as error:
        raise UsageError(f"cannot be read: {error.strerror}", file=path, place="--secret") from error
    if not _LEAST_SECRET <= len(secret) <= _MOST_SECRET or hashlib.sha256(secret).hexdigest() != commitment:
        raise UsageError(
            "not the secret that the suite is committed to", file=path, place="--secret",
            expected=f"{_LEAST_SECRET} or more bytes with the SHA-256 {commitment}",
        )  # fmt: skip
    return secret


def list_drives(suite: Suite, secret: bytes | None = None) -> list[SuiteDrive]:
    """List the drives of a suite by street, light of the start, scenario and start.

    Args:
        suite: the suite.
        secret: the organiser's secret, from `read_secret`; None: the suite has none.

    Raises:
        UsageError: no scenario has one of the names, a draw leaves the range of a parameter, or there is no secret.
    """
    if suite.is_secret and secret is None:
        raise UsageError(
            "the drives of this suite follow from the organiser's secret", place="--secret",
            expected="the file of the secret",
        )  # fmt: skip
    faults = {fault.name: fault for fault in suite.sensors}
    scenarios = {name: read_scenario(name) for name in suite.scenarios}
    # Renderers keep the street in one light.
    starts = sorted(suite.starts, key=lambda start: (start.light, start.weather))
    return [
        SuiteDrive(
            street,
            _make_scenario(suite, scenarios[name], street, start, secret),
            None if start.sensors is None else faults[start.sensors],
        )
        for street in suite.streets
        for light in dict.fromkeys((start.light, start.weather) for start in starts)
        for name in suite.scenarios
        for start in starts
        if (start.light, start.weather) == light
    ]


def _make_scenario(
    suite: Suite, scenario: Scenario, street: SuiteStreet, start: SuiteStart, secret: bytes | None
) -> Scenario:
    document = scenario.model_dump(mode="json", exclude_none=True)
    document |= {
        "seed": start.seed, "duration_s": suite.duration_s, "rate_hz": suite.rate_hz, "light": start.light,
        "weather": start.weather,
    }  # fmt: skip
    along_m, speed_mps = start.along_m, start.speed_mps
    if suite.draw is not None:
        draw = _Draws(suite.draw, secret, f"{street.scene}/{scenario.name}/{start.seed}")
        along_m = round(along_m + 0.5 * (draw("along_m") + 1.0) * suite.draw.along_m, _DECIMALS)
        speed_mps = round(speed_mps * (1.0 + draw("speed_mps") * suite.draw.speed_share), _DECIMALS)
        for agent in document["agents"]:
            behaviour = agent["behaviour"]
            _vary(behaviour, suite.draw.spread, draw, agent["id"])
            _vary(behaviour.get("trigger", {}), suite.draw.spread, draw, f"{agent['id']}/trigger")
    document["ego"] |= {"start": LaneStart(kind="lane", along_m=along_m).model_dump(), "speed_mps": speed_mps}
    try:
        return Scenario.model_validate(document)
    except ValidationError as error:
        problem, place = describe_problems(error.errors(), "the whole scenario")
        raise UsageError(
            f"a draw leaves the range of scenario {scenario.name}: {problem}", place=place,
            expected="a smaller suite.draw.spread",
        ) from error  # fmt: skip


class _Draws:
    def __init__(self, draw: SuiteDraw, secret: bytes | None, drive: str) -> None:
        self._key = f"mirror-suite-{draw.seed}".encode() if secret is None else secret
        self._drive = drive

    def __call__(self, name: str) -> float:
        """Return a number from -1 to 1."""
        digest = hmac.digest(self._key, f"{self._drive}/{name}".encode(), "sha256")
        return math.ldexp(int.from_bytes(digest[:6], "big"), -47) - 1.0


def _vary(table: dict[str, Any], spread: float, draw: _Draws, place: str) -> None:
    for name in _DRAWN:
        if name in table:
            table[name] = round(table[name] * (1.0 + spread * draw(f"{place}/{name}")), _DECIMALS)
