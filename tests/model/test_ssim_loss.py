"""The structure loss, compared with its formula in float64, and its gradient, compared with torch's."""

from __future__ import annotations

import pytest
import torch

from hybridworldsim.model.plain.losses import structural_similarity as plain_similarity
from hybridworldsim.model.ssim_loss import ssim


@pytest.mark.parametrize(("height", "width"), [(24, 31), (3, 2), (1, 1)])
def test_value_and_gradient_match_the_formula(height, width):
    torch.manual_seed(0)
    x, y, weights = torch.rand(height, width, 3), torch.rand(height, width, 3), torch.rand(height, width)
    x.requires_grad_()
    double = x.detach().double().requires_grad_()
    found, expected = ssim(x, y), plain_similarity(double, y.double())
    torch.testing.assert_close(found.double(), expected, rtol=1e-5, atol=3e-6)
    (gradient,) = torch.autograd.grad((found * weights).sum(), x)
    (reference,) = torch.autograd.grad((expected * weights).sum(), double)
    torch.testing.assert_close(gradient.double(), reference, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_a_constant_image_has_ssim_one_and_no_gradient(value):
    x = torch.full((20, 20, 3), value, requires_grad=True)
    found = ssim(x, x.detach().clone())
    torch.testing.assert_close(found, torch.ones(20, 20), rtol=0, atol=1e-4)
    found.sum().backward()
    assert x.grad is not None and x.grad.isfinite().all() and x.grad.abs().max() < 0.05
