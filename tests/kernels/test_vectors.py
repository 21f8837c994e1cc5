"""The vector type: every operation against numpy, element by element."""

import numba
import numpy as np
import pytest

from hybridworldsim.kernels import vectors as v
from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.rasterizer.cpu.blending.forward import exp2

A = np.array([-3.5, -2.5, -1.0, -0.0, 0.0, 0.5, 1.5, 2.5, 3.0, 7.25, 1e-3, 1e3, -1e3, 5.0, 6.0, 9.0], np.float32)
B = np.roll(A, 5) + np.float32(0.25)


@numba.njit(error_model="numpy")
def arithmetic(a, b, out, whole):
    x, y = v.load(a, 0), v.load(b, 0)
    v.store(out, 0, x + y)
    v.store(out, 16, x - np.float32(2.0))
    v.store(out, 32, np.float32(3.0) * y)
    v.store(out, 48, x / y)
    v.store(out, 64, v.fma(x, y, np.float32(1.0)))
    v.store(out, 80, v.fnma(x, y, np.float32(1.0)))
    v.store(out, 96, v.min_or_b(x, y))
    v.store(out, 112, v.abs_(x))
    mask = (x >= y) & (x < np.float32(4.0))
    v.store(out, 128, v.select(mask | (y > x), x, np.float32(-7.0)))
    v.store(out, 144, v.sum_each((x, y, x * y)))
    v.store(out, 160, v.load_one(a, 9))
    out[176] = v.sum_elements(x)
    whole[0] = v.to_bits(mask)
    whole[1] = v.to_bits(mask ^ v.from_bits(0xFFFF))
    whole[2] = v.trailing_zeros(np.uint64(0b101000))


def test_operations_are_those_of_their_elements():
    out, whole = np.zeros(192, np.float32), np.zeros(3, np.int64)
    arithmetic(A, B, out, whole)
    mask = (A >= B) & (A < 4.0)
    wanted = [
        A + B, A - 2.0, 3.0 * B, A / B,
        (A.astype(np.float64) * B + 1.0).astype(np.float32), (1.0 - A.astype(np.float64) * B).astype(np.float32),
        np.minimum(A, B), np.abs(A), np.where(mask | (B > A), A, np.float32(-7.0)),
    ]  # fmt: skip
    np.testing.assert_array_equal(out[:144].reshape(9, 16), np.stack(wanted))
    sums = [A.astype(np.float64).sum(), B.astype(np.float64).sum(), (A.astype(np.float64) * B).sum()]
    np.testing.assert_allclose(out[144:147], sums, rtol=1e-5)
    assert (out[147:160] == 0.0).all()
    assert (out[160:176] == A[9]).all()
    np.testing.assert_allclose(out[176], sums[0], rtol=1e-6)
    to_bits = int((mask * (1 << np.arange(16))).sum())
    assert whole.tolist() == [to_bits, to_bits ^ 0xFFFF, 3]


@numba.njit(error_model="numpy")
def whole_numbers(numbers, out):
    x = v.load(numbers, 0)
    out[0] = v.to_bits(v.greater_int(x, np.int32(5)))
    out[1] = v.to_bits(v.has_bits(x, np.int32(4)))
    v.store(numbers, 0, v.select_int(v.from_bits(0b11), np.int32(-1), x))


def test_whole_numbers_are_compared_and_chosen():
    numbers, out = np.arange(16, dtype=np.int32), np.zeros(2, np.int64)
    whole_numbers(numbers, out)
    assert out[0] == sum(1 << k for k in range(16) if k > 5)
    assert out[1] == sum(1 << k for k in range(16) if k & 4)
    assert numbers.tolist() == [-1, -1, *range(2, 16)]


@kernel()
def powers(exponents, out):
    for at in range(0, exponents.size, 16):
        v.store(out, at, exp2(v.load(exponents, at)))


def test_powers_of_two_are_right_to_rounding():
    exponents = np.linspace(-8.5, 1.0, 1 << 16, dtype=np.float32)
    out = np.empty_like(exponents)
    powers(exponents, out)
    assert np.abs(out / np.exp2(exponents.astype(np.float64)) - 1.0).max() < 3e-7


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1e30, 1e30])
def test_powers_of_what_is_no_exponent_do_not_crash(value):
    powers(np.full(16, value, np.float32), np.empty(16, np.float32))


def test_a_vector_and_another_kind_of_vector_are_not_added():
    @numba.njit
    def mixed(a):
        return v.to_bits((v.load(a, 0) > np.float32(0.0)) + v.load(a, 0))

    with pytest.raises(numba.TypingError):
        mixed(A)
