"""A street that is trained by plain torch, or with dense Adam, as on a GPU, ends as one that is trained on the CPU."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace

import numpy as np
import pytest
import torch

from hybridworldsim.kernels.dispatch import plain_torch
from hybridworldsim.model.initialization import initial_street
from hybridworldsim.model.losses import colour_loss
from hybridworldsim.model.settings import Settings
from hybridworldsim.model.trainer import StreetTrainer
from hybridworldsim.training.block_training import psnr_db
from tests.training.street import SETTINGS, Painted, initial, views

STEPS = 200
IMAGES = [Painted()(one) for one in views()]


def trained(
    settings: Settings, steps: int, form: Callable[[], AbstractContextManager[None]] = nullcontext, dense: bool = False
) -> StreetTrainer:
    trainer = StreetTrainer(initial_street(initial(), settings), settings, dense=dense)
    with form():
        for step in range(steps):
            trainer.step(IMAGES[7 * step % len(IMAGES)], step / steps)
    return trainer


def mean_psnr_db(trainer: StreetTrainer) -> float:
    errors = [colour_loss(trainer.render(one.viewpoint).rgb, one.rgb, one.scored) for one in IMAGES]
    return float(np.mean([psnr_db(float(error)) for error in errors]))


def test_training_by_plain_torch_ends_as_by_the_kernels() -> None:
    """All losses, and three refinements. Measured with three seeds: 0.01, 0.02 and 0.03 dB."""
    settings = replace(SETTINGS, structure_weight=0.1)
    kernels, plain = trained(settings, STEPS), trained(settings, STEPS, plain_torch)
    assert len(kernels.street.background) == len(plain.street.background) > 300
    assert mean_psnr_db(kernels) > 28.0
    assert mean_psnr_db(plain) == pytest.approx(mean_psnr_db(kernels), abs=0.1)


def test_dense_adam_ends_as_lazy_adam() -> None:
    """Without refinements, which choose other anchors after the smallest difference. Measured: 0.01 dB at most."""
    settings = replace(SETTINGS, refinement=replace(SETTINGS.refinement, begin=0.995, end=1.0))
    assert mean_psnr_db(trained(settings, STEPS, dense=True)) == pytest.approx(
        mean_psnr_db(trained(settings, STEPS)), abs=0.05
    )


def test_a_restored_dense_training_continues_exactly() -> None:
    settings = replace(SETTINGS, refinement=replace(SETTINGS.refinement, least_steps=4))
    whole = trained(settings, 24, dense=True)
    first = StreetTrainer(initial_street(initial(), settings), settings, dense=True)
    for step in range(24):
        if step == 14:
            state = {name: tensor.clone() for name, tensor in first.state().items()}
            first = StreetTrainer(initial_street(initial(), settings), settings, dense=True)
            first.restore(state)
        first.step(IMAGES[7 * step % len(IMAGES)], step / 24)
    for (name, one), (_, other) in zip(whole.street.named_parameters(), first.street.named_parameters(), strict=True):
        assert torch.equal(one, other), name
