"""Memory that runs out during a training: the error names what to lower, and the checkpoint continues the run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest
import torch

from hybridworldsim.training.block_training import Options
from hybridworldsim.training.run.exhaustion import STREET_REMEDY, exhausted_memory_named
from mirror.errors import DatasetError
from mirror.protocols.views.view import RenderView
from tests.training.short_run import run
from tests.training.street import Painted, trainer

STEPS = 40


@dataclass
class Exhausting(Painted):
    """Images of which one takes more memory than any machine has."""

    last: int = 20

    def __call__(self, one: RenderView) -> object:  # type: ignore[override]
        if self.opened == self.last:
            torch.zeros(1 << 50)
        return super().__call__(one)


def test_the_checkpoint_survives_exhausted_memory(tmp_path: Path) -> None:
    every_step = Options(checkpoint_s=0.0)
    whole = run(tmp_path / "whole", STEPS, options=every_step)
    with (
        pytest.raises(DatasetError, match=r"cpu: the device has too little memory; .*--width.*max_anchors") as caught,
        exhausted_memory_named("cpu", STREET_REMEDY, "memory for the tables"),
    ):
        run(tmp_path / "cut", STEPS, images=Exhausting(), options=every_step)
    assert isinstance(caught.value.__cause__, RuntimeError), "torch's own error of its allocator"
    assert (tmp_path / "cut" / "checkpoint.safetensors").is_file() and not (tmp_path / "cut" / "outcome.json").exists()
    continued = run(tmp_path / "cut", STEPS, trainer=trainer(), options=every_step)
    assert (continued.steps, continued.psnr_db) == (whole.steps, whole.psnr_db)


@pytest.mark.cuda
def test_exhausted_memory_of_a_gpu_is_named() -> None:
    named = exhausted_memory_named("cuda:0", STREET_REMEDY)
    with pytest.raises(DatasetError, match=r"cuda:0: the device has too little memory"), named:
        torch.empty(1 << 45, device="cuda:0")
