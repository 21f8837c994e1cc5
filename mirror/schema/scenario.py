"""Scenarios: who starts where, and what each agent does. A scenario is a TOML file.

The scenarios that come with the toolkit have names; `read_scenario` takes a name or the path of a file. What agents do
is in `mirror.schema.behaviours`.
"""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, ValidationError, model_validator

from mirror.errors import SchemaError, UsageError
from mirror.schema.behaviours import Behaviour, CrossingPedestrian, Idm, Replay, StoppedQueue
from mirror.schema.documents import Document, Identifier
from mirror.schema.files import write_bytes
from mirror.schema.problems import describe_problems
from mirror.schema.strict_toml import TomlError, decode_toml

SCENARIO_VERSION: Final = "1.0"
"""Version of the format of a scenario document."""

AgentCategory = Literal["car", "van", "truck", "bus", "motorcycle", "cyclist", "pedestrian"]
Turn = Literal["straight", "left", "right"]
Light = Literal["day", "dusk", "night"]
Weather = Literal["clear", "clouds", "rain"]


class LaneStart(Document):
    """The ego starts on a lane of the map, in its middle and along its direction.

    Attributes:
        kind: always ``lane``.
        lane: id of the lane; None: the simulator takes the driving lane with the longest way straight on.
        along_m: distance of the ego's rear axle from the beginning of the lane.
    """

    kind: Literal["lane"]
    lane: str | None = None
    along_m: float = Field(default=0.0, ge=0, allow_inf_nan=False)


class PoseStart(Document):
    """The ego starts at a pose in the scene's frame.

    Attributes:
        kind: always ``pose``.
        x_m: x of the rear axle.
        y_m: y of the rear axle.
        yaw_deg: heading, counter-clockwise from x.
    """

    kind: Literal["pose"]
    x_m: float = Field(allow_inf_nan=False)
    y_m: float = Field(allow_inf_nan=False)
    yaw_deg: float = Field(allow_inf_nan=False)


class RecordedStart(Document):
    """The ego starts at its recorded pose and with its recorded speed; ``ego.speed_mps`` is not used.

    Attributes:
        kind: always ``recorded``.
        traversal: id of the traversal; None: the first one of the scene, by id.
        after_s: time after the beginning of the traversal.
    """

    kind: Literal["recorded"]
    traversal: str | None = None
    after_s: float = Field(default=0.0, ge=0, allow_inf_nan=False)


Start = Annotated[LaneStart | PoseStart | RecordedStart, Field(discriminator="kind")]


class Route(Document):
    """The way that the ego is asked to take.

    Attributes:
        turns: the turn at each junction, in order; after the last one, straight on. Where a junction has no such way,
            the way with the smallest turn is taken.
        lanes: ids of the lanes of the route, in order; they replace ``turns``. The first one is that of the start.
    """

    turns: tuple[Turn, ...] = ()
    lanes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _one_kind(self) -> Route:
        if self.turns and self.lanes:
            raise ValueError("a route has either turns or lanes, not both")
        return self


class EgoPlan(Document):
    """The ego at the start, and its route.

    Attributes:
        start: where the ego starts.
        speed_mps: forward speed at the start.
        route: the way that it is asked to take.
    """

    start: Start = LaneStart(kind="lane")
    speed_mps: float = Field(default=0.0, ge=0, le=60)
    route: Route = Route()


class ScenarioAgent(Document):
    """An agent, or several that behave alike.

    Attributes:
        id: id in the state log. Several agents have the ids ``<id>-0``, ``<id>-1`` and so on; replayed agents have
            ``<id>-<track>``.
        category: category of the road user; replayed agents keep their recorded category.
        count: number of agents; only ``idm`` and ``stopped-queue`` have more than one.
        behaviour: what it does.
    """

    id: Identifier
    category: AgentCategory = "car"
    count: int = Field(default=1, ge=1, le=200)
    behaviour: Behaviour

    @model_validator(mode="after")
    def _countable(self) -> ScenarioAgent:
        if self.count > 1 and not isinstance(self.behaviour, Idm | StoppedQueue):
            raise ValueError(f"behaviour {self.behaviour.kind!r} describes one agent, not {self.count}")
        walks = isinstance(self.behaviour, CrossingPedestrian)
        if walks != (self.category == "pedestrian") and not isinstance(self.behaviour, Replay):
            raise ValueError(f"behaviour {self.behaviour.kind!r} does not fit the category {self.category!r}")
        return self


class Scenario(Document):
    """A scenario: the ego's start and route, light and weather, and the agents.

    Attributes:
        schema_version: version of the format of the document.
        name: name of the scenario.
        version: increased with every change that affects a rollout.
        description: description for readers.
        seed: seed of all random choices.
        duration_s: duration of a rollout.
        rate_hz: steps of a rollout in a second.
        light: light of the rendered images.
        weather: weather of the rendered images.
        ego: the ego's start and route.
        agents: the agents.
    """

    schema_version: Literal["1.0"] = SCENARIO_VERSION
    name: Identifier
    version: int = Field(default=1, ge=1)
    description: str = ""
    seed: int = Field(default=0, ge=0, lt=2**63)
    duration_s: float = Field(default=10.0, gt=0, le=3600)
    rate_hz: float = Field(default=10.0, gt=0, le=1000)
    light: Light = "day"
    weather: Weather = "clear"
    ego: EgoPlan = EgoPlan()
    agents: tuple[ScenarioAgent, ...] = ()

    @model_validator(mode="after")
    def _consistent(self) -> Scenario:
        names = [agent.id for agent in self.agents]
        repeated = next((name for name in names if names.count(name) > 1), None)
        if repeated is not None or "ego" in names:
            raise ValueError(f"the agent id {repeated or 'ego'!r} is taken")
        if round(self.duration_s * self.rate_hz) < 1:
            raise ValueError(f"{self.duration_s:g} s at {self.rate_hz:g} Hz is not even one step")
        return self

    @property
    def steps(self) -> int:
        """Number of steps of a rollout; its log has one stamp more."""
        return round(self.duration_s * self.rate_hz)


def scenario_names() -> list[str]:
    """List the names of the scenarios that come with the toolkit, sorted."""
    folder = files("mirror.schema").joinpath("scenarios")
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def read_scenario(path_or_name: str | Path) -> Scenario:
    """Read a scenario by its name, or from a path that ends in ``.toml``.

    Raises:
        UsageError: no scenario has that name, or the file cannot be read.
        SchemaError: the file is not TOML, or does not follow the schema; the message names the key.

    Example:
        >>> from mirror.schema.scenario import read_scenario
        >>> read_scenario("hard-brake").agents[0].behaviour.kind
        'hard-brake'
    """
    text = str(path_or_name)
    if text.endswith(".toml"):
        path = Path(text)
        try:
            return parse_scenario(path.read_bytes(), str(path))
        except OSError as error:
            raise UsageError(f"cannot be read: {error.strerror}", file=path, expected="a scenario's TOML") from error
    known = scenario_names()
    if text not in known:
        raise UsageError(
            f"no scenario {text!r}", expected=f"one of {', '.join(known)}, or the path of a scenario's .toml"
        )
    file = scenario_file(text)
    return parse_scenario(files("mirror.schema").joinpath("scenarios", file).read_bytes(), file)


def scenario_file(path_or_name: str | Path) -> str:
    """Return the file of a scenario for messages: the path, or the name with ``.toml``."""
    text = str(path_or_name)
    return text if text.endswith(".toml") else f"{text}.toml"


def parse_scenario(data: bytes, file: str) -> Scenario:
    """Parse the TOML of a scenario; ``file`` is used in messages.

    Raises:
        SchemaError: the data is not TOML, or does not follow the schema; the message names the key.
    """
    try:
        return Scenario.model_validate(decode_toml(data))
    except TomlError as error:
        raise SchemaError(f"not TOML ({error})", file=file, expected="a scenario") from error
    except ValidationError as error:
        problem, place = describe_problems(error.errors(), "the whole scenario")
        raise SchemaError(
            problem,
            file=file,
            place=place,
            expected="a scenario as docs/schema.md describes it",
        ) from error


def write_scenario(path: str | Path, scenario: Scenario) -> None:
    """Write a scenario as TOML, atomically; values that are None, the defaults, are left out.

    Raises:
        DatasetError: the file cannot be written.
    """
    write_bytes(Path(path), encode_scenario(scenario))


def encode_scenario(scenario: Scenario) -> bytes:
    """Encode a scenario as TOML; the same scenario gives the same bytes."""
    return ("\n".join(_toml_table(scenario.model_dump(mode="json", exclude_none=True), "")).strip() + "\n").encode()


def _toml_table(values: dict[str, Any], prefix: str) -> list[str]:
    """Lines of one table: first its own values, then its tables, then its arrays of tables."""
    lines = [f"{key} = {_toml_value(value)}" for key, value in values.items() if not _is_table(value)]
    for key, value in values.items():
        if isinstance(value, dict):
            lines += ["", f"[{prefix}{key}]", *_toml_table(value, f"{prefix}{key}.")]
    for key, value in values.items():
        if isinstance(value, list) and _is_table(value):
            for row in value:
                lines += ["", f"[[{prefix}{key}]]", *_toml_table(row, f"{prefix}{key}.")]
    return lines


def _is_table(value: object) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and bool(value) and isinstance(value[0], dict))


def _toml_value(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(_toml_value(item) for item in value)}]"
    # JSON's numbers, booleans and strings are TOML's, apart from DEL, which TOML wants escaped.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
