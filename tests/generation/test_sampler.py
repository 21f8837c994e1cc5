"""The sampler against velocities that are known exactly."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from hybridworldsim.generation.sampling.flow import (
    add_noise,
    draw_levels,
    loss_weight,
    noise_levels,
    to_clean,
    to_noise,
)
from hybridworldsim.generation.sampling.sampler import draw_noise, guide, sample
from mirror.errors import UsageError


def gaussian_velocity(mean: float, deviation: float):
    """The expected velocity where clean latents are normal: E[noise - clean | noisy]."""

    def velocity(x: Tensor, level: float) -> Tensor:
        spread = (1 - level) ** 2 * deviation**2 + level**2
        rest = x - (1 - level) * mean
        return (level - (1 - level) * deviation**2) / spread * rest - mean

    return velocity


def exact_end(noise: Tensor, mean: float, deviation: float) -> Tensor:
    """Return where the flow leads: the marginals stay normal, so that noise is only scaled and moved."""
    return mean + deviation * noise


@pytest.mark.parametrize("steps", [1, 2, 4, 10])
@pytest.mark.parametrize("shift", [1.0, 3.0])
def test_a_single_clean_value_is_reached_exactly(steps: int, shift: float) -> None:
    noise = torch.randn(100, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    end = sample(gaussian_velocity(2.0, 0.0), noise, noise_levels(steps, shift))
    torch.testing.assert_close(end, torch.full_like(noise, 2.0), rtol=0, atol=1e-12)


@pytest.mark.parametrize("shift", [1.0, 3.0])
def test_the_error_falls_in_proportion_to_the_step(shift: float) -> None:
    noise = torch.randn(100, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    errors = []
    for steps in (50, 100, 200):
        end = sample(gaussian_velocity(2.0, 0.5), noise, noise_levels(steps, shift))
        errors.append(float((end - exact_end(noise, 2.0, 0.5)).abs().max()))
    assert errors[2] < 0.03
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.2)
    assert errors[1] / errors[2] == pytest.approx(2.0, abs=0.1)


def test_levels_are_shifted_once() -> None:
    assert noise_levels(4) == pytest.approx([1.0, 0.75, 0.5, 0.25, 0.0])
    # 3 l / (1 + 2 l), by hand.
    assert noise_levels(4, 3.0) == pytest.approx([1.0, 0.9, 0.75, 0.5, 0.0])


@pytest.mark.parametrize(("steps", "shift"), [(0, 1.0), (4, 0.0), (4, -1.0), (4, math.nan)])
def test_senseless_levels_are_refused(steps: int, shift: float) -> None:
    with pytest.raises(UsageError):
        noise_levels(steps, shift)


@pytest.mark.parametrize("levels", [[1.0], [0.0, 1.0], [1.0, 1.0, 0.0], [2.0, 0.0], [1.0, math.nan]])
def test_levels_that_do_not_fall_are_refused(levels: list[float]) -> None:
    with pytest.raises(UsageError, match="falling"):
        sample(gaussian_velocity(0.0, 1.0), torch.zeros(1), levels)


def test_quantities_of_a_velocity() -> None:
    generator = torch.Generator().manual_seed(0)
    clean, noise = torch.randn((2, 3, 1, 4, 4, 4), generator=generator, dtype=torch.float64)
    level = torch.rand((3, 1), generator=generator, dtype=torch.float64)
    noisy, velocity = add_noise(clean, noise, level), noise - clean
    torch.testing.assert_close(to_clean(noisy, velocity, level), clean)
    torch.testing.assert_close(to_noise(noisy, velocity, level), noise)


@pytest.mark.parametrize(("weighting", "of"), [("epsilon", to_noise), ("x0", to_clean)])
def test_weights_turn_the_loss_of_the_velocity_into_another(weighting: str, of) -> None:
    generator = torch.Generator().manual_seed(0)
    noisy, truth, guess = torch.randn((3, 5, 4, 4, 4), generator=generator, dtype=torch.float64)
    level = torch.rand(5, generator=generator, dtype=torch.float64)
    square = (guess - truth).square().mean(dim=(1, 2, 3)) * loss_weight(level, weighting)  # type: ignore[arg-type]
    other = (of(noisy, guess, level) - of(noisy, truth, level)).square().mean(dim=(1, 2, 3))
    torch.testing.assert_close(square, other)
    assert bool((loss_weight(level, "velocity") == 1.0).all())


def test_drawn_levels_are_a_mixture_of_two_logit_normals() -> None:
    levels = draw_levels((200_000,), torch.Generator().manual_seed(0))
    assert 0.0 < float(levels.min()) < float(levels.max()) <= 1.0

    def cdf(value: float) -> float:
        logit = math.log(value / (1 - value))
        return sum(
            share * 0.5 * (1 + math.erf((logit - mean) / math.sqrt(2))) for share, mean in ((0.7, 0.4), (0.3, 1.8))
        )

    for value in (0.2, 0.5, 0.8, 0.95):
        assert float((levels < value).float().mean()) == pytest.approx(cdf(value), abs=0.005)


def test_guidance_moves_away_from_the_unconditional_velocity() -> None:
    def conditional(x: Tensor, level: float) -> Tensor:
        return x + level

    def unconditional(x: Tensor, level: float) -> Tensor:
        return -x

    x = torch.tensor([1.0, 2.0])
    assert torch.equal(guide(conditional, unconditional, 1.0)(x, 0.5), conditional(x, 0.5))
    assert guide(conditional, unconditional, 3.0)(x, 0.5).tolist() == [-1 + 3 * 2.5, -2 + 3 * 4.5]


def test_noise_depends_on_all_seeds_and_on_nothing_else() -> None:
    torch.manual_seed(0)
    first = draw_noise((4, 4), (1, 2))
    torch.manual_seed(5)
    assert torch.equal(first, draw_noise((4, 4), (1, 2)))
    assert not torch.equal(first, draw_noise((4, 4), (2, 1)))
    assert not torch.equal(first, draw_noise((4, 4), (1, 3)))
