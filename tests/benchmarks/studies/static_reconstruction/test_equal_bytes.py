"""Counted bytes of models, compared with models that are made."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.studies.static_reconstruction.choices import baseline_name
from benchmarks.studies.static_reconstruction.equal_bytes import count_parameters, with_equal_bytes
from benchmarks.studies.static_reconstruction.methods import BASELINES
from hybridworldsim.model.initialization import InitialGeometry, initial_street
from hybridworldsim.model.settings import AnchorRefinement, Settings
from hybridworldsim.trainable.viewpoint import Source
from mirror.arrays import Float64


def level(places: Float64) -> tuple[Float64, Float64]:
    return np.zeros(len(places)), np.tile((0.0, 0.0, 1.0), (len(places), 1))


@pytest.fixture
def initial() -> InitialGeometry:
    rng = np.random.default_rng(0)
    driven = np.column_stack([np.linspace(-20.0, 20.0, 30), np.zeros((30, 2))])
    sources = [Source(f"s.{drive}.0", "front_wide") for drive in "abcd"]
    return InitialGeometry(
        rng.uniform(-20.0, 20.0, (4000, 3)), rng.uniform(80.0, 90.0, (50, 3)), driven, level, 30.0, sources
    )


def numbers(model: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in model.parameters())


def test_numbers_of_our_model(initial: InitialGeometry) -> None:
    street = initial_street(initial, Settings())
    full = replace(
        Settings(),
        refinement=AnchorRefinement(
            max_anchors=len(street.background), most_ground=len(street.ground), most_sky=len(street.sky)
        ),
    )
    # The few latents of the sources are not counted.
    assert count_parameters(full) == numbers(street) - numbers(street.appearance)


@pytest.mark.parametrize("package", BASELINES, ids=lambda package: baseline_name(package))
def test_baselines_have_our_bytes(package: Any, initial: InitialGeometry) -> None:
    settings = with_equal_bytes(package.TUNED)
    counts, sizes = [], []
    for most in (1000, 2000):
        trainer = package.make(initial, replace(settings, seeding=replace(settings.seeding, most=most)))
        counts.append(len(trainer.model))
        sizes.append(numbers(trainer.model))
    each = (sizes[1] - sizes[0]) / (counts[1] - counts[0])
    full = sizes[0] + each * (settings.densification.most - counts[0])
    assert full == pytest.approx(count_parameters(Settings()), rel=1e-2)
