"""Harmonics against the polynomials that Gaussian splatting writes out, and their gradients."""

import math

import numpy as np
import torch

from hybridworldsim.rasterizer.reference import spherical_harmonics


def _polynomials(x, y, z):
    one = torch.ones_like(x)
    q = math.pi
    return [
        0.5 / math.sqrt(q) * one,
        -math.sqrt(3 / (4 * q)) * y, math.sqrt(3 / (4 * q)) * z, -math.sqrt(3 / (4 * q)) * x,
        math.sqrt(15 / (4 * q)) * x * y, -math.sqrt(15 / (4 * q)) * y * z,
        math.sqrt(5 / (16 * q)) * (3 * z * z - 1),
        -math.sqrt(15 / (4 * q)) * x * z, math.sqrt(15 / (16 * q)) * (x * x - y * y),
        -math.sqrt(35 / (32 * q)) * y * (3 * x * x - y * y), math.sqrt(105 / (4 * q)) * x * y * z,
        -math.sqrt(21 / (32 * q)) * y * (5 * z * z - 1), math.sqrt(7 / (16 * q)) * z * (5 * z * z - 3),
        -math.sqrt(21 / (32 * q)) * x * (5 * z * z - 1), math.sqrt(105 / (16 * q)) * z * (x * x - y * y),
        -math.sqrt(35 / (32 * q)) * x * (x * x - 3 * y * y),
    ]  # fmt: skip


def test_harmonics_are_the_polynomials_of_gaussian_splatting():
    random = torch.Generator().manual_seed(1)
    directions = torch.randn(50, 3, generator=random, dtype=torch.float64) * 7.0
    coefficients = torch.randn(50, 16, 3, generator=random, dtype=torch.float64)
    units = directions / directions.norm(dim=-1, keepdim=True)
    basis = torch.stack(_polynomials(*units.unbind(-1)), dim=-1)
    for degree in range(4):
        some = (degree + 1) ** 2
        expected = torch.einsum("mk,mkc->mc", basis[:, :some], coefficients[:, :some])
        assert torch.allclose(spherical_harmonics(degree, directions, coefficients), expected, rtol=0, atol=1e-13)


def test_harmonics_are_orthonormal_to_degree_four():
    count = 40
    nodes, weights = map(torch.from_numpy, np.polynomial.legendre.leggauss(count))
    angles = (torch.arange(count, dtype=torch.float64) + 0.5) * 2 * math.pi / count
    ring = (1 - nodes**2).sqrt()[:, None]
    directions = torch.stack(
        [ring * angles.cos(), ring * angles.sin(), nodes[:, None].expand(-1, count)], dim=-1
    ).reshape(-1, 3)
    basis = spherical_harmonics(4, directions, torch.eye(25, dtype=torch.float64).expand(len(directions), 25, 25))
    measure = (weights[:, None] * 2 * math.pi / count).expand(-1, count).reshape(-1, 1)
    assert torch.allclose(basis.T @ (measure * basis), torch.eye(25, dtype=torch.float64), atol=1e-12)


def test_harmonics_pass_gradcheck():
    random = torch.Generator().manual_seed(2)
    directions = torch.randn(3, 3, generator=random, dtype=torch.float64, requires_grad=True)
    coefficients = torch.randn(3, 16, 3, generator=random, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda d, c: spherical_harmonics(3, d, c), (directions, coefficients))


def test_a_direction_of_zero_gives_numbers_and_no_gradient():
    directions = torch.tensor([[0.0, 0.0, 0.0], [1e-30, 0.0, 0.0]], requires_grad=True)
    colours = spherical_harmonics(3, directions, torch.ones(2, 16, 3))
    colours.sum().backward()
    assert colours.isfinite().all()
    assert directions.grad.isfinite().all()
    assert (directions.grad[0] == 0.0).all()


def test_no_directions_give_no_colours():
    assert spherical_harmonics(2, torch.zeros(0, 3), torch.zeros(0, 9, 3)).shape == (0, 3)
