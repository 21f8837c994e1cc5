"""Costs of training a generator: counted without numbers, as real tensors have them; presets; device of clips."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from hybridworldsim.generation.commands.train import Train
from hybridworldsim.generation.network.configuration import SIZES, SMALL, TINY
from hybridworldsim.generation.network.transformer import Transformer
from hybridworldsim.generation.scenes.backgrounds import choose_background_device
from hybridworldsim.generation.training.costs import TrainingCosts, count_costs, empty_conditions, measure_speed
from hybridworldsim.generation.training.generator_trainer import GeneratorSettings, predict_velocity
from mirror.errors import UsageError


def test_operations_are_those_of_a_step_with_real_tensors() -> None:
    config, views, size_px = replace(TINY, layers=3, cross_view_layers=(1,)), 2, (16, 24)
    settings = GeneratorSettings(network=config, batch=2)
    network, grid = Transformer(config), (4, 6)
    conditions = empty_conditions(config, size_px, views, "cpu", batch=2)
    references, noisy = (torch.randn(2, frames, views, config.latent_channels, *grid) for frames in (5, 1))
    with FlopCounterMode(display=False) as counter:
        found = predict_velocity(
            network, noisy, references, conditions, torch.zeros(2, 1, views), torch.zeros(2, 5, views)
        )
        found.sum().backward()
    counted = count_costs(settings, size_px, views)
    assert counted.operations == pytest.approx(counter.get_total_flops(), rel=0.05)
    assert counted.parameters == sum(one.numel() for one in network.parameters())
    twice = count_costs(replace(settings, accumulate=2), size_px, views)
    assert twice.operations == pytest.approx(counted.operations, rel=0.02) and twice.memory_bytes < counted.memory_bytes


def test_presets_have_the_sizes_that_they_state(tmp_path: Path) -> None:
    def settings(preset: str) -> GeneratorSettings:
        return Train(tmp_path, tmp_path, 1, preset=preset).settings  # type: ignore[arg-type]

    assert settings("tiny") == GeneratorSettings() and settings("small").network is SMALL
    assert SMALL.takes_size((256, 448)) and not TINY.takes_size((256, 448)) and set(SIZES) == {"tiny", "small"}
    costs = count_costs(replace(settings("small"), batch=1), (64, 96), 1)
    assert 55e6 < costs.parameters < 65e6


def test_costs_are_said_in_core_time_or_hours() -> None:
    costs = TrainingCosts(6_560_578, 1_050_000_000, 3.6e12)
    assert "6.6 million parameters: about 1.1 GB" in costs.describe(1000, "cpu", 1e9)
    assert "1.0 core-hours for 1000 steps" in costs.describe(1000, "cpu", 1e12)
    assert "30.0 minutes for 500 steps" in costs.describe(500, "cuda:0", 1e12)
    assert measure_speed("cpu") > 1e8


def test_backgrounds_that_are_no_models_are_made_on_the_cpu() -> None:
    chosen = choose_background_device(("exact:tiny",), "auto")
    assert chosen.name == "cpu" and chosen.reason == "--background exact:tiny takes no device"
    with pytest.raises(UsageError, match="exact:tiny takes no device"):
        choose_background_device(("exact:tiny",), "cuda:0")
