"""Trainings that must end alike: by dense and lazy Adam, and by the verb in either form."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np
import torch
from torch import Tensor

from benchmarks.gpu.machine import Machine
from benchmarks.gpu.splats import SOURCE, front_view, random_street
from benchmarks.gpu.streets import SPLIT, choose_street, make_street, read_training
from benchmarks.report import OUT
from benchmarks.street.benchmark import corridor
from hybridworldsim.kernels.dispatch import plain_torch
from hybridworldsim.model.losses import colour_loss
from hybridworldsim.model.settings import AnchorRefinement, Settings
from hybridworldsim.model.trainer import StreetTrainer
from hybridworldsim.model.visibility_cache import VisibilityCache
from hybridworldsim.trainable.training_image import TrainingImage
from hybridworldsim.trainable.viewpoint import Viewpoint
from mirror.cli.main import main as run_verb
from mirror.errors import DatasetError, ExitCode

STEPS: Final = 200
ADAM_BAR_DB: Final = 0.05
VERB_BAR_DB: Final = 0.1
_IMAGES: Final = 6
_SIZE_PX: Final = (96, 54)


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
    """Train on images of a random street; return the mean PSNR of these images then."""
    refinement = AnchorRefinement(begin=0.2, end=0.9, times=3, max_anchors=1_500, cells_m=(1.6, 0.4))
    settings = Settings(refinement=refinement, depth_weight=0.0, normal_weight=0.0, seed=seed)
    street, images = corridor(1_000, seed), _teach()
    with torch.no_grad():
        for node in street.nodes:
            node.codes.zero_()
        street.background.offsets.add_(noise * torch.randn_like(street.background.offsets))
    trainer = StreetTrainer(street, settings, dense=dense)
    if not skips:
        trainer._visibility = _EveryRow()
    for step in range(STEPS):
        trainer.step(images[5 * step % len(images)], step / STEPS)
    errors = [colour_loss(trainer.render(one.viewpoint).rgb, one.rgb, one.scored) for one in images]
    return float(np.mean([-10.0 * np.log10(float(error)) for error in errors]))


@cache
def _teach() -> list[TrainingImage]:
    """Render a random street from places along it."""
    street, images = random_street(9_000), []
    for number in range(_IMAGES):
        view = front_view(*_SIZE_PX)
        viewmat = view.viewmat.clone()
        viewmat[2, 3] -= 4.0 * number
        view = replace(view, viewmat=viewmat)
        with torch.no_grad():
            rgb = street(view, street.appearance(SOURCE)).rgb
        images.append(TrainingImage(view, rgb, torch.ones(rgb.shape[:2], dtype=torch.bool), None, None))
    return images


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
