"""Scores rollouts again, and drives their recorded controls again on the organiser's streets and scenarios."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from mirror.errors import DatasetError, UsageError
from mirror.evaluation.result import Result
from mirror.evaluation.rollouts import evaluate_rollouts, make_result
from mirror.evaluation.scorers.safety import ScoredRollout, score_drive
from mirror.metrics.safety import StateLog, find_difference, find_impossible_motion, read_state_log
from mirror.metrics.safety.driving_score import LEAST_REFERENCE_M
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.document import Protocol
from mirror.protocols.suite import list_drives
from mirror.schema.documents import FileEntry
from mirror.schema.files import sha256_bytes
from mirror.schema.road_map import encode_road_map
from mirror.schema.rollout import BY_POLICY, MAP_FILE, ROLLOUT, SCENARIO_FILE, STATES_FILE, Rollout
from mirror.schema.scenario import Scenario, encode_scenario, read_scenario
from mirror_leaderboard.refused import RefusedError
from mirror_leaderboard.rescore import RolloutPlan, SuitePlan, require_equal, require_equal_figures

if TYPE_CHECKING:
    from hybridworldsim.simulator.ego.vehicle import Controls
    from hybridworldsim.simulator.street.street import Street

_STATED: Final = ("scenario_version", "rate_hz", "steps", "ending", "map_source")
"""Keys of a rollout's document that follow from the drive."""
EVENTS: Final = (
    "collisions",
    "at_fault_collisions",
    "red_lights",
    "drivable_area",
    "ttc_nuplan_within_bound",
    "ttc_navsim_within_bound",
    "comfort",
)
"""Figures that count, or that hold or do not: both drives must have the same."""
_ROUTE_M: Final = 1e-6
_DRIVE: Final = "drive each scenario of --scenarios in each of --street: mirror simulate STREET --scenario FILE.toml"
_UNVERIFIED: Final = "leave --street and --scenarios out: the row is then unverified"


@dataclass(frozen=True, eq=False)
class AskedDrive:
    """One drive that an organiser asked for.

    Attributes:
        street: the street.
        dataset_hash: hash of its dataset; None: it is synthetic.
        map_hash: hash of its encoded map.
        scenario: the scenario with its seed.
        ends_off_road: whether it ends where the whole body of the ego is off the drivable area.
    """

    street: Street
    dataset_hash: str | None
    map_hash: str
    scenario: Scenario
    ends_off_road: bool = False


def rescore_rollouts(
    result: Result,
    path: Path,
    rollouts: Path,
    plan: RolloutPlan | SuitePlan | None = None,
    progress: ProgressReporter | None = None,
    *,
    secret: bytes | None = None,
) -> Result:
    """Score rollouts again from their state logs, and return the new result if it equals the given one.

    With a plan, the recorded controls are driven again on the streets and scenarios that it names, and the figures are
    those of these drives.

    Args:
        result: the given result.
        path: its file, for messages.
        rollouts: folder of the rollouts.
        plan: what was asked for; None: maps, scenarios, seeds, routes and states are the participant's.
        progress: receives the progress.
        secret: the organiser's secret of the suite; None: it has none.

    Raises:
        RefusedError: a figure or a warning differs, a log has a motion that no body can make, or a rollout is not what
            its controls lead to in the plan.
        UsageError: there is no rollout in the folder, or a street or a scenario of the plan is wrong.
        DatasetError: a rollout is incomplete or was changed.
    """
    with tempfile.TemporaryDirectory(prefix="mirror-rescore-") as folder:
        evaluation = evaluate_rollouts(rollouts, result.protocol, Path(folder) / "results", progress, secret=secret)
    done = evaluation.result
    require_equal("submission_hash", result.submission_hash, done.submission_hash, path)
    require_equal("dataset", result.dataset, done.dataset, path)
    require_equal("submission.method", result.submission.method, done.submission.method, path)
    require_equal("options", result.options, done.options, path)
    require_equal("warnings", result.warnings, done.warnings, path)
    require_equal_figures(result.figures, done.figures, path)
    if plan is None:
        for one in evaluation.scored:
            _read_possible(rollouts / one.path)
        return done
    asked = _list_suite_tasks(result.protocol, secret) if isinstance(plan, SuitePlan) else _list_tasks(plan)
    return _drive_again(done, rollouts, evaluation.scored, asked, progress or NullProgress())


def _read_possible(folder: Path) -> StateLog:
    log = read_state_log(folder / STATES_FILE)
    found = find_impossible_motion(log)
    if found is not None:
        raise RefusedError(
            found.problem,
            file=folder / STATES_FILE,
            place=f"actor {found.actor!r}, {(found.stamp_ns - int(log.stamps_ns[0])) * 1e-9:.2f} s after the start",
            expected="states that bodies can have one after the other (docs/safety.md)",
        )
    return log


def _drive_again(
    done: Result,
    rollouts: Path,
    scored: Sequence[ScoredRollout],
    asked: Iterable[AskedDrive],
    progress: ProgressReporter,
) -> Result:
    tasks = {_key(task.street.scene_id, task.scenario): task for task in asked}
    given = {(one.rollout.scene_id, one.rollout.scenario, one.rollout.seed): one for one in scored}
    for key in sorted(given.keys() - tasks.keys()):
        raise RefusedError(f"{_describe(key)} was not asked for", file=rollouts / given[key].path, remedy=_DRIVE)
    for key in sorted(tasks.keys() - given.keys()):
        raise RefusedError(
            f"{_describe(key)} is missing", file=rollouts, expected="one rollout of each drive", remedy=_DRIVE
        )
    progress.start("driving again", len(scored))
    again = []
    for key, one in given.items():
        again.append(check_rollout(rollouts / one.path, one, tasks[key], done.protocol))
        progress.advance(1)
    own = make_result(again, done.protocol)
    kept = ("figures", "clusters", "dataset", "options", "warnings")
    return done.model_copy(update={name: getattr(own, name) for name in kept})


def _key(scene_id: str, scenario: Scenario) -> tuple[str, str, int]:
    return scene_id, scenario.name, scenario.seed


def _describe(key: tuple[str, str, int]) -> str:
    return f"scenario {key[1]} with seed {key[2]} in scene {key[0]}"


def _list_suite_tasks(protocol: Protocol, secret: bytes | None) -> Iterator[AskedDrive]:
    from hybridworldsim.simulator.suite import open_suite_street, require_suite

    suite = require_suite(protocol)
    held: tuple[Street, str] | None = None
    for drive in list_drives(suite, secret):
        if held is None or held[0].scene_id != drive.street.scene:
            street = open_suite_street(drive.street)
            held = street, sha256_bytes(encode_road_map(street.road_map))
        yield AskedDrive(held[0], None, held[1], drive.scenario, suite.ends_off_road)


def _list_tasks(plan: RolloutPlan) -> Iterator[AskedDrive]:
    if not plan.scenarios.is_dir():
        raise UsageError("no such folder", file=plan.scenarios, place="--scenarios", expected="a folder of scenarios")
    files = sorted(plan.scenarios.glob("*.toml"))
    if not files:
        raise UsageError("has no .toml file", file=plan.scenarios, place="--scenarios", expected="scenarios")
    scenarios: dict[tuple[str, int], Scenario] = {}
    for file in files:
        scenario = read_scenario(file)
        if (scenario.name, scenario.seed) in scenarios:
            raise UsageError(
                f"is another scenario {scenario.name} with seed {scenario.seed}",
                file=file,
                remedy="ask for that scenario and seed, or drive this one again",
            )
        scenarios[scenario.name, scenario.seed] = scenario
    seen: set[str] = set()
    for street, dataset_hash in _open_streets(plan):
        if street.scene_id in seen:
            raise UsageError(f"scene {street.scene_id!r} is named twice", place="--street", expected="distinct scenes")
        seen.add(street.scene_id)
        map_hash = sha256_bytes(encode_road_map(street.road_map))
        for scenario in scenarios.values():
            yield AskedDrive(street, dataset_hash, map_hash, scenario)


def _open_streets(plan: RolloutPlan) -> Iterator[tuple[Street, str | None]]:
    from hybridworldsim.simulator.street.of_synth import SCHEME
    from hybridworldsim.simulator.street.opening import open_street

    for source in plan.streets:
        if source.startswith(SCHEME):
            yield open_street(source, road_map=plan.road_map, boxes=plan.boxes), None
            continue
        import mirror

        dataset = mirror.open(source)
        for scene in dataset.scenes():
            street = open_street(source, scene=scene, road_map=plan.road_map, boxes=plan.boxes)
            yield street, dataset.index_sha256


def check_rollout(folder: Path, one: ScoredRollout, task: AskedDrive, protocol: Protocol) -> ScoredRollout:
    """Drive the recorded controls of a rollout again, and return the score of the new drive.

    Args:
        folder: folder of the rollout.
        one: the rollout, scored by its own files.
        task: what was asked for.
        protocol: the protocol.

    Raises:
        RefusedError: a motion is impossible, or the rollout is not what its controls lead to.
        UsageError: the scenario does not fit on the street.
    """
    from hybridworldsim.simulator.rollout.driven_again import drive_again

    log, rollout, scenario = _read_possible(folder), one.rollout, task.scenario
    is_failed = rollout.ending in BY_POLICY
    # A suite states the score of a drive that the policy ends.
    if is_failed and protocol.suite is None:
        raise RefusedError(
            f"the policy ended the rollout after {rollout.steps} steps: nobody knows what would have come then",
            file=folder / ROLLOUT, place="ending", expected="rollouts to their end", remedy=_UNVERIFIED,
        )  # fmt: skip
    for name in Scenario.model_fields:
        if getattr(one.scenario, name) != getattr(scenario, name):
            raise _another(
                folder / SCENARIO_FILE, name, getattr(one.scenario, name), getattr(scenario, name), "scenario"
            )
    if rollout.dataset_hash != task.dataset_hash:
        raise _another(folder / ROLLOUT, "dataset_hash", rollout.dataset_hash, task.dataset_hash, "dataset")
    if rollout.files[MAP_FILE].sha256 != task.map_hash:
        raise _another(folder / MAP_FILE, "sha256", rollout.files[MAP_FILE].sha256, task.map_hash, "map")
    controls = _read_controls(folder, rollout, scenario.steps)
    driven = drive_again(task.street, scenario, controls, ends_off_road=task.ends_off_road)
    _require_progress(driven.log, scenario)
    ending = driven.ending
    if is_failed and ending is None:
        ending = rollout.ending
    own = rollout.model_copy(
        update={
            "steps": driven.steps, "ending": ending, "scenario_version": scenario.version,
            "rate_hz": scenario.rate_hz, "map_source": task.street.map_source, "route_m": driven.route_m,
            "files": {**rollout.files, **_describe_files(task)},
        }
    )  # fmt: skip
    if ending is None:
        raise RefusedError(
            f"the controls end after {driven.steps} steps, and the drive does not",
            file=folder / ROLLOUT, place="ending", expected="the whole drive", remedy=_DRIVE,
        )  # fmt: skip
    for name in _STATED:
        if getattr(rollout, name) != getattr(own, name):
            raise _another(folder / ROLLOUT, name, getattr(rollout, name), getattr(own, name), "drive")
    if not _is_same_route(rollout.route_m, driven.route_m):
        raise RefusedError("is another route", file=folder / ROLLOUT, place="route_m", remedy=_DRIVE)
    difference = find_difference(log, driven.log)
    if difference is not None:
        raise RefusedError(
            f"not the states that the controls lead to: {difference}",
            file=folder / STATES_FILE, expected="the states of the drive, to 1e-6 m", remedy=_DRIVE,
        )  # fmt: skip
    again = score_drive(driven.log, task.street.road_map, scenario, one.path, own, protocol)
    for name in EVENTS:
        if one.values.get(name) != again.values.get(name) or one.causes.get(name) != again.causes.get(name):
            raise _another(folder / STATES_FILE, name, one.values.get(name), again.values.get(name), "drive")
    return again


def _require_progress(log: StateLog, scenario: Scenario) -> None:
    """Refuse a scenario in which a parked car has the best score."""
    speed_mps = scenario.ego.speed_mps or math.hypot(log.vx_mps[0, 0], log.vy_mps[0, 0])
    if speed_mps * scenario.duration_s <= LEAST_REFERENCE_M:
        raise UsageError(
            f"scenario {scenario.name} begins at {speed_mps:.1f} m/s: a car that stays parked has all the progress",
            place="--scenarios",
            expected=f"a speed with which the ego comes farther than {LEAST_REFERENCE_M:g} m",
            remedy="give it another ego.speed_mps, or another place in the recording",
        )


def _read_controls(folder: Path, rollout: Rollout, most: int) -> Sequence[Controls]:
    from hybridworldsim.simulator.rollout.actions import ACTIONS_FILE, read_actions

    entry, file = rollout.files.get(ACTIONS_FILE), folder / ACTIONS_FILE
    if entry is None or not file.is_file() or sha256_bytes(file.read_bytes()) != entry.sha256:
        raise RefusedError(
            "missing, or not the file that was written: the drive cannot be repeated",
            file=file, expected="the recorded controls of `mirror simulate`", remedy=_UNVERIFIED,
        )  # fmt: skip
    try:
        controls = read_actions(file, most)
    except DatasetError as error:
        raise RefusedError(error.problem, file=file, place=error.place, expected=error.expected) from error
    if len(controls) != rollout.steps:
        raise RefusedError(f"has controls of {len(controls)} steps", file=file, expected=f"{rollout.steps}")
    return controls


def _describe_files(task: AskedDrive) -> dict[str, FileEntry]:
    """The organiser's map and scenario, as a rollout lists them."""
    encoded = encode_scenario(task.scenario)
    return {
        MAP_FILE: FileEntry(bytes=len(encode_road_map(task.street.road_map)), sha256=task.map_hash),
        SCENARIO_FILE: FileEntry(bytes=len(encoded), sha256=sha256_bytes(encoded)),
    }


def _is_same_route(route: Sequence[tuple[float, float]], other: Sequence[tuple[float, float]]) -> bool:
    return len(route) == len(other) and all(
        max(abs(one[0] - two[0]), abs(one[1] - two[1])) <= _ROUTE_M for one, two in zip(route, other)
    )


def _another(file: Path, place: str, stated: object, expected: object, what: str) -> RefusedError:
    return RefusedError(
        f"{str(stated)!r:.120} is not that of the organiser's {what}",
        file=file,
        place=place,
        expected=f"{str(expected)!r:.120}",
        remedy=_DRIVE,
    )
