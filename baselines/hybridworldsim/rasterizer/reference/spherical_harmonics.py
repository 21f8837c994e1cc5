"""Real spherical harmonics, with the signs and the order that Gaussian splatting has."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def spherical_harmonics(degree: int, directions: Tensor, coefficients: Tensor, ids: Tensor | None = None) -> Tensor:
    """Sum spherical harmonics.

    Args:
        degree: highest degree that is summed.
        directions: (M, 3) of any length; of a direction of zero all three Cartesian factors are zero.
        coefficients: (N, K, C) with K >= (degree + 1)^2, ordered by degree, then by order.
        ids: (M,) int64 whose coefficients each direction takes; None: its own, N being M.

    Returns:
        (M, C), without the half that colours are shifted by.
    """
    squares = directions.double().square().sum(-1, keepdim=True)
    known = squares > 0.0
    units = torch.where(known, directions.double(), 0.0) / torch.where(known, squares, 1.0).sqrt()
    basis = torch.stack(_basis(degree, *units.unbind(-1)), dim=-1)  # (M, (degree + 1)^2)
    if ids is not None:
        coefficients = coefficients[ids]
    return torch.einsum("mk,mkc->mc", basis, coefficients[:, : (degree + 1) ** 2].double())


def _basis(degree: int, x: Tensor, y: Tensor, z: Tensor) -> list[Tensor]:
    """Each harmonic of a unit vector: norm * P_l^m(z) * Re or Im (x + iy)^m, Condon-Shortley phase included.

    P_l^m stands without its factor (1 - z^2)^(m/2), which the power of x + iy brings.
    """
    real, imaginary = [torch.ones_like(x)], [torch.zeros_like(x)]
    for _ in range(degree):
        real, imaginary = (
            [*real, x * real[-1] - y * imaginary[-1]],
            [*imaginary, x * imaginary[-1] + y * real[-1]],
        )
    legendre: dict[tuple[int, int], Tensor] = {}
    for m in range(degree + 1):
        legendre[m, m] = torch.full_like(z, (-1.0) ** m * math.prod(range(1, 2 * m, 2)))
        for l in range(m + 1, degree + 1):  # noqa: E741 - as every book has it
            below = legendre[l - 2, m] if l - 2 >= m else torch.zeros_like(z)
            legendre[l, m] = ((2 * l - 1) * z * legendre[l - 1, m] - (l + m - 1) * below) / (l - m)
    return [
        _norm(l, abs(m)) * legendre[l, abs(m)] * (imaginary[-m] if m < 0 else real[m])
        for l in range(degree + 1)  # noqa: E741
        for m in range(-l, l + 1)
    ]


def _norm(l: int, m: int) -> float:  # noqa: E741
    return math.sqrt((2 - (m == 0)) * (2 * l + 1) / (4 * math.pi) * math.factorial(l - m) / math.factorial(l + m))
