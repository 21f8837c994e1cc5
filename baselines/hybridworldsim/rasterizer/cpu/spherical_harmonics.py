"""Real spherical harmonics by compiled kernels, eight Gaussians at a time, with gradients.

A harmonic is a polynomial of z times the real or imaginary part of (x + i y)^m, with the signs and the order of
Gaussian splatting (Sloan, "Efficient Spherical Harmonic Evaluation", JCGT 2013).
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


def _compute_polynomials() -> Float64:
    """Compute (l, m, power of z): normalised associated Legendre polynomials without (1 - z^2)^(m / 2)."""
    table = np.zeros((DEGREE_MAX + 1,) * 3)
    for l in range(DEGREE_MAX + 1):  # noqa: E741 - the usual symbol
        # Rodrigues' formula
        legendre = polynomial.polypow([-1.0, 0.0, 1.0], l) / (2.0**l * math.factorial(l))
        for m in range(l + 1):
            derived = polynomial.polyder(legendre, l + m)
            turns = math.factorial(l - m) / math.factorial(l + m)
            norm = math.sqrt((2 - (m == 0)) * (2 * l + 1) / (4.0 * math.pi) * turns)
            table[l, m, : len(derived)] = (-1.0) ** m * norm * derived
    return table


_TABLE: Final = _compute_polynomials()


def spherical_harmonics(degree: int, directions: Tensor, coefficients: Tensor, ids: Tensor | None = None) -> Tensor:
    """Sum spherical harmonics, differentiable with respect to directions and coefficients.

    Args:
        degree: highest degree of the sum, 0 to 4.
        directions: (M, 3) of any length; for a zero direction x, y and z are zero.
        coefficients: (N, K, 3) with K >= (degree + 1)^2, ordered by degree, then by order.
        ids: (M,) int64 row of the coefficients for each direction, ascending, unique; None: row i for direction i, with
            N = M.

    Returns:
        (M, 3) in the coefficients' dtype, without the offset of 0.5 of colours.

    Raises:
        UsageError: coefficients of another shape, or fewer than the degree needs.
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
    """Load eight directions and normalise them; return x, y, z and 1 / length. All are 0 for a zero direction."""
    for lane in range(8):
        rows[lane] = start + lane if start + lane < end else start
    x, y, z = lanes.load_triples(directions, rows, 0)
    squared = x * x + y * y + z * z
    inverse = lanes.select(squared > 0.0, 1.0 / lanes.sqrt(squared), 0.0)
    return x * inverse, y * inverse, z * inverse, inverse


@kernel(inline="always")
def _basis(degree: Any, x: Any, y: Any, z: Any, basis: Any) -> None:
    """Store each harmonic of eight unit vectors."""
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
    """Sum the harmonics of a range of directions.

    Args:
        degree: highest degree.
        directions: (3 M,) flat.
        coefficients: (N, K, 3).
        ids: (M,) rows of the coefficients, ascending.
        begin: first direction.
        end: one past the last.
        rows: (8,) int64 scratch.
        basis: (200,) scratch in the coefficients' dtype.
        summed: (M, 3) output, the sums.
    """
    count = (degree + 1) * (degree + 1)
    for start in range(begin, end, 8):
        x, y, z, _ = _unit(directions, rows, start, end)
        _basis(degree, x, y, z, basis)
        for lane in range(min(8, end - start)):
            coeffs = coefficients[ids[start + lane]]
            red, green, blue = basis[lane] * coeffs[0, 0], basis[lane] * coeffs[0, 1], basis[lane] * coeffs[0, 2]
            for k in range(1, count):
                weight = basis[8 * k + lane]
                red += weight * coeffs[k, 0]
                green += weight * coeffs[k, 1]
                blue += weight * coeffs[k, 2]
            summed[start + lane, 0], summed[start + lane, 1], summed[start + lane, 2] = red, green, blue


@kernel()
def spherical_harmonics_part_backward(
    degree: Any,
    directions: Any,
    coefficients: Any,
    ids: Any,
    grad_summed: Any,
    begin: Any,
    end: Any,
    rows: Any,
    basis: Any,
    grad_basis: Any,
    grad_directions: Any,
    grad_coefficients: Any,
) -> None:
    """Compute the gradients of a range of directions.

    Args:
        degree: highest degree.
        directions: (3 M,) flat.
        coefficients: (N, K, 3).
        ids: (M,) rows of the coefficients, ascending.
        grad_summed: (M, 3) gradient to the sums.
        begin: first direction.
        end: one past the last.
        rows: (8,) int64 scratch.
        basis: (200,) scratch in the coefficients' dtype.
        grad_basis: (200,) scratch in the coefficients' dtype.
        grad_directions: (M + 8, 3) output, gradients.
        grad_coefficients: (N, K, 3) output, gradients, and zeros for unused rows up to the last used row; the caller
            fills the rows after it.
    """
    count = (degree + 1) * (degree + 1)
    done = 0 if begin == 0 else ids[begin - 1] + 1
    for start in range(begin, end, 8):
        x, y, z, inverse = _unit(directions, rows, start, end)
        _basis(degree, x, y, z, basis)
        for lane in range(min(8, end - start)):
            row = ids[start + lane]
            for unused in range(done, row):
                grad_unused = grad_coefficients[unused]
                for k in range(coefficients.shape[1]):
                    grad_unused[k, 0], grad_unused[k, 1], grad_unused[k, 2] = 0.0, 0.0, 0.0
            done = row + 1
            coeffs, grad_row = coefficients[row], grad_coefficients[row]
            red, green, blue = grad_summed[start + lane, 0], grad_summed[start + lane, 1], grad_summed[start + lane, 2]
            for k in range(count):
                weight = basis[8 * k + lane]
                grad_row[k, 0], grad_row[k, 1], grad_row[k, 2] = weight * red, weight * green, weight * blue
                grad_basis[8 * k + lane] = coeffs[k, 0] * red + coeffs[k, 1] * green + coeffs[k, 2] * blue
            for k in range(count, coefficients.shape[1]):
                grad_row[k, 0], grad_row[k, 1], grad_row[k, 2] = 0.0, 0.0, 0.0

        grad_x, grad_y, grad_z = lanes.broadcast(0.0), lanes.broadcast(0.0), lanes.broadcast(0.0)
        real, imaginary = lanes.broadcast(1.0), lanes.broadcast(0.0)
        less_real, less_imaginary = lanes.broadcast(0.0), lanes.broadcast(0.0)
        for m in range(degree + 1):
            grad_real, grad_imaginary = lanes.broadcast(0.0), lanes.broadcast(0.0)
            for l in range(m, degree + 1):  # noqa: E741
                value, slope = lanes.broadcast(_TABLE[l, m, l - m]), lanes.broadcast(0.0)
                for power in range(l - m - 1, -1, -1):
                    slope = slope * z + value
                    value = value * z + _TABLE[l, m, power]
                grad_even = lanes.load(grad_basis, 8 * (l * l + l + m))
                grad_real = grad_real + value * grad_even
                grad_z = grad_z + slope * grad_even * real
                if m > 0:
                    grad_odd = lanes.load(grad_basis, 8 * (l * l + l - m))
                    grad_imaginary = grad_imaginary + value * grad_odd
                    grad_z = grad_z + slope * grad_odd * imaginary
            # d (x + i y)^m = m (x + i y)^(m - 1) (dx + i dy)
            grad_x = grad_x + m * (grad_real * less_real + grad_imaginary * less_imaginary)
            grad_y = grad_y + m * (grad_imaginary * less_real - grad_real * less_imaginary)
            less_real, less_imaginary = real, imaginary
            real, imaginary = x * real - y * imaginary, x * imaginary + y * real
        # the length of a direction has no effect: remove the radial part of the gradient
        outward = grad_x * x + grad_y * y + grad_z * z
        lanes.store_triples(
            grad_directions,
            start,
            inverse * (grad_x - outward * x),
            inverse * (grad_y - outward * y),
            inverse * (grad_z - outward * z),
        )


class _SphericalHarmonics(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, directions: Tensor, coefficients: Tensor, ids: Tensor | None, degree: int) -> Tensor:
        dtype, number = coefficients.dtype, len(directions)
        rows = np.arange(number) if ids is None else ids.numpy()
        arrays = flat(directions, dtype), flat(coefficients, dtype).reshape(coefficients.shape), rows
        summed = empty_aligned(number * 3, arrays[0].dtype).reshape(number, 3)

        def run_part(part: int) -> None:
            span = part * PART, min((part + 1) * PART, number)
            spherical_harmonics_part(degree, *arrays, *span, np.empty(8, np.int64), np.empty(200, summed.dtype), summed)

        in_parallel(run_part, -(-number // PART))
        ctx.save_for_backward(directions, coefficients)
        ctx.rows, ctx.degree = rows, degree
        return torch.from_numpy(summed)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, None, None]:
        directions, coefficients = ctx.saved_tensors
        dtype, number = coefficients.dtype, len(directions)
        arrays = flat(directions, dtype), flat(coefficients, dtype).reshape(coefficients.shape), ctx.rows
        grad_summed = flat(gradients[0], dtype).reshape(-1, 3)
        array_dtype = arrays[0].dtype
        grad_directions = empty_aligned((number + 8) * 3, array_dtype).reshape(-1, 3)
        grad_coefficients = empty_aligned(coefficients.numel(), array_dtype).reshape(arrays[1].shape)

        def run_part(part: int) -> None:
            span = part * PART, min((part + 1) * PART, number)
            scratch = np.empty(8, np.int64), np.empty(200, array_dtype), np.empty(200, array_dtype)
            spherical_harmonics_part_backward(
                ctx.degree, *arrays, grad_summed, *span, *scratch, grad_directions, grad_coefficients
            )

        in_parallel(run_part, -(-number // PART))
        grad_coefficients[int(ctx.rows[-1]) + 1 if number else 0 :] = 0.0
        return (
            torch.from_numpy(grad_directions[:number]).to(directions.dtype),
            torch.from_numpy(grad_coefficients),
            None,
            None,
        )
