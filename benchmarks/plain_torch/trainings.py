"""Trainings that must end alike: by dense and lazy Adam, and from images on by the kernels and by plain torch."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import torch

from benchmarks.gpu.machine import Machine
from benchmarks.gpu.streets import choose_street, make_street
from benchmarks.plain_torch.scene import (
    FORMS,
    EveryRow,
    Variant,
    add_noise,
    points_apart,
    prepare_block,
    train_street,
)  # fmt: skip
from benchmarks.report import OUT
from hybridworldsim.model.initialization import initial_street
from hybridworldsim.model.losses import colour_loss
from hybridworldsim.model.trainer import StreetTrainer
from hybridworldsim.training.block_training import psnr_db
from tests.training.street import SETTINGS, Painted, initial, views

STEPS: Final = 200
ADAM_BAR_DB: Final = 0.05
FORM_BAR_DB: Final = 0.1


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
        base = _train_wall(seed, dense=False)
        ends = (
            _train_wall(seed, dense=True),
            _train_wall(seed, dense=False, skips=True),
            _train_wall(seed, dense=False, noise=1e-6),
        )
        apart.append([end - base for end in ends])
        print(f"seed {seed}: {base:.2f} dB; " + ", ".join(f"{one:+.3f}" for one in apart[-1]), flush=True)
    _print_means(names, apart)
    return bool(abs(np.mean(apart, axis=0)[0]) <= ADAM_BAR_DB)


def _train_wall(seed: int, *, dense: bool, skips: bool = False, noise: float = 0.0) -> float:
    """Train the street of the tests; return the mean PSNR of its images then."""
    settings = replace(SETTINGS, structure_weight=0.1, seed=seed)
    street, images = initial_street(initial(), settings), [Painted()(one) for one in views()]
    add_noise(street.background.offsets, noise, seed)
    trainer = StreetTrainer(street, settings, dense=dense)
    if not skips:
        trainer._visibility = EveryRow()
    for step in range(STEPS):
        trainer.step(images[7 * step % len(images)], step / STEPS)
    errors = [colour_loss(trainer.render(one.viewpoint).rgb, one.rgb, one.scored) for one in images]
    return float(np.mean([psnr_db(float(error)) for error in errors]))


def compare_forms(machine: Machine, seeds: int, width_px: int) -> bool:
    """Train a tiny street from its images on by either form, and print how far the ends are apart.

    Layers of depth, points and sky are made by each form, then a street is trained for 200 steps with each seed, with
    lazy Adam, which the CPU has. A training in plain torch with dense Adam is that of a GPU. Two more trainings by the
    kernels show what else moves the end: a start that differs in the seventh digit, and all rows in view decoded at
    each visit.

    Returns:
        Whether plain torch ends within its bar of the kernels, in the mean over the seeds.
    """
    torch.set_num_threads(1)
    street = choose_street(machine, None)
    make_street(street)
    blocks = {}
    for form in FORMS:
        begin = time.process_time()
        blocks[form] = prepare_block(street, form, width_px, STEPS, OUT / "plain_torch" / f"layers-{form}")
        print(f"layers by {form}: {time.process_time() - begin:.0f} s of processor time", flush=True)
    print(points_apart(blocks["kernels"].initial, blocks["torch"].initial))
    names = ("torch", "torch with dense Adam", "kernels from a start 1e-6 apart", "kernels that skip no hidden rows")
    variants = (Variant("torch"), Variant("torch", dense=True), Variant(noise=1e-6), Variant(skips=False))
    print(f"{STEPS} steps of a street of {len(blocks['kernels'].views)} images, {width_px} px; dB from the kernels")
    apart = []
    for seed in range(seeds):
        base = train_street(blocks["kernels"], Variant(), STEPS, seed)
        apart.append([train_street(blocks[one.form], one, STEPS, seed) - base for one in variants])
        print(f"seed {seed}: {base:.2f} dB; " + ", ".join(f"{one:+.3f}" for one in apart[-1]), flush=True)
    _print_means(names, apart)
    return bool(abs(np.mean(apart, axis=0)[0]) <= FORM_BAR_DB)


def _print_means(names: Sequence[str], apart: Sequence[Sequence[float]]) -> None:
    """Print the mean and the spread of each column of differences (seeds, names)."""
    for name, column in zip(names, np.array(apart).T, strict=True):
        spread = column.std(ddof=1) if len(column) > 1 else 0.0
        print(f"{name}: {column.mean():+.3f} dB in the mean, {spread:.3f} by seed")
