"""Forged rollouts, each refused or unverified: states, scenarios, routes, maps, seeds and controls of a participant."""

from __future__ import annotations

import math
import re
import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hybridworldsim.simulator.policies.references import LaneKeeping, Stop
from hybridworldsim.simulator.renderers.registry import RendererFactory
from hybridworldsim.simulator.rollout.actions import ACTIONS_FILE, read_actions, write_actions
from hybridworldsim.simulator.rollout.run import RolloutRequest, run_rollout
from hybridworldsim.simulator.street.opening import open_street
from hybridworldsim.simulator.street.street import Street
from mirror.cli.main import main
from mirror.errors import MirrorError, UsageError
from mirror.evaluation.rollouts import evaluate_rollouts
from mirror.evaluation.scorers.safety import score_folder
from mirror.metrics.safety import StateLog, read_state_log, write_state_log
from mirror.protocols.document import load_protocol
from mirror.schema.files import sha256_bytes, write_json
from mirror.schema.road_map import MapArea, encode_road_map, read_road_map, write_road_map
from mirror.schema.rollout import MAP_FILE, ROLLOUT, SCENARIO_FILE, STATES_FILE, Rollout, list_files
from mirror.schema.scenario import Scenario, read_scenario, write_scenario
from mirror_leaderboard.add import add_result
from mirror_leaderboard.entry import Measured, load_entries
from mirror_leaderboard.refused import RefusedError
from mirror_leaderboard.rescore import RolloutPlan, Sources
from mirror_leaderboard.rollouts import AskedDrive, check_rollout
from tests.simulator.streets import straight_street

SOURCE = "synth:tiny"
PROTOCOL = load_protocol("safety")
SCENARIO = Scenario.model_validate(
    {
        "name": "follow",
        "duration_s": 4.0,
        "ego": {"speed_mps": 6.0},
        "agents": [
            {"id": "lead", "behaviour": {"kind": "idm", "ahead_m": 12.0, "speed_mps": 4.0}},
            {"id": "next", "behaviour": {"kind": "idm", "ahead_m": 30.0, "speed_mps": 5.0}},
        ],
    }
)


@pytest.fixture(scope="module")
def street() -> Street:
    return open_street(SOURCE)


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> RolloutPlan:
    """The organiser's request: one scenario with two seeds."""
    folder = tmp_path_factory.mktemp("scenarios")
    for seed in (0, 1):
        write_scenario(folder / f"follow-{seed}.toml", SCENARIO.model_copy(update={"seed": seed}))
    return RolloutPlan((SOURCE,), folder)


@pytest.fixture(scope="module")
def driven(street: Street, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rollouts of the built-in policy."""
    folder = tmp_path_factory.mktemp("driven")
    for seed in (0, 1):
        request = RolloutRequest(street, SCENARIO, LaneKeeping(), "idm", {}, RendererFactory("boxes"), seed)
        run_rollout(request, folder / f"follow-{seed}")
    return folder


@pytest.fixture
def runs(driven: Path, tmp_path: Path) -> Path:
    """A copy of the rollouts that may be forged."""
    shutil.copytree(driven, tmp_path / "runs")
    return tmp_path / "runs"


def submit(runs: Path, plan: RolloutPlan | None) -> Measured:
    """Evaluate rollouts as a participant does, and put the result on a new board."""
    out = runs.parent / f"out-{plan is None}"
    evaluate_rollouts(runs, PROTOCOL, out)
    board = runs.parent / f"board-{plan is None}"
    add_result(out / "result.json", board, "street", sources=Sources(str(runs), plan=plan))
    (entry,) = load_entries(board / "entries")
    assert isinstance(entry, Measured)
    return entry


def epdms(entry: Measured) -> float | None:
    return next(figure.value for figure in entry.figures if figure.metric == "epdms")


def rewrite(run: Path, **changes: Any) -> None:
    """Write a consistent ``run.json`` for the files as they are."""
    document = read_rollout_unchecked(run).model_copy(update=changes)
    (run / ROLLOUT).unlink()
    write_json(run / ROLLOUT, document.model_copy(update={"files": list_files(run)}))


def read_rollout_unchecked(run: Path) -> Rollout:
    return Rollout.model_validate_json((run / ROLLOUT).read_text())


def ego_only(log: StateLog, x: np.ndarray, y: np.ndarray, yaw: np.ndarray, speed: np.ndarray) -> StateLog:
    """The log with another ego and no agents."""
    columns = {"x_m": x, "y_m": y, "yaw_rad": yaw, "vx_mps": speed * np.cos(yaw), "vy_mps": speed * np.sin(yaw)}
    return replace(
        log, **{name: values[:, None] for name, values in columns.items()}, present=log.present[:, :1],
        length_m=log.length_m[:1], width_m=log.width_m[:1], ids=log.ids[:1], categories=log.categories[:1],
    )  # fmt: skip


def perfect_path(run: Path) -> None:
    """Delete the agents, and drive along the route at the scenario's speed."""
    log, route = read_state_log(run / STATES_FILE), np.array(read_rollout_unchecked(run).route_m)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(route, axis=0).T))])
    start = along[np.argmin(np.hypot(*(route - (log.x_m[0, 0], log.y_m[0, 0])).T))]
    places = start + 6.0 * log.times_s
    x, y = (np.interp(places, along, values) for values in route.T)
    ahead = [np.interp(places + 1.0, along, values) for values in route.T]
    yaw = np.unwrap(np.arctan2(ahead[1] - y, ahead[0] - x))
    write_state_log(run / STATES_FILE, ego_only(log, x, y, yaw, np.full(len(x), 6.0)))
    rewrite(run)


def parked_with_scenario(run: Path) -> None:
    """Park, and set the speed of the scenario to 0, so that no progress is asked for."""
    park(run)
    scenario = read_scenario(run / SCENARIO_FILE)
    write_scenario(
        run / SCENARIO_FILE, scenario.model_copy(update={"ego": scenario.ego.model_copy(update={"speed_mps": 0.0})})
    )
    rewrite(run)


def park(run: Path) -> None:
    log = read_state_log(run / STATES_FILE)
    still = [np.full(len(log.stamps_ns), values[0, 0]) for values in (log.x_m, log.y_m, log.yaw_rad)]
    write_state_log(run / STATES_FILE, ego_only(log, *still, np.zeros(len(log.stamps_ns))))
    write_actions(run / ACTIONS_FILE, [replace(one, acceleration_mps2=0.0) for one in read_actions(run / ACTIONS_FILE)])


def parked_with_route(run: Path) -> None:
    """Park, and state a route of six points that ends at the car."""
    park(run)
    log = read_state_log(run / STATES_FILE)
    x, y, yaw = (float(values[0, 0]) for values in (log.x_m, log.y_m, log.yaw_rad))
    route = tuple((x + step * math.cos(yaw), y + step * math.sin(yaw)) for step in (-8.0, -6.0, -4.0, -2.0, 0.0, 1.0))
    rewrite(run, route_m=route)


def edit_log(change: Callable[[StateLog], StateLog]) -> Callable[[Path], None]:
    def forge(run: Path) -> None:
        log = change(read_state_log(run / STATES_FILE))
        write_state_log(run / STATES_FILE, log)
        rewrite(run)

    return forge


def swap_agents(log: StateLog) -> StateLog:
    return replace(log, ids=("ego", "next", "lead"))


def nudge(log: StateLog) -> StateLog:
    x = log.x_m.copy()
    x[7, 1] += 2e-6
    return replace(log, x_m=x)


def other_step(run: Path) -> None:
    """State a rate of 20 Hz, so that the ego has twice as many instants to brake."""
    scenario = read_scenario(run / SCENARIO_FILE)
    write_scenario(run / SCENARIO_FILE, scenario.model_copy(update={"rate_hz": 20.0}))
    rewrite(run, rate_hz=20.0)


def truncate(**changes: Any) -> Callable[[Path], None]:
    """End the log before what comes."""

    def forge(run: Path) -> None:
        log = read_state_log(run / STATES_FILE)
        columns = {name: getattr(log, name)[:11] for name in ("stamps_ns", "x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps")}
        write_state_log(
            run / STATES_FILE, replace(log, **columns, present=log.present[:11], signal_states=log.shown_signals[:11])
        )
        write_actions(run / ACTIONS_FILE, read_actions(run / ACTIONS_FILE)[:10])
        rewrite(run, steps=10, **changes)

    return forge


def widen_road(run: Path) -> None:
    road_map = read_road_map(run / MAP_FILE)
    everywhere = np.array([(-900.0, -900.0), (900.0, -900.0), (900.0, 900.0), (-900.0, 900.0)])
    write_road_map(run / MAP_FILE, replace(road_map, drivable=(MapArea("everywhere", (everywhere,)),)))
    rewrite(run)


def other_seed(run: Path) -> None:
    """Keep the best of many seeds."""
    scenario = read_scenario(run / SCENARIO_FILE)
    write_scenario(run / SCENARIO_FILE, scenario.model_copy(update={"seed": 77}))
    rewrite(run, seed=77)


def edit_controls(change: Callable[[list[Any]], list[Any]]) -> Callable[[Path], None]:
    def forge(run: Path) -> None:
        table = pq.read_table(run / ACTIONS_FILE)
        values = change(table["acceleration_mps2"].to_pylist())
        curvature = [0.0] * len(values)
        schema = table.schema
        pq.write_table(pa.table({schema.names[0]: values, schema.names[1]: curvature}, schema), run / ACTIONS_FILE)
        rewrite(run)

    return forge


def no_controls(run: Path) -> None:
    (run / ACTIONS_FILE).unlink()
    rewrite(run)


FORGERIES = {
    "agents deleted and a perfect path": (perfect_path, r"actor '(lead|next)' is missing"),
    "parked, and the scenario's speed is 0": (parked_with_scenario, "ego.*organiser's scenario|place.*ego"),
    "parked, and a route of six points": (parked_with_route, "another route"),
    "two agents swapped": (edit_log(swap_agents), "of actor '(lead|next)' differs"),
    "an agent moved by 2e-6 m": (edit_log(nudge), "x_m of actor 'lead' differs by 2e-06 at instant 7"),
    "another time step": (other_step, "rate_hz"),
    "a truncated log": (truncate(), "the controls end after 10 steps"),
    "a policy that fails before what comes": (truncate(ending="policy", reason="no answer"), "the policy ended"),
    "a wider road": (widen_road, "organiser's map"),
    "another seed": (other_seed, "seed 77 in scene .* was not asked for"),
    "infinite acceleration": (edit_controls(lambda values: [math.inf, *values[1:]]), "no finite number"),
    "no acceleration": (edit_controls(lambda values: [None, *values[1:]]), "no finite number"),
    "other controls": (edit_controls(lambda values: [1e300, *values[1:]]), "not the states that the controls lead to"),
    "more controls": (edit_controls(lambda values: [*values, *values]), "80 steps"),
    "no controls": (no_controls, "the drive cannot be repeated"),
}  # fmt: skip


def test_an_honest_drive_is_verified_and_has_the_organisers_plan(runs: Path, asked: RolloutPlan) -> None:
    entry = submit(runs, asked)
    assert entry.verified and entry.plan_hash is not None
    assert entry.plan_hash == submit(runs, None).plan_hash
    assert 0.0 < (epdms(entry) or 0.0) <= 1.0


@pytest.mark.parametrize("name", FORGERIES)
def test_a_forged_rollout_is_refused(runs: Path, asked: RolloutPlan, name: str) -> None:
    """Before: each was verified, the first three with an EPDMS of 1.000."""
    forge, message = FORGERIES[name]
    forge(runs / "follow-0")
    with pytest.raises(RefusedError) as refused:
        submit(runs, asked)
    assert re.search(message, f"{refused.value} place={refused.value.place}")
    assert not (runs.parent / "board-False").exists()


@pytest.mark.parametrize("forge", [perfect_path, parked_with_scenario, parked_with_route])
def test_forgeries_score_better_than_the_honest_drive_where_nobody_drives_again(
    runs: Path, forge: Callable[[Path], None]
) -> None:
    for seed in (0, 1):
        forge(runs / f"follow-{seed}")
    entry = submit(runs, None)
    assert epdms(entry) == pytest.approx(1.0) and not entry.verified


def jump(log: StateLog) -> StateLog:
    """The ego is 100 m ahead after one step."""
    x, y = log.x_m.copy(), log.y_m.copy()
    x[20:, 0] += 100.0 * math.cos(log.yaw_rad[20, 0])
    y[20:, 0] += 100.0 * math.sin(log.yaw_rad[20, 0])
    return replace(log, x_m=x, y_m=y)


def jump_agent(log: StateLog) -> StateLog:
    y = log.y_m.copy()
    y[20:, 1] += 30.0
    return replace(log, y_m=y)


def brake_at_once(log: StateLog) -> StateLog:
    vx, vy, x, y = log.vx_mps.copy(), log.vy_mps.copy(), log.x_m.copy(), log.y_m.copy()
    vx[20:, 0] = vy[20:, 0] = 0.0
    x[20:, 0], y[20:, 0] = x[20, 0], y[20, 0]
    return replace(log, vx_mps=vx, vy_mps=vy, x_m=x, y_m=y)


def turn_on_the_spot(log: StateLog) -> StateLog:
    yaw = log.yaw_rad.copy()
    yaw[20:, 0] += 0.5 * math.pi
    return replace(log, yaw_rad=yaw)


def crawl_sideways(log: StateLog) -> StateLog:
    y, x = log.y_m.copy(), log.x_m.copy()
    aside = np.concatenate([np.zeros(20), 0.4 * np.arange(1, len(y) - 19)])
    x[:, 0] -= aside * math.sin(log.yaw_rad[20, 0])
    y[:, 0] += aside * math.cos(log.yaw_rad[20, 0])
    return replace(log, x_m=x, y_m=y)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (jump, "from where its speed leads"),
        (jump_agent, "from where its velocity leads"),
        (brake_at_once, "change of speed"),
        (turn_on_the_spot, "turn in a step|from where|change of speed|sideways"),
        (crawl_sideways, "sideways"),
    ],
)
def test_motions_that_no_body_can_make_are_refused_with_and_without_a_plan(
    runs: Path, asked: RolloutPlan, change: Callable[[StateLog], StateLog], message: str
) -> None:
    """Before: an ego that jumped 100 m in one step was verified with an EPDMS of 1.000."""
    edit_log(change)(runs / "follow-1")
    for plan in (None, asked):
        with pytest.raises(RefusedError, match=message) as refused:
            submit(runs, plan)
        assert refused.value.file == str(runs / "follow-1" / STATES_FILE)


def test_rows_that_are_written_twice_are_refused(runs: Path) -> None:
    table = pq.read_table(runs / "follow-0" / STATES_FILE)
    pq.write_table(pa.concat_tables([table, table.slice(0, 3)]), runs / "follow-0" / STATES_FILE)
    rewrite(runs / "follow-0")
    with pytest.raises(MirrorError, match="two states at one instant"):
        submit(runs, None)


def test_the_worst_rollout_cannot_be_left_out(runs: Path, asked: RolloutPlan) -> None:
    shutil.rmtree(runs / "follow-1")
    with pytest.raises(RefusedError, match="follow with seed 1 in scene"):
        submit(runs, asked)


def test_a_collision_cannot_be_cut_off(street: Street, tmp_path: Path) -> None:
    """A drive that ends in a collision: the controls up to there are not the whole drive."""
    wall = SCENARIO.model_copy(update={"name": "wall", "agents": (), "duration_s": 6.0})
    queue = {"id": "queue", "behaviour": {"kind": "stopped-queue", "ttc_s": 2.0}}
    wall = Scenario.model_validate({**wall.model_dump(), "agents": [queue]})
    (tmp_path / "scenarios").mkdir()
    write_scenario(tmp_path / "scenarios" / "wall.toml", wall)

    class Blind(LaneKeeping):
        def act(self, observation):  # type: ignore[no-untyped-def]
            return replace(super().act(observation), acceleration_mps2=0.5)

    request = RolloutRequest(street, wall, Blind(), "blind", {}, RendererFactory("boxes"))
    assert run_rollout(request, tmp_path / "runs" / "wall").rollout.ending == "collision"
    plan = RolloutPlan((SOURCE,), tmp_path / "scenarios")
    entry = submit(tmp_path / "runs", plan)
    assert entry.verified and epdms(entry) == 0.0
    run = tmp_path / "runs" / "wall"
    truncate(ending="duration")(run)
    with pytest.raises(RefusedError, match="after 10 steps"):
        submit(tmp_path / "runs", plan)


def test_a_scenario_that_a_parked_car_wins_is_the_organisers_mistake(street: Street, tmp_path: Path) -> None:
    standing = SCENARIO.model_copy(
        update={"name": "standing", "ego": SCENARIO.ego.model_copy(update={"speed_mps": 0.0})}
    )
    (tmp_path / "scenarios").mkdir()
    write_scenario(tmp_path / "scenarios" / "standing.toml", standing)
    run_rollout(
        RolloutRequest(street, standing, Stop(), "stop", {}, RendererFactory("boxes")), tmp_path / "runs" / "one"
    )
    assert epdms(submit(tmp_path / "runs", None)) == 1.0
    with pytest.raises(UsageError, match=r"a car that stays parked") as refused:
        submit(tmp_path / "runs", RolloutPlan((SOURCE,), tmp_path / "scenarios"))
    assert refused.value.place == "--scenarios"


def test_a_log_of_20_s_with_60_agents_is_checked_in_150_ms(tmp_path: Path) -> None:
    """Processor time of reading, bounds, driving again, comparing and scoring; the least of five."""
    street = straight_street()
    traffic = {"kind": "idm", "radius_m": 400.0, "speed_mps": 1.0, "desired_share": 0.1}
    ego = {"speed_mps": 6.0, "start": {"kind": "lane", "lane": "fast", "along_m": 30.0}}
    crowded = Scenario.model_validate(
        {"name": "jam", "duration_s": 20.0, "ego": ego, "agents": [{"id": "t", "count": 60, "behaviour": traffic}]}
    )
    request = RolloutRequest(street, crowded, LaneKeeping(), "idm", {}, RendererFactory("boxes"))
    rollout = run_rollout(request, tmp_path / "run").rollout
    one = score_folder(tmp_path / "run", "run", rollout, PROTOCOL)
    task = AskedDrive(street, None, sha256_bytes(encode_road_map(street.road_map)), crowded)
    seconds = []
    for _ in range(5):
        begin = time.process_time()
        again = check_rollout(tmp_path / "run", one, task, PROTOCOL)
        seconds.append(time.process_time() - begin)
    assert rollout.steps == 200 and len(read_state_log(tmp_path / "run" / STATES_FILE).ids) == 61
    # To the bit on the machine that made them.
    assert again.values == one.values
    assert min(seconds) <= 0.15


def test_the_verb_needs_both_street_and_scenarios(
    runs: Path, asked: RolloutPlan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, board = tmp_path / "scores", tmp_path / "board"
    assert main(["evaluate", str(runs), "--protocol", "safety", "--out", str(out)]) == 0
    add = ["leaderboard", "add", str(out / "result.json"), str(runs), "--dataset-name", "s", "--board", str(board)]
    assert main([*add, "--street", SOURCE]) == 2
    assert "--scenarios" in capsys.readouterr().err
    assert main([*add, "--street", SOURCE, "--scenarios", str(tmp_path / "none")]) == 2
    assert main([*add, "--street", SOURCE, SOURCE, "--scenarios", str(asked.scenarios)]) == 2
    assert main([*add, "--boxes", "a@1"]) == 2
    assert not (board / "entries").exists()
    assert main([*add, "--street", SOURCE, "--scenarios", str(asked.scenarios)]) == 0
    (entry,) = load_entries(board / "entries")
    assert isinstance(entry, Measured) and entry.verified
