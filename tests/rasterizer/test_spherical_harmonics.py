"""Spherical harmonics by compiled kernels."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest
import torch
from torch import Tensor

from hybridworldsim.rasterizer.cpu.projection.ordered_output import PART
from hybridworldsim.rasterizer.cpu.spherical_harmonics import spherical_harmonics
from hybridworldsim.rasterizer.reference import spherical_harmonics as reference
from mirror.errors import UsageError


def inputs(number: int, count: int, dtype: torch.dtype = torch.float32) -> tuple[Tensor, Tensor]:
    random = torch.Generator().manual_seed(number)
    directions = 5.0 * torch.randn(number, 3, generator=random)
    coefficients = torch.randn(number, count, 3, generator=random)
    return directions.to(dtype).requires_grad_(), coefficients.to(dtype).requires_grad_()


@pytest.mark.parametrize("degree", range(5))
@pytest.mark.parametrize(("dtype", "bound"), [(torch.float32, 1e-6), (torch.float64, 1e-13)])
def test_kernels_give_what_the_reference_gives(degree: int, dtype: torch.dtype, bound: float) -> None:
    results = []
    for sums in (spherical_harmonics, reference):
        given = inputs(1003, 25, dtype)
        colors = sums(degree, *given)
        weights = torch.cos(torch.arange(colors.numel(), dtype=torch.float64)).reshape(colors.shape)
        to_given = torch.autograd.grad((colors * weights).sum(), given, allow_unused=True, materialize_grads=True)
        assert all(gradient.dtype == dtype for gradient in to_given)
        results.append([tensor.detach().double() for tensor in (colors, *to_given)])
    for ours, truth in zip(*results):
        assert (ours - truth).abs().max() <= bound * max(1.0, float(truth.abs().max()))


def test_gradients_against_differences() -> None:
    directions, coefficients = inputs(3, 25, torch.float64)
    assert torch.autograd.gradcheck(lambda *given: spherical_harmonics(4, *given), (directions, coefficients))


def test_known_values() -> None:
    pole = torch.tensor([[0.0, 0.0, 2.0]])
    one_each = torch.eye(9)[:, :, None].expand(9, 9, 3)
    values = spherical_harmonics(2, pole.expand(9, 3), one_each)[:, 0]
    expected = [0.5 / math.sqrt(math.pi), 0.0, math.sqrt(0.75 / math.pi), 0.0, 0.0, 0.0, math.sqrt(1.25 / math.pi)]
    assert torch.allclose(values, torch.tensor([*expected, 0.0, 0.0]), atol=1e-7)


def test_directions_of_no_or_any_length() -> None:
    directions, coefficients = inputs(32, 16)
    with torch.no_grad():
        directions[:8] = 0.0
        directions[8:16] *= 1e-30
        directions[16:24] *= 1e30
    colors = spherical_harmonics(3, directions, coefficients)
    assert (colors - reference(3, directions, coefficients)).abs().max() < 1e-5
    to_directions, to_coefficients = torch.autograd.grad(colors.sum(), (directions, coefficients))
    assert (to_directions[:8] == 0.0).all()
    assert not to_directions.isnan().any()
    assert to_coefficients.isfinite().all()


def test_bits_do_not_depend_on_the_number_of_threads() -> None:
    threads = torch.get_num_threads()
    results = []
    try:
        for number in (1, 3):
            torch.set_num_threads(number)
            given = inputs(2 * PART + 3, 9)
            colors = spherical_harmonics(2, *given)
            tensors = (colors.detach(), *torch.autograd.grad(colors.square().sum(), given))
            results.append([tensor.numpy().tobytes() for tensor in tensors])
    finally:
        torch.set_num_threads(threads)
    assert results[0] == results[1]


@pytest.mark.parametrize("number", [0, 1, 7, 8, 9])
def test_any_number_of_gaussians(number: int) -> None:
    given = inputs(number, 4)
    colors = spherical_harmonics(1, *given)
    assert colors.shape == (number, 3)
    colors.sum().backward()
    assert torch.allclose(colors.double(), reference(1, *given), atol=1e-6)


@pytest.mark.parametrize("taken", [[], [0], [7], [1, 2, 5, 6], range(8), range(3, 2 * PART, 3)])
def test_coefficients_of_some_of_all(taken: Sequence[int]) -> None:
    ids = torch.tensor(taken, dtype=torch.int64)
    directions, coefficients = inputs(8 if len(taken) <= 8 else 2 * PART, 9)
    results = []
    for colors in (
        spherical_harmonics(2, directions[ids], coefficients, ids),
        spherical_harmonics(2, directions[ids], coefficients[ids]),
    ):
        gradients = torch.autograd.grad(colors.square().sum(), (directions, coefficients))
        results.append((colors, *gradients))
    for some, own in zip(*results):
        assert torch.equal(some, own)


def test_wrong_shapes_are_refused() -> None:
    directions, coefficients = inputs(4, 9)
    with pytest.raises(UsageError, match="K >= 16"):
        spherical_harmonics(3, directions, coefficients)
    with pytest.raises(UsageError, match="degree 5"):
        spherical_harmonics(5, directions, coefficients)
