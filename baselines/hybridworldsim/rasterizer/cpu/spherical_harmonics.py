"""Real spherical harmonics by compiled kernels, eight Gaussians at a time, with gradients.

A harmonic is a polynomial of z times the real or imaginary part of (x + i y)^m, with the signs and the order that
Gaussian splatting has (Sloan, "Efficient Spherical Harmonic Evaluation", JCGT 2013).
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import torch
from numpy.polynomial import polynomial
from torch import Tensor
from torch.autograd.function import once_differentiable

from hybridworldsim.kernels import lanes
from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.memory import empty_aligned
from hybridworldsim.kernels.threads import in_parallel
from hybridworldsim.rasterizer.cpu.projection.ordered_output import PART
from hybridworldsim.rasterizer.cpu.projection.project import flat
from mirror.arrays import Float64
from mirror.errors import UsageError

DEGREE_MAX: Final = 4


def _polynomials() -> Float64:
    """(l, m, power of z): the associated Legendre polynomial without (1 - z^2)^(m / 2), normalised."""
    table = np.zeros((DEGREE_MAX + 1,) * 3)
    for l in range(DEGREE_MAX + 1):  # noqa: E741 - as every book has it
        # Rodrigues' formula
        legendre = polynomial.polypow([-1.0, 0.0, 1.0], l) / (2.0**l * math.factorial(l))
        for m in range(l + 1):
            derived = polynomial.polyder(legendre, l + m)
            turns = math.factorial(l - m) / math.factorial(l + m)
            norm = math.sqrt((2 - (m == 0)) * (2 * l + 1) / (4.0 * math.pi) * turns)
            table[l, m, : len(derived)] = (-1.0) ** m * norm * derived
    return table


_TABLE: Final = _polynomials()


def spherical_harmonics(degree: int, directions: Tensor, coefficients: Tensor, ids: Tensor | None = None) -> Tensor:
    """Sum spherical harmonics; differentiable to directions and coefficients.

    Args:
        degree: highest degree that is summed, 0 to 4.
        directions: (M, 3) of any length; of a direction of zero all three Cartesian factors are zero.
        coefficients: (N, K, 3) with K >= (degree + 1)^2, ordered by degree, then by order.
        ids: (M,) int64 whose coefficients each direction takes, ascending, each once; None: its own, N being M.

    Returns:
        (M, 3) of the coefficients' type, without the half that colours are shifted by.

    Raises:
        UsageError: coefficients of another shape, or fewer than the degree has.
    """
    if not 0 <= degree <= DEGREE_MAX:
        raise UsageError(f"no spherical harmonics of degree {degree}", place="degree", expected=f"0 to {DEGREE_MAX}")
    if coefficients.ndim != 3 or coefficients.shape[2] != 3 or coefficients.shape[1] < (degree + 1) ** 2:
        shape = f"(N, K, 3) with K >= {(degree + 1) ** 2}"
        raise UsageError(f"coefficients of shape {tuple(coefficients.shape)}", place="coefficients", expected=shape)
    summed: Tensor = _SphericalHarmonics.apply(directions, coefficients, ids, degree)
    return summed


@kernel(inline="always")
def _unit(directions: Any, rows: Any, start: Any, end: Any) -> Any:
    """Eight directions of length 1, or 0, and one over their lengths, or 0."""
    for lane in range(8):
        rows[lane] = start + lane if start + lane < end else start
    x, y, z = lanes.load_triples(directions, rows, 0)
    squared = x * x + y * y + z * z
    inverse = lanes.select(squared > 0.0, 1.0 / lanes.sqrt(squared), 0.0)
    return x * inverse, y * inverse, z * inverse, inverse


@kernel(inline="always")
def _basis(degree: Any, x: Any, y: Any, z: Any, basis: Any) -> None:
    """Write each harmonic of eight unit vectors."""
    real, imaginary = lanes.broadcast(1.0), lanes.broadcast(0.0)
    for m in range(degree + 1):
        for l in range(m, degree + 1):  # noqa: E741
            value = lanes.broadcast(_TABLE[l, m, l - m])
            for power in range(l - m - 1, -1, -1):
                value = value * z + _TABLE[l, m, power]
            lanes.store(basis, 8 * (l * l + l + m), value * real)
            if m > 0:
                lanes.store(basis, 8 * (l * l + l - m), value * imaginary)
        real, imaginary = x * real - y * imaginary, x * imaginary + y * real


@kernel()
def spherical_harmonics_part(
    degree: Any,
    directions: Any,
    coefficients: Any,
    ids: Any,
    begin: Any,
    end: Any,
    rows: Any,
    basis: Any,
    summed: Any,
) -> None:
    """Sum harmonics of a range.

    Args:
        degree: highest degree.
        directions: (3 M,) flat.
        coefficients: (N, K, 3).
        ids: (M,) rows of these, ascending.
        begin: first Gaussian.
        end: past the last.
        rows: (8,) int64, for its own use, as is `basis` (200,), of the coefficients' type.
        basis: see `rows`.
        summed: (M, 3) gets the sums.
    """
    count = (degree + 1) * (degree + 1)
    for start in range(begin, end, 8):
        x, y, z, _ = _unit(directions, rows, start, end)
        _basis(degree, x, y, z, basis)
        for lane in range(min(8, end - start)):
            own = coefficients[ids[start + lane]]
            red, green, blue = basis[lane] * own[0, 0], basis[lane] * own[0, 1], basis[lane] * own[0, 2]
            for k in range(1, count):
                weight = basis[8 * k + lane]
                red += weight * own[k, 0]
                green += weight * own[k, 1]
                blue += weight * own[k, 2]
            summed[start + lane, 0], summed[start + lane, 1], summed[start + lane, 2] = red, green, blue


@kernel()
def spherical_harmonics_part_backward(
    degree: Any,
    directions: Any,
    coefficients: Any,
    ids: Any,
    to_summed: Any,
    begin: Any,
    end: Any,
    rows: Any,
    basis: Any,
    to_basis: Any,
    to_directions: Any,
    to_coefficients: Any,
) -> None:
    """Gradients of a range.

    Args:
        degree: highest degree.
        directions: (3 M,) flat.
        coefficients: (N, K, 3).
        ids: (M,) rows of these, ascending.
        to_summed: (M, 3) gradient to the sums.
        begin: first Gaussian.
        end: past the last.
        rows: (8,) int64, for its own use, as are `basis` and `to_basis` (200,), of the coefficients' type.
        basis: see `rows`.
        to_basis: see `rows`.
        to_directions: (M + 8, 3) gets gradients, as does `to_coefficients` (N, K, 3), with zeros for rows between
            those that are used; what is past the last of these is left to the caller.
        to_coefficients: see `to_directions`.
    """
    count = (degree + 1) * (degree + 1)
    done = 0 if begin == 0 else ids[begin - 1] + 1
    for start in range(begin, end, 8):
        x, y, z, inverse = _unit(directions, rows, start, end)
        _basis(degree, x, y, z, basis)
        for lane in range(min(8, end - start)):
            row = ids[start + lane]
            for unused in range(done, row):
                to_unused = to_coefficients[unused]
                for k in range(coefficients.shape[1]):
                    to_unused[k, 0], to_unused[k, 1], to_unused[k, 2] = 0.0, 0.0, 0.0
            done = row + 1
            own, to_own = coefficients[row], to_coefficients[row]
            red, green, blue = to_summed[start + lane, 0], to_summed[start + lane, 1], to_summed[start + lane, 2]
            for k in range(count):
                weight = basis[8 * k + lane]
                to_own[k, 0], to_own[k, 1], to_own[k, 2] = weight * red, weight * green, weight * blue
                to_basis[8 * k + lane] = own[k, 0] * red + own[k, 1] * green + own[k, 2] * blue
            for k in range(count, coefficients.shape[1]):
                to_own[k, 0], to_own[k, 1], to_own[k, 2] = 0.0, 0.0, 0.0

        to_x, to_y, to_z = lanes.broadcast(0.0), lanes.broadcast(0.0), lanes.broadcast(0.0)
        real, imaginary = lanes.broadcast(1.0), lanes.broadcast(0.0)
        less_real, less_imaginary = lanes.broadcast(0.0), lanes.broadcast(0.0)
        for m in range(degree + 1):
            to_real, to_imaginary = lanes.broadcast(0.0), lanes.broadcast(0.0)
            for l in range(m, degree + 1):  # noqa: E741
                value, slope = lanes.broadcast(_TABLE[l, m, l - m]), lanes.broadcast(0.0)
                for power in range(l - m - 1, -1, -1):
                    slope = slope * z + value
                    value = value * z + _TABLE[l, m, power]
                to_even = lanes.load(to_basis, 8 * (l * l + l + m))
                to_real = to_real + value * to_even
                to_z = to_z + slope * to_even * real
                if m > 0:
                    to_odd = lanes.load(to_basis, 8 * (l * l + l - m))
                    to_imaginary = to_imaginary + value * to_odd
                    to_z = to_z + slope * to_odd * imaginary
            # d (x + i y)^m = m (x + i y)^(m - 1) (dx + i dy)
            to_x = to_x + m * (to_real * less_real + to_imaginary * less_imaginary)
            to_y = to_y + m * (to_imaginary * less_real - to_real * less_imaginary)
            less_real, less_imaginary = real, imaginary
            real, imaginary = x * real - y * imaginary, x * imaginary + y * real
        # a longer direction is the same direction
        outward = to_x * x + to_y * y + to_z * z
        lanes.store_triples(
            to_directions,
            start,
            inverse * (to_x - outward * x),
            inverse * (to_y - outward * y),
            inverse * (to_z - outward * z),
        )


class _SphericalHarmonics(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, directions: Tensor, coefficients: Tensor, ids: Tensor | None, degree: int) -> Tensor:
        dtype, number = coefficients.dtype, len(directions)
        taken = np.arange(number) if ids is None else ids.numpy()
        given = flat(directions, dtype), flat(coefficients, dtype).reshape(coefficients.shape), taken
        summed = empty_aligned(number * 3, given[0].dtype).reshape(number, 3)

        def one(part: int) -> None:
            span = part * PART, min((part + 1) * PART, number)
            spherical_harmonics_part(degree, *given, *span, np.empty(8, np.int64), np.empty(200, summed.dtype), summed)

        in_parallel(one, -(-number // PART))
        ctx.save_for_backward(directions, coefficients)
        ctx.taken, ctx.degree = taken, degree
        return torch.from_numpy(summed)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, None, None]:
        directions, coefficients = ctx.saved_tensors
        dtype, number = coefficients.dtype, len(directions)
        given = flat(directions, dtype), flat(coefficients, dtype).reshape(coefficients.shape), ctx.taken
        to_summed = flat(gradients[0], dtype).reshape(-1, 3)
        kind = given[0].dtype
        to_directions = empty_aligned((number + 8) * 3, kind).reshape(-1, 3)
        to_coefficients = empty_aligned(coefficients.numel(), kind).reshape(given[1].shape)

        def one(part: int) -> None:
            span = part * PART, min((part + 1) * PART, number)
            own = np.empty(8, np.int64), np.empty(200, kind), np.empty(200, kind)
            spherical_harmonics_part_backward(
                ctx.degree, *given, to_summed, *span, *own, to_directions, to_coefficients
            )

        in_parallel(one, -(-number // PART))
        to_coefficients[int(ctx.taken[-1]) + 1 if number else 0 :] = 0.0
        return (
            torch.from_numpy(to_directions[:number]).to(directions.dtype),
            torch.from_numpy(to_coefficients),
            None,
            None,
        )
