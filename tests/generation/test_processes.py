"""Two processes that train one model, and that distil one."""

from __future__ import annotations

import os
import socket
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder
from hybridworldsim.generation.model_files import read_generator, write_autoencoder, write_generator
from hybridworldsim.generation.training.distillation import DistillationSettings
from hybridworldsim.generation.training.distillation_run import DistillationOptions, distil_on_clips
from hybridworldsim.generation.training.generator_trainer import GeneratorSettings
from hybridworldsim.generation.training.run import TrainingOptions, train_on_clips
from hybridworldsim.training.run.processes import Processes, join_processes
from mirror.errors import DatasetError, UsageError
from mirror.progress import NullProgress
from tests.generation.builders import make_network
from tests.generation.clips import write_clips
from tests.generation.trained import CODEC, NETWORK, T
from tests.processes import Running

SETTINGS = GeneratorSettings(NETWORK, T, batch=4, warmup=2, context_noise=0.3, drop_layout=0.5)


def train(folder: Path, out: Path, settings: GeneratorSettings) -> None:
    """Train a generator with a given autoencoder."""
    options = TrainingOptions(6, autoencoder=folder / "autoencoder.safetensors", settings=settings)
    train_on_clips(folder / "clips", out, options, NullProgress())


def distil(folder: Path, out: Path, settings: GeneratorSettings) -> None:
    """Distil a given generator."""
    options = DistillationOptions(4, DistillationSettings(2, 4), settings)
    files = (folder / f"{name}.safetensors" for name in ("teacher", "autoencoder"))
    distil_on_clips(folder / "clips", *files, out, options, NullProgress())


def train_and_distil(folder: str, *ports: str) -> None:
    """Train and distil in two processes: this one, which has computed nothing, and a fork of it."""
    # The first optimizer would import it, in both.
    import torch._dynamo  # noqa: F401

    second = os.fork()
    os.environ["RANK"] = "0" if second else "1"
    for name, make, port in zip(("trained", "distilled"), (train, distil), ports):
        os.environ["MASTER_PORT"] = port
        make(Path(folder), Path(folder, name), SETTINGS)
    sys.exit(second and os.waitpid(second, 0)[1])


@pytest.fixture(scope="module")
def together(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with clips and models, and what two processes made of them."""
    folder = tmp_path_factory.mktemp("together")
    write_clips(folder / "clips")
    torch.manual_seed(0)
    write_autoencoder(folder / "autoencoder.safetensors", TinyAutoencoder(CODEC))
    write_generator(folder / "teacher.safetensors", make_network(NETWORK).float(), T)
    with socket.socket() as one, socket.socket() as two, pytest.MonkeyPatch.context() as patch:
        for free in (one, two):
            free.bind(("127.0.0.1", 0))
        ports = [str(free.getsockname()[1]) for free in (one, two)]
        patch.setenv("WORLD_SIZE", "2")
        patch.setenv("MASTER_ADDR", "127.0.0.1")
        running = Running(train_and_distil, folder, *ports)
    with running as first, first.reading() as said:
        assert first.wait() == 0, said()
    return folder


@pytest.mark.parametrize(("name", "inner"), [("trained", "generator/"), ("distilled", "")])
def test_two_processes_make_the_model_of_one(together: Path, tmp_path: Path, name: str, inner: str) -> None:
    """One process that computes the same parts one after another has the same gradients, up to rounding."""
    make = train if name == "trained" else distil
    make(together, tmp_path / name, replace(SETTINGS, accumulate=2))
    (two, _), (one, _) = (read_generator(root / name / f"{inner}model.safetensors") for root in (together, tmp_path))
    begun = dict(make_network(NETWORK).float().named_parameters())
    for (place, found), expected in zip(two.named_parameters(), one.parameters(), strict=True):
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5, msg=place)
        if name == "distilled" and place == "proj_out.weight":
            assert float((found - begun[place]).detach().abs().max()) > 1e-4
    assert '"processes": 2' in (together / name / f"{inner}run.json").read_text()


def test_the_others_hear_that_the_leading_process_stopped() -> None:
    """The flag of the leading process, as the others receive it."""
    said: list[bool] = []

    class Leader(Processes):
        def any(self, flag: bool) -> bool:
            said.append(flag)
            return flag

    class Other(Processes):
        def any(self, flag: bool) -> bool:
            return True

    with pytest.raises(KeyboardInterrupt), Leader(0, 2).leader_first():
        raise KeyboardInterrupt
    with Leader(0, 2).leader_first():
        assert said == [True]
    assert said == [True, False, False]
    with pytest.raises(DatasetError, match="the leading process stopped"), Other(1, 2).leader_first():
        pytest.fail("the block must not run")


def test_each_process_has_a_gpu_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """The machine of the tests has no GPU: what torch says of it is replaced, and no group is made."""
    chosen: list[int] = []
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "set_device", chosen.append)
    monkeypatch.setattr(torch.distributed, "init_process_group", lambda *_, **__: None)
    monkeypatch.setattr(torch.distributed, "destroy_process_group", lambda: None)
    for rank, device in (("0", "cuda:0"), ("1", "cuda:1")):
        for name, value in (("WORLD_SIZE", "3"), ("RANK", rank), ("LOCAL_RANK", rank)):
            monkeypatch.setenv(name, value)
        with join_processes("cuda") as processes:
            assert processes == Processes(int(rank), 3, device)
    assert chosen == [0, 1]
    monkeypatch.setenv("LOCAL_RANK", "2")
    with pytest.raises(UsageError, match="process 2 on a machine with 2 GPUs"), join_processes("cuda"):
        pass
