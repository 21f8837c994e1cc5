"""Rollouts with a policy: the folder, the repetition, policies that fail, and what is refused."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hybridworldsim.simulator.ego.vehicle import Controls
from hybridworldsim.simulator.environment.street_env import StreetEnv
from hybridworldsim.simulator.policies.protocol import Observation, ObservationSpec, PlannedTrajectory
from hybridworldsim.simulator.policies.references import LaneKeeping, Log, Stop
from hybridworldsim.simulator.policy_registry import make_policy, policy_names
from hybridworldsim.simulator.renderers.registry import RendererFactory
from hybridworldsim.simulator.rollout.actions import ACTIONS_FILE, Repeat, read_actions
from hybridworldsim.simulator.rollout.earlier_drive import EarlierDrive
from hybridworldsim.simulator.rollout.run import VIDEO_FILE, run_rollout
from hybridworldsim.simulator.rollout.same_street import require_same_street
from mirror.errors import UsageError
from mirror.methods.model_document import Reconstruction
from mirror.metrics.safety import read_state_log
from mirror.schema.files import write_json
from mirror.schema.road_map import read_road_map
from mirror.schema.rollout import STATES_FILE, read_rollout
from mirror.schema.scenario import Scenario, read_scenario, write_scenario
from tests.interruption import interrupt_at_call
from tests.simulator.requests import BRAKE, STREET, request
from tests.simulator.streets import scenario


class Scripted:
    """Answers by a function of the number of the step; counts what it gets."""

    privileged = False

    def __init__(self, answer, cameras: tuple[str, ...] = ()) -> None:
        self.cameras, self.answer, self.seen, self.closed = cameras, answer, [], 0

    def reset(self, spec: ObservationSpec) -> None:
        self.spec = spec

    def act(self, observation: Observation):
        self.seen.append(observation)
        return self.answer(len(self.seen) - 1)

    def close(self) -> None:
        self.closed += 1


def test_the_folder_of_a_rollout_is_complete(tmp_path: Path) -> None:
    result = run_rollout(request(LaneKeeping(), video=("front_wide", "rear")), tmp_path / "run")
    rollout = read_rollout(tmp_path / "run")
    assert (rollout.ending, rollout.steps, rollout.world) == ("duration", 30, "boxes")
    assert set(rollout.files) == {STATES_FILE, "scenario.toml", "map.parquet", ACTIONS_FILE, VIDEO_FILE}
    assert not list((tmp_path / "run").glob(".*"))
    log = read_state_log(tmp_path / "run" / STATES_FILE)
    assert len(log.stamps_ns) == 31
    assert log.ids == ("ego", "lead")
    assert np.diff(log.stamps_ns).tolist() == [100_000_000] * 30
    assert set(read_road_map(tmp_path / "run" / "map.parquet").lanes) == set(STREET.road_map.lanes)
    assert read_scenario(tmp_path / "run" / "scenario.toml").agents == BRAKE.agents
    assert result.rendered == 2 * 31
    assert result.safety.figures["collisions"].value == 0.0


def test_a_repeated_rollout_has_the_same_states_to_the_bit(tmp_path: Path) -> None:
    run_rollout(request(LaneKeeping()), tmp_path / "first")
    actions = read_actions(tmp_path / "first" / ACTIONS_FILE)
    run_rollout(request(Repeat(actions)), tmp_path / "second")
    first, second = ((tmp_path / name / STATES_FILE).read_bytes() for name in ("first", "second"))
    assert first == second
    changed = [*actions[:-1], Controls(actions[-1].acceleration_mps2 + 1e-9, actions[-1].curvature_radpm)]
    run_rollout(request(Repeat(changed)), tmp_path / "third")
    assert (tmp_path / "third" / STATES_FILE).read_bytes() != first


class Weaving:
    """Plans with what it remembers: every fourth step a trajectory to the other side, between them nothing."""

    cameras, privileged = (), False

    def reset(self, spec: ObservationSpec) -> None:
        self.steps = 0

    def act(self, observation: Observation) -> PlannedTrajectory | None:
        self.steps += 1
        if self.steps % 4 != 1:
            return None
        times, aside = np.array([1.0, 3.0]), 0.4 if self.steps % 8 == 1 else -0.4
        return PlannedTrajectory(times, np.column_stack([5.0 * times, np.full(2, aside), np.zeros(2)]))

    def close(self) -> None:
        """Release nothing."""


@pytest.mark.parametrize("step", [1, 10, 29])
def test_a_drive_that_goes_on_from_an_instant_is_the_earlier_one_where_the_policy_is_the_same(
    tmp_path: Path, step: int
) -> None:
    run_rollout(request(Weaving()), tmp_path / "first")
    earlier = EarlierDrive.read(tmp_path / "first")
    controls = earlier.controls_until(0.1 * step, earlier.scenario)
    assert len(controls) == step
    run_rollout(request(Weaving(), begins_with=controls), tmp_path / "same")
    for name in (STATES_FILE, ACTIONS_FILE):
        assert (tmp_path / "same" / name).read_bytes() == (tmp_path / "first" / name).read_bytes()
    other = Scripted(lambda number: Controls(-4.0, 0.0))
    run_rollout(request(other, begins_with=controls), tmp_path / "other")
    assert len(other.seen) == 30
    # it observes from the start, and steers from the instant on
    assert read_actions(tmp_path / "other" / ACTIONS_FILE) == (*controls, *[Controls(-4.0, 0.0)] * (30 - step))
    first, then = (read_state_log(tmp_path / name / STATES_FILE) for name in ("first", "other"))
    assert np.array_equal(first.x_m[: step + 1], then.x_m[: step + 1])
    assert not np.array_equal(first.x_m[step + 1 :], then.x_m[step + 1 :])


@pytest.mark.parametrize("at_s", [0.0, 0.15, 3.0, 9.0, -1.0])
def test_a_drive_goes_on_from_an_instant_of_the_earlier_one_alone(tmp_path: Path, at_s: float) -> None:
    run_rollout(request(Stop()), tmp_path / "run")
    earlier = EarlierDrive.read(tmp_path / "run")
    with pytest.raises(UsageError, match="ended after 3 s") as refused:
        earlier.controls_until(at_s, earlier.scenario)
    assert refused.value.place == "--at" and "0.1 s, up to 2.9 s" in str(refused.value.expected)
    longer = earlier.scenario.model_copy(update={"duration_s": 4.0})
    assert len(earlier.controls_until(3.0, longer)) == 30


def test_images_of_another_renderer_or_model_are_refused(tmp_path: Path) -> None:
    run_rollout(request(Stop()), tmp_path / "run")
    earlier = EarlierDrive.read(tmp_path / "run")
    earlier.require_renderer("boxes", None)
    with pytest.raises(UsageError, match="'boxes', not 'exact'"):
        earlier.require_renderer("exact", None)
    with pytest.raises(UsageError, match="another model"):
        earlier.require_renderer("boxes", "0" * 64)


def test_a_policy_gets_the_cameras_that_it_asks_for_and_no_others(tmp_path: Path) -> None:
    policy = Scripted(lambda step: Controls(0.0, 0.0), ("rear",))
    result = run_rollout(request(policy), tmp_path / "run")
    assert list(policy.spec.cameras) == ["rear"]
    assert {name for seen in policy.seen for name in seen.images} == {"rear"}
    assert all(seen.privileged is None for seen in policy.seen)
    assert result.rendered == result.rollout.steps + 1
    assert policy.closed == 1
    blind = run_rollout(request(Stop()), tmp_path / "blind")
    assert blind.rendered == 0


def test_a_trajectory_is_kept_until_the_next_action(tmp_path: Path) -> None:
    times = np.array([2.0, 4.0])
    plan = PlannedTrajectory(times, np.column_stack([6.0 * times, np.zeros(2), np.zeros(2)]))
    policy = Scripted(lambda step: plan if step == 0 else None)
    run_rollout(request(policy, scenario=scenario(duration_s=2.0)), tmp_path / "run")
    log = read_state_log(tmp_path / "run" / STATES_FILE)
    assert log.vx_mps[-1, 0] == pytest.approx(6.0, abs=0.7)


def fail(step: int) -> Controls:
    if step == 7:
        raise ValueError("out of ideas")
    return Controls(0.0, 0.0)


def sleep(step: int) -> Controls:
    if step == 7:
        time.sleep(3.0)
    return Controls(0.0, 0.0)


@pytest.mark.parametrize(
    ("answer", "deadline_s", "reason"),
    [
        (fail, 5.0, "ValueError: out of ideas"),
        (fail, np.inf, "ValueError: out of ideas"),
        (sleep, 0.3, "no answer within 0.3 s"),
        (lambda step: Controls(np.nan if step == 7 else 0.0, 0.0), np.inf, "acceleration_mps2 is nan"),
        (lambda step: "left" if step == 7 else None, np.inf, "an action of type str"),
        (lambda step: PlannedTrajectory(np.zeros(0), np.zeros((0, 3))) if step == 7 else None, np.inf, "shape"),
    ],
)
def test_a_policy_that_fails_ends_the_rollout_with_its_name_and_a_complete_log(
    tmp_path: Path, answer, deadline_s: float, reason: str
) -> None:
    result = run_rollout(request(Scripted(answer, ("rear",)), deadline_s=deadline_s, video=("rear",)), tmp_path / "run")
    assert result.error is not None
    rollout = read_rollout(tmp_path / "run")
    assert rollout.ending == ("deadline" if answer is sleep else "policy")
    assert rollout.reason is not None
    assert reason in rollout.reason and "'test'" in rollout.reason
    assert rollout.steps == 7
    assert len(read_state_log(tmp_path / "run" / STATES_FILE).stamps_ns) == 8
    assert len(read_actions(tmp_path / "run" / ACTIONS_FILE)) == 7
    assert (tmp_path / "run" / VIDEO_FILE).is_file()


def test_an_interrupted_rollout_leaves_its_log_and_is_driven_again(tmp_path: Path) -> None:
    interrupt = interrupt_at_call(lambda step: Controls(0.0, 0.0), 13)
    with pytest.raises(KeyboardInterrupt):
        run_rollout(request(Scripted(interrupt)), tmp_path / "run")
    assert len(read_state_log(tmp_path / "run" / STATES_FILE).stamps_ns) == 13
    assert not (tmp_path / "run" / "run.json").exists()
    again = run_rollout(request(Stop()), tmp_path / "run")
    assert again.rollout.steps == 30


def test_a_collision_ends_the_rollout(tmp_path: Path) -> None:
    wall = scenario({"id": "queue", "behaviour": {"kind": "stopped-queue", "ttc_s": 1.0}})
    result = run_rollout(request(Scripted(lambda step: Controls(0.0, 0.0)), scenario=wall), tmp_path / "run")
    assert result.rollout.ending == "collision"
    assert [collision.agent for collision in result.safety.collisions] == ["queue"]
    assert result.safety.collisions[0].impact_speed_mps == pytest.approx(10.0)


def test_the_log_policy_follows_the_recording(tmp_path: Path) -> None:
    recorded = scenario(ego={"start": {"kind": "recorded", "after_s": 2.0}}, duration_s=5.0)
    run_rollout(request(Log(), scenario=recorded), tmp_path / "run")
    log = read_state_log(tmp_path / "run" / STATES_FILE)
    recording = STREET.recordings["drive-1"]
    expected = np.interp(2.0 + log.times_s, recording.times_s, recording.poses[:, 0])
    assert np.abs(log.x_m[:, 0] - log.rear_axle_to_center_m - expected).max() < 0.05
    result = run_rollout(request(Log()), tmp_path / "elsewhere")
    assert "no recorded trajectory" in str(result.error)


def test_complete_folders_and_unknown_cameras_are_refused(tmp_path: Path) -> None:
    run_rollout(request(Stop()), tmp_path / "run")
    before = (tmp_path / "run" / STATES_FILE).read_bytes()
    with pytest.raises(UsageError, match="complete rollout"):
        run_rollout(request(Stop()), tmp_path / "run")
    assert (tmp_path / "run" / STATES_FILE).read_bytes() == before
    with pytest.raises(UsageError, match="needs camera 'side'"):
        run_rollout(request(Scripted(fail, ("side",))), tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_model_of_another_scene_is_refused_even_if_nothing_is_rendered(tmp_path: Path) -> None:
    model = tmp_path / "model"
    document = Reconstruction(method="hybridworldsim", scene="elsewhere", split="novel", trained={"drive-1": "0"})
    write_json(model / "reconstruction.json", document)
    factory = RendererFactory("reconstructed", model)
    with pytest.raises(UsageError, match="shows scene elsewhere"):
        run_rollout(request(Stop(), factory=factory), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_rollout_is_repeated_in_the_recording_that_it_was_driven_in_and_no_other(tmp_path: Path) -> None:
    earlier = run_rollout(request(Stop()), tmp_path / "run").rollout
    require_same_street(tmp_path / "run", earlier, STREET, BRAKE, None)
    later = replace(STREET.recordings["drive-1"], start_ns=STREET.recordings["drive-1"].start_ns + 60_000_000_000)
    street = replace(STREET, recordings={"drive-1": later})
    with pytest.raises(UsageError, match=r"22:13:20.*22:14:20"):
        require_same_street(tmp_path / "run", earlier, street, BRAKE, None)
    with pytest.raises(UsageError, match=r"'straight'.*'elsewhere'"):
        require_same_street(tmp_path / "run", earlier, replace(STREET, scene_id="elsewhere"), BRAKE, None)


@pytest.mark.parametrize(
    ("wrong", "place"),
    [
        (scenario(ego={"route": {"lanes": ["nowhere"]}}), "ego.route.lanes"),
        (scenario(ego={"start": {"kind": "recorded", "after_s": 60.0}}), "ego.start.after_s"),
        (scenario({"id": "a", "behaviour": {"kind": "replay", "tracks": ["van-1"]}}), "agent 'a'"),
        (scenario({"id": "a", "behaviour": {"kind": "idm", "ahead_m": 900.0}}), "agent 'a'"),
    ],
)
def test_a_scenario_that_does_not_fit_is_refused_by_its_file_and_the_place_in_it(
    tmp_path: Path, wrong: Scenario, place: str
) -> None:
    file = tmp_path / "mine.toml"
    write_scenario(file, wrong)
    with pytest.raises(UsageError) as refused:
        run_rollout(request(Stop(), scenario=read_scenario(file), scenario_file=str(file)), tmp_path / "run")
    assert (refused.value.file, refused.value.place) == (str(file), place)
    assert not (tmp_path / "run").exists()
    with pytest.raises(UsageError) as refused:
        StreetEnv(STREET, scenario=file).reset()
    assert (refused.value.file, refused.value.place) == (str(file), place)


def test_installed_policies_are_found_by_name() -> None:
    assert {"constant-velocity", "idm", "log", "stop"} <= set(policy_names())
    assert isinstance(make_policy("idm"), LaneKeeping)
    with pytest.raises(UsageError, match="no policy 'chauffeur'"):
        make_policy("chauffeur")
