"""Short trainings of a small street."""

from __future__ import annotations

from pathlib import Path

from hybridworldsim.training.block_training import Options, train_block
from hybridworldsim.training.documents import Run, TrainingOutcome
from hybridworldsim.training.parameters import write_parameters
from hybridworldsim.training.run.budget import Budget
from hybridworldsim.training.run.folder import RunFolder
from tests.training.street import Painted, trainer, views

RUN = Run(
    method="hybridworldsim",
    settings={"latent": 16},
    seed=0,
    steps=60,
    core_minutes=None,
    threads=1,
    scene="s",
    split="novel",
    block="whole",
    origin_m=(0.0, 0.0, 0.0),
    radius_m=30.0,
    width_px=32,
    half=False,
    dataset_hash="0",
    plan_hash="0",
    settings_hash="0",
    depth=None,
    points=None,
    pictures=12,
    sources=(),
)


def block_folder(path: Path) -> RunFolder[TrainingOutcome]:
    return RunFolder(path, TrainingOutcome)


def run(
    path: Path, steps: int = 60, images: Painted | None = None, options: Options | None = None, **more
) -> TrainingOutcome:
    folder = block_folder(path)
    folder.begin(RUN)
    trained = more.pop("trainer", None) or trainer()
    half = more.pop("half", False)
    return train_block(
        trained,
        images or Painted(),
        more.pop("views", views()),
        Budget(steps=steps),
        folder,
        lambda path: write_parameters(path, trained.model, half=half),
        options=options,
        **more,
    )
