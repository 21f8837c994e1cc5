"""Generated road users in closed loop: seeds, references, empty views, restarts and the verb."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from torch import nn

from hybridworldsim.generation.clips.clip import Clip, ClipBoxes
from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions, roll_out_clip, views_with_boxes
from hybridworldsim.generation.inference.frame_sampler import SamplerSettings
from hybridworldsim.generation.scenes.rollout import SceneGenerator
from hybridworldsim.simulator.command import main
from hybridworldsim.simulator.ego.vehicle import Controls
from hybridworldsim.simulator.environment.street_env import StreetEnv
from hybridworldsim.simulator.renderers.generated import GeneratedRenderer
from hybridworldsim.simulator.renderers.protocol import ego_pose, rig_cameras
from hybridworldsim.simulator.simulation import Simulation
from hybridworldsim.simulator.world import Snapshot
from mirror.arrays import UInt8
from mirror.errors import ExitCode, UsageError
from mirror.protocols.views.view import RenderView
from mirror.schema.rollout import read_rollout
from tests.simulator.generated_street import CAMERAS, HEIGHT, WIDTH, FlatStreet, T, renderer_of, start

STEPS = 9


def drive(simulation: Simulation, renderer: GeneratedRenderer, steps: int) -> tuple[list[Snapshot], list[UInt8]]:
    snapshots, images = [], []
    for _ in range(steps):
        snapshots.append(simulation.now)
        shown = renderer.render(simulation.now, CAMERAS)
        images.append(np.stack([shown[name] for name in CAMERAS]))
        simulation.advance(Controls(0.0, 0.0))
    return snapshots, images


def passes_of(network: nn.Module) -> list[int]:
    """A list that grows by the number of views of each pass of a network."""
    passes: list[int] = []
    network.register_forward_hook(lambda _, inputs, output: passes.append(int(output.shape[2])))
    return passes


def test_a_drive_is_the_rollout_over_its_own_frames(opened: SceneGenerator, models: Path) -> None:
    """Against the rollout over a clip of the whole drive, which makes its conditions from one document."""
    simulation = start()
    renderer = renderer_of(simulation, opened, models)
    snapshots, images = drive(simulation, renderer, STEPS)
    rendered = np.stack(images)
    empty = np.stack([backgrounds(renderer, simulation, one) for one in snapshots])
    egos = [ego_pose(simulation.street, one) for one in snapshots]
    poses = np.concatenate([(egos[0].inverse() @ ego).matrix() for ego in egos])
    lead = []
    for ego, one in zip(egos, snapshots):
        world = np.eye(4)
        height = simulation.now.agents[0].size_m[2]
        world[:3, 3] = one.states.x_m[0], one.states.y_m[0], 0.5 * height
        yaw = one.states.yaw_rad[0]
        world[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
        lead.append(np.linalg.inv(ego.matrix()[0]) @ world)
    number = np.arange(STEPS, dtype=np.int64)
    sizes = np.tile(simulation.now.agents[0].size_m, (STEPS, 1))
    specs = rig_cameras(simulation.street, CAMERAS, WIDTH, HEIGHT)
    clip = Clip(
        "drive", "drive", 5.0, CAMERAS, np.where(number[:, None, None, None, None] < T, rendered, 0).astype(np.uint8),
        empty, np.ones((STEPS, 2), bool), np.stack([one.camera.intrinsic_matrix() for one in specs.values()]),
        np.concatenate([one.ego_SE3_camera.matrix() for one in specs.values()]), poses,
        ClipBoxes(number, 0 * number, 0 * number, np.stack(lead), sizes),
    )  # fmt: skip
    options = ClipRolloutOptions(SamplerSettings(2), seed=simulation.seed)
    frames = list(roll_out_clip(opened.network, opened.codec, clip, opened.style, T, T, options))
    assert [one.frame for one in frames] == list(range(T, STEPS))
    for one in frames:
        assert views_with_boxes(clip, one.frame).tolist() == [True, False]
        np.testing.assert_array_equal(rendered[one.frame], one.images)
    assert renderer.counts == {"generated": 4, "kept": 4, "seeds": 10, "fallback": 0, "without_network": 0}


def backgrounds(renderer: GeneratedRenderer, simulation: Simulation, snapshot: Snapshot) -> UInt8:
    """Return what the model renders at the cameras, without any renderer of the simulator."""
    ego = ego_pose(simulation.street, snapshot)
    images = []
    for name, spec in rig_cameras(simulation.street, CAMERAS, WIDTH, HEIGHT).items():
        view = RenderView(
            path="view.png", group="test", scene_id="straight", traversal_id="drive-1", frame_index=0, camera=name,
            timestamp_ns=0, light="day", weather="clear", **spec.camera.to_row(),
            world_SE3_camera=ego @ spec.ego_SE3_camera,
        )  # fmt: skip
        images.append(np.floor(255.0 * FlatStreet().render(view).rgb + 0.5).astype(np.uint8))
    return np.stack(images)


def test_seeds_are_those_of_the_composed_street_and_show_the_car(opened: SceneGenerator, models: Path) -> None:
    simulation = start()
    renderer = renderer_of(simulation, opened, models)
    snapshots, images = drive(simulation, renderer, T)
    other = start()
    plain = renderer_of(other, opened, models)._base
    for snapshot, shown in zip(snapshots, images):
        composed = plain.render(snapshot, CAMERAS)
        np.testing.assert_array_equal(shown, np.stack([composed[name] for name in CAMERAS]))
        empty = backgrounds(renderer, simulation, snapshot)
        assert np.abs(shown[0].astype(int) - empty[0]).max() > 20


def test_frames_without_agents_run_no_network_and_a_gap_begins_again(opened: SceneGenerator, models: Path) -> None:
    simulation = start()
    renderer = renderer_of(simulation, opened, models)
    drive(simulation, renderer, T)
    passes = passes_of(opened.network)
    try:
        here = simulation.now
        gone = replace(here, states=replace(here.states, present=np.zeros(1, bool)))
        shown = renderer.render(gone, CAMERAS)
        assert passes == [] and renderer.counts["without_network"] == 1
        np.testing.assert_array_equal(
            np.stack([shown[name] for name in CAMERAS]), backgrounds(renderer, simulation, gone)
        )
        # The car is back: one view, in two steps of the sampler.
        simulation.advance(Controls(0.0, 0.0))
        first = renderer.render(simulation.now, CAMERAS)
        assert passes == [1, 1]
        again = renderer.render(simulation.now, CAMERAS)
        assert passes == [1, 1]
        np.testing.assert_array_equal(first["front_wide"], again["front_wide"])
        for _ in range(2):
            simulation.advance(Controls(0.0, 0.0))
        renderer.render(simulation.now, CAMERAS)
        assert renderer.counts["seeds"] == 2 * (T + 1) and passes == [1, 1]
    finally:
        opened.network._forward_hooks.clear()


def test_agents_of_other_classes_are_refused_or_shown_composed(opened: SceneGenerator, models: Path) -> None:
    simulation = start()
    agents = tuple(replace(one, category="streetcar") for one in simulation.now.agents)
    simulation.world.now = replace(simulation.now, agents=agents)
    with pytest.raises(UsageError) as caught:
        renderer_of(simulation, opened, models)
    assert "streetcar" in str(caught.value) and "--fallback reconstructed" in (caught.value.remedy or "")
    renderer = renderer_of(simulation, opened, models, falls_back=True)
    snapshots, images = drive(simulation, renderer, T + 1)
    composed = renderer._base.render(snapshots[-1], CAMERAS)
    np.testing.assert_array_equal(images[-1][0], composed["front_wide"])
    assert renderer.counts["fallback"] == 1 and renderer.counts["generated"] == 0


def test_all_cameras_are_asked_for_at_once(opened: SceneGenerator, models: Path) -> None:
    simulation = start()
    renderer = renderer_of(simulation, opened, models)
    with pytest.raises(UsageError, match="front_wide"):
        renderer.render(simulation.now, CAMERAS[:1])
    cameras = rig_cameras(simulation.street, CAMERAS[:1], WIDTH, HEIGHT)
    cameras |= rig_cameras(simulation.street, CAMERAS[1:], 2 * WIDTH, 2 * HEIGHT)
    with pytest.raises(UsageError, match="24 x 16 px, 48 x 32 px"):
        renderer._choice.open(cameras)


def test_the_verb_drives_at_the_rate_of_the_training_and_repeats(
    model: Path, models: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    method = ["--method", f"{tmp_path / 'method.py'}:METHOD"]
    words = ["synth:tiny", str(model), *method, "--generator", str(models), "--cameras", "front_wide,rear"]
    words += ["--width", str(WIDTH), "--height", str(HEIGHT), "--sampler-steps", "1"]
    first, again = tmp_path / "first", tmp_path / "again"
    chosen = ["--scenario", "free-traffic", "--policy", "stop", "--duration", "1.6"]
    assert main([*words, *chosen, "--out", str(first), "--json"]) == ExitCode.DONE
    printed = json.loads(capsys.readouterr().out)
    assert main([*words, "--replay", str(first), "--out", str(again), "--json"]) == ExitCode.DONE
    rollouts = [read_rollout(folder) for folder in (first, again)]
    # The scenario has ten steps in a second, the clips of the training had five frames.
    assert rollouts[0].rate_hz == 5.0 and rollouts[0].world == "generated" and rollouts[0].steps == 8
    views = rollouts[0].views
    assert views is not None and views == printed["views"]
    assert views["seeds"] == 2 * T and sum(views.values()) - views["without_network"] == 2 * 9
    assert rollouts[0].files["video.mp4"] == rollouts[1].files["video.mp4"]
    assert rollouts[0].views == rollouts[1].views
    assert main([*words, *chosen, "--hz", "10", "--out", str(tmp_path / "fast")]) == ExitCode.DONE
    assert "generated at 10 Hz, the generator was trained at 5 Hz" in capsys.readouterr().out
    assert read_rollout(tmp_path / "fast").rate_hz == 10.0
    assert rollouts[0].hash != rollouts[0].model_copy(update={"views": None}).hash


def test_what_does_not_fit_is_refused_before_the_drive(model: Path, models: Path, tmp_path: Path) -> None:
    method = ["--method", f"{tmp_path / 'method.py'}:METHOD", "--scenario", "free-traffic", "--policy", "stop"]
    small = ["--width", str(WIDTH), "--height", str(HEIGHT)]
    out = tmp_path / "out"
    for words, message in (
        ([str(model), *method, "--renderer", "generated", *small], "needs a generator"),
        ([*method[2:], "--generator", str(models), *small], "needs a model"),
        ([str(model), *method, "--blend", "none", *small], "generated road users"),
        ([str(model), *method, "--hz", "5", *small], "generated road users"),
        ([str(model), *method, "--generator", str(models), "--hz", "0", *small], "0 Hz"),
        ([str(model), *method, "--generator", str(tmp_path), *small], "no such file"),
        ([str(model), *method, "--generator", str(models), "--width", "25", "--height", "16"], "25 x 16 px"),
        ([str(model), *method, "--generator", str(models), "--renderer", "reconstructed"], "has no generator"),
    ):
        with pytest.raises(UsageError) as caught:
            main(["synth:tiny", *words, "--out", str(out)])
        assert message in str(caught.value)
    assert not (out / "run.json").exists()


def test_an_environment_generates_its_observations(model: Path, models: Path, tmp_path: Path) -> None:
    env = StreetEnv(
        "synth:tiny", "free-traffic", CAMERAS, width_px=WIDTH, height_px=HEIGHT, model=model, generator=models,
        method=f"{tmp_path / 'method.py'}:METHOD",
    )  # fmt: skip
    assert env.metadata["render_fps"] == 5.0
    first, _ = env.reset(seed=3)
    observations = [env.step(np.zeros(2))[0] for _ in range(T + 1)]
    again, _ = env.reset(seed=3)
    repeated = [env.step(np.zeros(2))[0] for _ in range(T + 1)]
    for one, other in zip([first, *observations], [again, *repeated]):
        np.testing.assert_array_equal(one["cameras"]["front_wide"], other["cameras"]["front_wide"])
    assert env.rendered == 2 * (T + 2)
