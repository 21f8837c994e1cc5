"""Trainings that must end alike: by dense and lazy Adam, and by the verb in either form."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import Final

import numpy as np
import torch
from torch import Tensor

from benchmarks.gpu.machine import Machine
from benchmarks.gpu.streets import SPLIT, choose_street, make_street, read_training
from benchmarks.report import OUT
from hybridworldsim.kernels.dispatch import plain_torch
from hybridworldsim.model.initialization import initial_street
from hybridworldsim.model.losses import colour_loss
from hybridworldsim.model.trainer import StreetTrainer
from hybridworldsim.model.visibility_cache import VisibilityCache
from hybridworldsim.trainable.viewpoint import Viewpoint
from hybridworldsim.training.block_training import psnr_db
from mirror.cli.main import main as run_verb
from mirror.errors import DatasetError, ExitCode
from tests.training.street import SETTINGS, Painted, initial, views

STEPS: Final = 200
ADAM_BAR_DB: Final = 0.05
VERB_BAR_DB: Final = 0.1


class _EveryRow(VisibilityCache):
    """A record of nothing, so that every row in view is decoded at each visit, as on a GPU."""

    def record(self, viewpoint: Viewpoint, shown: Sequence[Tensor], numbers: Sequence[Tensor]) -> None:
        """Record nothing."""


def compare_adam(seeds: int) -> bool:
    """Train a street with three refinements by each Adam, and print how far the ends are apart.

    Lazy Adam decodes all rows in view here, as dense Adam does. Two more trainings show what else moves the end: the
    rows that the CPU skips because an image hid them, and a start that differs in the seventh digit.

    Returns:
        Whether dense Adam ends within its bar of lazy Adam, in the mean over the seeds.
    """
    # The images are tiny: a second thread would wait more than it computes.
    torch.set_num_threads(1)
    names = ("dense Adam", "lazy Adam that skips hidden rows", "lazy Adam from a start 1e-6 apart")
    apart = []
    print(f"{STEPS} steps with three refinements; dB from lazy Adam")
    for seed in range(seeds):
        base = _train_street(seed, dense=False)
        ends = (
            _train_street(seed, dense=True),
            _train_street(seed, dense=False, skips=True),
            _train_street(seed, dense=False, noise=1e-6),
        )
        apart.append([end - base for end in ends])
        print(f"seed {seed}: {base:.2f} dB; " + ", ".join(f"{one:+.3f}" for one in apart[-1]), flush=True)
    for name, column in zip(names, np.array(apart).T, strict=True):
        print(f"{name}: {column.mean():+.3f} dB in the mean, {column.std(ddof=1) if seeds > 1 else 0.0:.3f} by seed")
    return bool(abs(np.mean(apart, axis=0)[0]) <= ADAM_BAR_DB)


def _train_street(seed: int, *, dense: bool, skips: bool = False, noise: float = 0.0) -> float:
    """Train the street of the tests; return the mean PSNR of its images then."""
    settings = replace(SETTINGS, structure_weight=0.1, seed=seed)
    street, images = initial_street(initial(), settings), [Painted()(one) for one in views()]
    if noise:
        with torch.no_grad():
            random = torch.randn(street.background.offsets.shape, generator=torch.Generator().manual_seed(seed))
            street.background.offsets.add_(noise * random)
    trainer = StreetTrainer(street, settings, dense=dense)
    if not skips:
        trainer._visibility = _EveryRow()
    for step in range(STEPS):
        trainer.step(images[7 * step % len(images)], step / STEPS)
    errors = [colour_loss(trainer.render(one.viewpoint).rgb, one.rgb, one.scored) for one in images]
    return float(np.mean([psnr_db(float(error)) for error in errors]))


def compare_verbs(machine: Machine) -> bool:
    """Reconstruct a tiny street by either form, from images to a model; return whether both end within the bar."""
    street = choose_street(machine, None)
    make_street(street)
    ends = []
    for name, form in (("kernels", nullcontext), ("torch", plain_torch)):
        folder = OUT / "plain_torch" / name
        shutil.rmtree(folder, ignore_errors=True)
        words = [
            "reconstruct", str(street.dataset), "--split", SPLIT, "--initialise", "plane-sweep", "--steps", str(STEPS),
            "--width", "120", "--threads", "2", "--device", "cpu", "--out", str(folder / "model"),
            "--layers", str(folder / "layers"),
        ]  # fmt: skip
        with form():
            if run_verb(words) != ExitCode.DONE:
                raise DatasetError("mirror reconstruct failed", expected="0", remedy="see its message above")
        ends.append(read_training(folder / "model")[-1]["psnr_db"])
    apart = ends[1] - ends[0]
    print(
        f"{STEPS} steps of `mirror reconstruct --initialise plane-sweep`: {ends[0]:.2f} dB by kernels, {apart:+.3f} dB"
    )
    return abs(apart) <= VERB_BAR_DB
