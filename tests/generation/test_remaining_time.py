"""The time that a training run still needs, as it prints it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import pytest
import torch
from torch import Tensor

from hybridworldsim.generation.training import loop
from hybridworldsim.generation.training.loop import run_steps
from hybridworldsim.generation.training.run_folder import GenerationRunFolder
from mirror.progress import NullProgress

STEP_S = 90.0


class Clock:
    """A clock that moves when a step is done."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now


class Steps:
    """Something that is trained: a number that counts its steps, each of which takes 90 s."""

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


def minutes_left(lines: list[str]) -> dict[int, int]:
    """By number of steps."""
    found = [re.search(r"step (\d+)  .*, (\d+) minutes left", line) for line in lines]
    return {int(one[1]): int(one[2]) for one in found if one is not None}


def test_the_time_left_is_that_of_the_steps_left_also_after_a_pause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, lines = Clock(), Lines()
    monkeypatch.setattr(loop, "time", clock)
    folder = GenerationRunFolder(tmp_path / "run")
    folder.path.mkdir()
    with pytest.raises(RuntimeError, match="went down"):
        run_steps(Steps(clock, stop=4), 10, folder, lines, phase="test", checkpoint_s=0.0)
    # A night between the two calls is no part of the training.
    clock.now += 30_000.0
    run_steps(Steps(clock), 10, GenerationRunFolder(tmp_path / "run"), lines, phase="test")
    assert minutes_left(lines.lines) == {step: round((10 - step) * 1.5) for step in range(1, 11)}
