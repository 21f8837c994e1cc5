"""The Gymnasium environment: the checker, seeds, vectors of environments, counters of images, refusals."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from hybridworldsim.simulator.environment.street_env import StreetEnv
from mirror.errors import UsageError
from tests.simulator.streets import scenario, straight_street

STREET = straight_street()
TRAFFIC = scenario({"id": "traffic", "count": 5, "behaviour": {"kind": "idm"}}, lane="fast", duration_s=2.0)


@pytest.mark.parametrize("action", ["controls", "trajectory"])
def test_gymnasium_accepts_the_environment(action: str) -> None:
    env = StreetEnv(STREET, scenario=TRAFFIC, cameras=("front_wide", "rear"), action=action, width_px=48)
    check_env(env, skip_render_check=True)


def test_no_image_is_rendered_that_nobody_asked_for() -> None:
    blind = StreetEnv(STREET, scenario=TRAFFIC)
    observation, _ = blind.reset()
    assert "cameras" not in observation
    blind.step(np.zeros(2))
    assert blind.rendered == 0
    seeing = StreetEnv(STREET, scenario=TRAFFIC, cameras=("rear",), width_px=32)
    observation, _ = seeing.reset()
    assert list(observation["cameras"]) == ["rear"]
    seeing.step(np.zeros(2))
    assert seeing.rendered == 2


def test_seeds_are_honoured() -> None:
    env = StreetEnv(STREET, scenario=TRAFFIC)
    routes = []
    for seed in (5, 5, 6, None):
        env.reset(seed=seed)
        for _ in range(5):
            env.step(np.array([0.5, 0.0]))
        routes.append(env.state_log)
    assert np.array_equal(routes[0].x_m, routes[1].x_m)
    assert not (routes[0].x_m.shape == routes[2].x_m.shape and np.array_equal(routes[0].x_m, routes[2].x_m))
    assert not (routes[2].x_m.shape == routes[3].x_m.shape and np.array_equal(routes[2].x_m, routes[3].x_m))


def test_the_episode_is_truncated_at_its_duration_and_its_log_is_complete() -> None:
    env = StreetEnv(STREET, scenario=scenario(duration_s=1.0))
    env.reset(seed=0)
    for step in range(10):
        _, reward, terminated, truncated, info = env.step(np.zeros(2))
        assert not terminated
        assert truncated == (step == 9)
        assert reward == pytest.approx(1.0, abs=0.51)
    assert info["ending"] == "duration"
    assert len(env.state_log.stamps_ns) == 11


def test_a_collision_ends_the_episode() -> None:
    queue = {"id": "queue", "behaviour": {"kind": "stopped-queue", "ttc_s": 1.0}}
    env = StreetEnv(STREET, scenario=scenario(queue))
    env.reset()
    for _ in range(20):
        *_, terminated, truncated, info = env.step(np.zeros(2))
        if terminated:
            break
    assert (terminated, truncated, info["ending"]) == (True, False, "collision")
    assert env.state_log.times_s[-1] == pytest.approx(1.1, abs=0.11)


def test_a_straight_trajectory_is_driven() -> None:
    env = StreetEnv(STREET, scenario=scenario(duration_s=3.0), action="trajectory")
    env.reset()
    plan = np.column_stack([10.0 * 0.5 * np.arange(1, 9), np.zeros(8), np.zeros(8)])
    for _ in range(20):
        env.step(plan)
    log = env.state_log
    assert log.x_m[-1, 0] - log.x_m[0, 0] == pytest.approx(20.0, abs=0.2)
    assert np.abs(log.y_m[:, 0] - log.y_m[0, 0]).max() < 0.02


def test_bad_actions_are_refused_and_change_nothing() -> None:
    env = StreetEnv(STREET, scenario=TRAFFIC)
    env.reset()
    with pytest.raises(UsageError, match="finite"):
        env.step(np.array([math.nan, 0.0]))
    with pytest.raises(UsageError, match="shape"):
        env.step(np.zeros(3))
    assert len(env.state_log.stamps_ns) == 1
    env.step(np.zeros(2))
    assert len(env.state_log.stamps_ns) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"cameras": ("side",)}, "no camera 'side'"),
        ({"renderer": "oil-paint"}, "no renderer"),
        ({"renderer": "dreamed"}, "no renderer"),
        ({"renderer": "generated"}, "needs a model"),
        ({"renderer": "reconstructed"}, "needs a model"),
        ({"model": "somewhere"}, "has no model"),
        ({"action": "wish"}, "action 'wish'"),
        ({"scenario": "unheard-of"}, "no scenario"),
    ],
)
def test_bad_arguments_are_refused(arguments: dict, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        StreetEnv(STREET, **{"scenario": TRAFFIC, **arguments})


def test_the_exact_world_of_an_invented_street_is_refused() -> None:
    env = StreetEnv(STREET, scenario=TRAFFIC, renderer="exact")
    with pytest.raises(UsageError, match="not known"):
        env.reset()


def test_the_frame_shows_cameras_and_the_street_from_above() -> None:
    env = StreetEnv(STREET, scenario=TRAFFIC, cameras=("front_wide", "rear"), width_px=96, render_mode="rgb_array")
    env.reset()
    frame = env.render()
    assert frame is not None
    assert frame.shape == (54, 2 * 96 + 54, 3)
    assert len(np.unique(frame.reshape(-1, 3), axis=0)) > 10


def test_gymnasium_finds_the_environment_without_an_import() -> None:
    code = (
        "import gymnasium; from gymnasium.envs import registration; "
        "print(registration._find_spec('hybridworldsim.gym:mirror/Street-v0').id)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "mirror/Street-v0"


def test_vectors_of_environments_work_with_spawn() -> None:
    envs = gymnasium.make_vec(
        "hybridworldsim.gym:mirror/Street-v0",
        num_envs=2,
        vectorization_mode="async",
        vector_kwargs={"context": "spawn"},
        street=straight_street(),
        scenario=TRAFFIC,
        cameras=("front_wide",),
        width_px=32,
    )
    try:
        observations, _ = envs.reset(seed=[1, 2])
        assert observations["cameras"]["front_wide"].shape == (2, 18, 32, 3)
        observations, rewards, *_ = envs.step(np.zeros((2, 2), np.float32))
        assert rewards.shape == (2,)
        assert (np.diff(observations["stamp_ns"], axis=0) == 0).all()
    finally:
        envs.close()


def test_a_model_renders_without_a_named_renderer(tmp_path: Path) -> None:
    (tmp_path / "reconstruction.json").write_text('{"format": "mirror-reconstruction"}')
    assert StreetEnv(model=tmp_path)._factory.name == "reconstructed"
    assert StreetEnv()._factory.name == "boxes"
