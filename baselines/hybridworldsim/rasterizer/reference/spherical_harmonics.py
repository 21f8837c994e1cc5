"""Real spherical harmonics with the signs and the order of Gaussian splatting."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def spherical_harmonics(degree: int, directions: Tensor, coefficients: Tensor, ids: Tensor | None = None) -> Tensor:
    """Evaluate sums of spherical harmonics in directions, such as the view-dependent colours of Gaussians.

    Args:
        degree: highest degree of the sum.
        directions: (M, 3) of any length; for a zero direction x, y and z are zero.
        coefficients: (N, K, C) with K >= (degree + 1)^2, ordered by degree, then by order.
        ids: (M,) int64 row of the coefficients for each direction; None: row i for direction i, with N = M.

    Returns:
        (M, C), without the offset of 0.5 of colours.
    """
    squares = directions.double().square().sum(-1, keepdim=True)
    known = squares > 0.0
    units = torch.where(known, directions.double(), 0.0) / torch.where(known, squares, 1.0).sqrt()
    basis = torch.stack(_basis(degree, *units.unbind(-1)), dim=-1)  # (M, (degree + 1)^2)
    if ids is not None:
        coefficients = coefficients[ids]
    return torch.einsum("mk,mkc->mc", basis, coefficients[:, : (degree + 1) ** 2].double())


def _basis(degree: int, x: Tensor, y: Tensor, z: Tensor) -> list[Tensor]:
    """Compute each harmonic of a unit vector: norm * P_l^m(z) * Re or Im (x + iy)^m, with the Condon-Shortley phase.

    P_l^m lacks its factor (1 - z^2)^(m/2), because the power of x + iy contains it.
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
        for l in range(m + 1, degree + 1):  # noqa: E741 - the usual symbol
            previous = legendre[l - 2, m] if l - 2 >= m else torch.zeros_like(z)
            legendre[l, m] = ((2 * l - 1) * z * legendre[l - 1, m] - (l + m - 1) * previous) / (l - m)
    return [
        _norm(l, abs(m)) * legendre[l, abs(m)] * (imaginary[-m] if m < 0 else real[m])
        for l in range(degree + 1)  # noqa: E741
        for m in range(-l, l + 1)
    ]


def _norm(l: int, m: int) -> float:  # noqa: E741
    return math.sqrt((2 - (m == 0)) * (2 * l + 1) / (4 * math.pi) * math.factorial(l - m) / math.factorial(l + m))
