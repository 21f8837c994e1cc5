from __future__ import annotations

import math
from contextlib import nullcontext

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hybridworldsim.kernels.dispatch import plain_torch
from hybridworldsim.light.tone_curve import DARKEST, PIVOT, ToneCurve
from hybridworldsim.light.trained_response import TrainedResponse
from mirror.errors import UsageError
from tests.draws import draws


def curve(seed: int, count: int = 1) -> ToneCurve:
    curves = ToneCurve(count).double()
    with torch.no_grad():
        curves.slopes += torch.from_numpy(np.random.default_rng(seed).normal(0.0, 1.0, curves.slopes.shape))
    return curves


@settings(max_examples=draws(20))
@given(st.integers(0, 1000))
def test_every_curve_increases_has_an_inverse_and_keeps_the_pivot(seed: int) -> None:
    curves = curve(seed)
    light = torch.logspace(-3.4, 3.0, 400, dtype=torch.float64)
    values = curves(light, 0)
    assert (values.diff() > 0.0).all()
    inside = values > DARKEST
    torch.testing.assert_close(curves.invert(values, 0)[inside], light[inside], rtol=1e-9, atol=0.0)
    assert float(curves(torch.tensor([PIVOT], dtype=torch.float64), 0).detach()) == pytest.approx(PIVOT, rel=1e-12)


def test_gradients_of_curve_and_inverse_agree_with_differences() -> None:
    curves = curve(3, count=2)
    light = torch.tensor([0.003, 0.1, 0.4, 5.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x, _: curves(x, 1), (light, curves.slopes))
    assert torch.autograd.gradcheck(lambda x, _: curves.invert(x, 1), (light, curves.slopes))


def test_an_image_at_gain_one_of_an_untrained_camera_differs_by_vignetting_only() -> None:
    response = TrainedResponse(["front"])
    colours = torch.rand(31, 47, 3) * 0.9 + 0.05
    with torch.no_grad():
        response.falloff.fill_(0.0)
    torch.testing.assert_close(response(colours, "front", 0.0), colours, rtol=1e-4, atol=1e-5)


def test_the_response_is_its_closed_form() -> None:
    response = TrainedResponse(["front", "rear"]).double()
    with torch.no_grad():
        response.falloff[1] = 0.3
        response.white[1] = torch.tensor([0.3, 0.0, 0.0])
    colours = torch.full((3, 5, 3), 0.3, dtype=torch.float64)
    image = response(colours, "rear", math.log(1.7))
    # The curve before training is a power between the pivot and its shoulder.
    light = 0.18 * (0.3 / 0.18) ** 2.2
    for row, column in ((1, 2), (0, 0), (2, 4)):
        square = ((row - 1) ** 2 + (column - 2) ** 2) / (0.25 * (3 * 3 + 5 * 5))
        for channel, white in enumerate((0.2, -0.1, -0.1)):
            exposed = light * 1.7 * math.exp(white) / (1.0 + 0.3 * square) ** 2
            expected = 0.18 * (exposed / 0.18) ** (1.0 / 2.2)
            assert float(image[row, column, channel].detach()) == pytest.approx(expected, rel=1e-6)


def test_a_camera_that_was_not_trained_is_named() -> None:
    with pytest.raises(UsageError, match="no response of camera left") as refused:
        TrainedResponse(["front"]).row("left")
    assert refused.value.remedy


def test_the_compiled_response_is_the_plain_one_with_its_gradients() -> None:
    random = torch.Generator().manual_seed(3)
    response = TrainedResponse(["front", "rear"])
    with torch.no_grad():
        response.curve.slopes += 0.7 * torch.randn(response.curve.slopes.shape, generator=random)
        response.white += 0.1 * torch.randn(2, 3, generator=random)
        response.falloff += 0.2
    colours = (torch.rand(23, 37, 3, generator=random) ** 3).requires_grad_()
    weights = torch.rand(23, 37, 3, generator=random)
    found = []
    for plain in (False, True):
        with plain_torch() if plain else nullcontext():
            image = response(colours, "rear", 0.4)
            gradients = torch.autograd.grad((weights * image).sum(), [colours, *response.parameters()])
            found.append((image.detach(), *gradients))
    for compiled, plain_form in zip(*found):
        scale = float(plain_form.abs().max())
        torch.testing.assert_close(compiled, plain_form, rtol=2e-4, atol=2e-5 * scale)


def test_black_and_bright_pixels_have_finite_gradients() -> None:
    response = TrainedResponse(["front"])
    colours = torch.tensor([0.0, -0.1, 1e-9, 1.0, 4.0, 1e6]).repeat(3, 1)[..., None].repeat(1, 1, 3).requires_grad_()
    image = response(colours, "front", -3.0)
    image.sum().backward()
    assert image.isfinite().all() and colours.grad is not None and colours.grad.isfinite().all()
