"""The time that a training run still needs, as it prints it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import pytest
import torch
from torch import Tensor

from hybridworldsim.generation.training.documents import GenerationOutcome
from hybridworldsim.generation.training.numbered import numbered_training
from hybridworldsim.training.run import budget, loop
from hybridworldsim.training.run.folder import RunFolder
from hybridworldsim.training.run.loop import train
from hybridworldsim.training.run.training import Training
from mirror.progress import NullProgress

STEP_S = 80.0


class Clock:
    """A clock that moves when a step is done."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now

    def process_time(self) -> float:
        return self.now


class Steps:
    """Something that is trained: a number that counts its steps, each of which takes 80 s."""

    def __init__(self, clock: Clock, stop: int | None = None) -> None:
        self._clock, self._stop, self._count = clock, stop, torch.zeros(1)

    def step(self, number: int) -> dict[str, float]:
        if number == self._stop:
            raise RuntimeError("the machine went down")
        self._clock.now += STEP_S
        self._count += 1.0
        return {"square": 1.0}

    def state(self) -> dict[str, Tensor]:
        return {"count": self._count.clone()}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        self._count = state["count"].clone()


class Lines(NullProgress):
    """Keeps the printed lines."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def report(self, text: str) -> None:
        self.lines.append(text)


def training(steps: Steps) -> Training[GenerationOutcome]:
    return numbered_training(
        steps, 10, lambda file: file.write_bytes(b"model"), phase="test", loss="square", checkpoint_s=0.0
    )


def minutes_left(lines: list[str]) -> dict[int, int]:
    """By number of steps."""
    found = [re.search(r"step (\d+)  .*, (\d+) minutes left", line) for line in lines]
    return {int(one[1]): int(one[2]) for one in found if one is not None}


def test_the_time_left_is_that_of_the_steps_left_also_after_a_pause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, lines = Clock(), Lines()
    for module in (loop, budget):
        monkeypatch.setattr(module, "time", clock)
    (tmp_path / "run").mkdir()
    with pytest.raises(RuntimeError, match="went down"):
        train(training(Steps(clock, stop=4)), RunFolder(tmp_path / "run", GenerationOutcome), lines)
    # A night between the two calls is no part of the training.
    clock.now += 30_000.0
    train(training(Steps(clock)), RunFolder(tmp_path / "run", GenerationOutcome), lines)
    assert minutes_left(lines.lines) == {step: round((10 - step) * STEP_S / 60.0) for step in range(1, 11)}
