"""Distillation: the student's few steps end where the teacher's many do; resumption; the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor, nn

from hybridworldsim.generation.clips.folder import write_clip
from hybridworldsim.generation.command import main
from hybridworldsim.generation.inference.frame_sampler import SamplerSettings, sample_frame
from hybridworldsim.generation.model_files import read_generator, trained_rates
from hybridworldsim.generation.sampling.flow import TIMESTEPS, noise_levels
from hybridworldsim.generation.sampling.sampler import sample
from hybridworldsim.generation.training.distillation import (
    ConsistencyLoss,
    DistillationSettings,
    DistillationTrainer,
    segment_end,
)
from hybridworldsim.generation.training.distillation_run import DistillationOptions, distil_on_clips
from hybridworldsim.generation.training.generator_trainer import GeneratorSettings
from hybridworldsim.generation.training.windows import WindowBatch
from mirror.errors import DatasetError, ExitCode, UsageError
from mirror.progress import NullProgress
from tests.generation.builders import make_network
from tests.generation.clips import make_clip, write_clips
from tests.generation.trained import NETWORK
from tests.interruption import InterruptingProgress

STEPS, SEGMENTS = 16, 4


def test_segments_contain_their_upper_end() -> None:
    levels = torch.tensor([1.0, 0.76, 0.75, 0.5, 0.26, 0.25, 1 / 16])
    expected = torch.tensor([0.75, 0.75, 0.5, 0.25, 0.25, 0.0, 0.0])
    assert torch.equal(segment_end(levels, 4), expected)
    every = torch.arange(1, 33) / 32
    ends = segment_end(every, 4)
    assert ((ends < every) & (every <= ends + 0.25 + 1e-6)).all()


class Linear(nn.Module):
    """A velocity that is a factor of the latents, a factor for each level; it has the interface of the network."""

    def __init__(self, factors: Tensor) -> None:
        super().__init__()
        self.factors = nn.Parameter(factors)
        self.config = SimpleNamespace(reference_channels=1)

    def prepare(self, conditions: object) -> object:
        return conditions

    def forward(self, stacked: Tensor, steps: Tensor, prepared: object, reference_timestep: Tensor) -> Tensor:
        place = (steps / TIMESTEPS * STEPS).round().long()
        return self.factors[place][..., None, None, None] * stacked[:, :, :, :1]


def test_few_steps_of_the_student_end_where_many_of_the_teacher_do() -> None:
    """With a linear velocity the teacher's end is a product in closed form."""
    torch.manual_seed(0)
    teacher = Linear(torch.linspace(-1.5, -0.5, STEPS + 1))
    student = Linear(teacher.factors.detach().clone())
    settings = DistillationSettings(SEGMENTS, STEPS)
    loss = ConsistencyLoss(student, teacher, lambda: dict(student.named_parameters()), settings)  # type: ignore[arg-type]
    optimizer = torch.optim.Adam(student.parameters(), lr=0.02)
    for number in range(1500):
        for group in optimizer.param_groups:
            group["lr"] = 0.02 * (1.0 - number / 1500)
        clean = torch.randn(32, 1, 1, 1, 2, 2)
        batch = WindowBatch(clean, torch.zeros(32, 1, 1, 1, 2, 2), None, torch.ones(32, 1, 1))  # type: ignore[arg-type]
        level = (torch.randint(1, STEPS + 1, (32, 1, 1)) / STEPS).float()
        value = loss(batch, level, torch.zeros(32, 1, 1), torch.randn(32, 2, 1, 1, 2, 2))
        optimizer.zero_grad()
        value.backward()
        optimizer.step()
    factors = teacher.factors.detach()
    expected = torch.prod(1.0 - factors[1:] / STEPS)

    def jump(latents: Tensor, level: float) -> Tensor:
        return student.factors[round(level * STEPS)].detach() * latents

    few = sample(jump, torch.ones(1), noise_levels(SEGMENTS))
    assert abs(float(few / expected) - 1.0) < 2e-3

    # The teacher itself ends elsewhere in so few steps.
    def teacher_jump(latents: Tensor, level: float) -> Tensor:
        return factors[round(level * STEPS)] * latents

    assert abs(float(sample(teacher_jump, torch.ones(1), noise_levels(SEGMENTS)) / expected) - 1.0) > 0.02


@pytest.fixture
def trained(generator_models: Path) -> Path:
    """A folder with clips and the models that were trained on them, which tests do not change."""
    return generator_models


OPTIONS = DistillationOptions(
    steps=4, distillation=DistillationSettings(2, 4), settings=GeneratorSettings(batch=1, warmup=2)
)


def distil(trained: Path, out: Path, options: DistillationOptions = OPTIONS, progress: NullProgress | None = None):
    generator, autoencoder = (trained / "out" / part / "model.safetensors" for part in ("generator", "autoencoder"))
    return distil_on_clips(trained / "clips", generator, autoencoder, out, options, progress or NullProgress())


def test_an_interrupted_distillation_gives_the_same_bytes(trained: Path, tmp_path: Path) -> None:
    whole, outcome = distil(trained, tmp_path / "whole")
    assert outcome.steps == 4
    with pytest.raises(KeyboardInterrupt):
        distil(trained, tmp_path / "part", progress=InterruptingProgress(2))
    part, _ = distil(trained, tmp_path / "part")
    assert part.read_bytes() == whole.read_bytes()
    teacher, references = read_generator(trained / "out" / "generator" / "model.safetensors")
    student, same = read_generator(whole)
    assert (student.config, same) == (teacher.config, references)
    assert trained_rates(whole) == (5.0, 5.0)
    changed = [name for name, one in student.named_parameters() if not torch.equal(one, teacher.get_parameter(name))]
    assert len(changed) > 20
    with pytest.raises(UsageError, match="a run of other settings began here"):
        distil(trained, tmp_path / "part", replace(OPTIONS, seed=1))


def test_the_teacher_is_not_changed_and_the_student_begins_as_it(trained: Path) -> None:
    from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder
    from hybridworldsim.generation.layout.boxes import OWN_STYLE
    from hybridworldsim.generation.training.windows import ClipWindows
    from tests.generation.trained import CODEC, T

    torch.manual_seed(0)
    teacher = make_network(NETWORK).float()
    before = {name: one.detach().clone() for name, one in teacher.named_parameters()}
    windows = ClipWindows([make_clip()], TinyAutoencoder(CODEC), NETWORK, OWN_STYLE, T)
    settings = GeneratorSettings(NETWORK, T, batch=2, warmup=1)
    trainer = DistillationTrainer(settings, DistillationSettings(2, 8), teacher, windows, 3)
    for name, one in trainer.network.named_parameters():
        assert torch.equal(one, before[name]), name
    batch = windows.batch([0])
    noise = torch.randn(batch.target.shape)
    for number in range(3):
        assert trainer.step(number)["velocity"] > 0.0
    assert all(torch.equal(one, before[name]) for name, one in teacher.named_parameters())
    with torch.no_grad():
        sampled = sample_frame(
            trainer.averaged_network(), batch.references, batch.conditions, noise, SamplerSettings(steps=2)
        )
    assert torch.isfinite(sampled).all()


def test_the_command_and_its_refusals(trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["distil", str(trained / "clips"), str(trained / "out"), "--steps", "1", "--batch", "1"]
    assert main([*words, "--out", str(tmp_path / "out"), "--teacher-steps", "4", "--json"]) == ExitCode.DONE
    assert Path(json.loads(capsys.readouterr().out)["generator"]).is_file()
    small = ["--teacher-steps", "4", "--accumulate", "2", "--batch", "2", "--recompute", "--precision", "bf16"]
    assert main([*words[:-2], *small, "--out", str(tmp_path / "small"), "--json"]) == ExitCode.DONE
    settings = json.loads((tmp_path / "small" / "run.json").read_text())["settings"]
    assert (settings["accumulate"], settings["precision"], settings["recompute"]) == (2, "bf16", True)
    assert 0.0 < json.loads(capsys.readouterr().out)["loss"] < 10.0
    with pytest.raises(UsageError, match="in 3 segments"):
        main([*words, "--out", str(tmp_path / "other"), "--segments", "3"])
    with pytest.raises(UsageError, match="no such file"):
        main(["distil", str(trained / "clips"), str(tmp_path), "--steps", "1", "--out", str(tmp_path / "other")])
    with pytest.raises(DatasetError, match=r"no clips\.json"):
        main(["distil", str(tmp_path), str(trained / "out"), "--steps", "1", "--out", str(tmp_path / "other")])
    short = write_clips(tmp_path / "short", count=1)
    write_clip(short, make_clip(frames=5))
    with pytest.raises(DatasetError, match="the longest clip has 5 frames") as caught:
        main(["distil", str(short), str(trained / "out"), "--steps", "1", "--out", str(tmp_path / "other")])
    assert caught.value.file == str(short)
    with pytest.raises(UsageError, match="--seed: seed -1"):
        main([*words, "--out", str(tmp_path / "other"), "--seed", "-1"])
    assert not (tmp_path / "other").exists()
