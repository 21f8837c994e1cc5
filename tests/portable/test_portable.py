"""Portable mathematics against references of 160 bits, and its use by the synthetic street and its traffic."""

from __future__ import annotations

import ast
from collections.abc import Callable
from pathlib import Path

import mpmath
import numpy as np
import pytest

import mirror
from mirror.portable import arrays, scalars

COUNT = 1500
RNG = np.random.default_rng(3)
CASES: dict[str, tuple[Callable[..., np.ndarray], Callable[..., object], tuple[np.ndarray, ...], float]] = {
    "sin": (arrays.sin, mpmath.sin, (RNG.uniform(-1e6, 1e6, COUNT),), 1.5),
    "sin of multiples of pi": (arrays.sin, mpmath.sin, (np.pi * RNG.integers(-1000, 1000, COUNT),), 1.5),
    "cos": (arrays.cos, mpmath.cos, (RNG.uniform(-10.0, 10.0, COUNT),), 1.5),
    "cos at zeros": (arrays.cos, mpmath.cos, (np.pi * (RNG.integers(-1000, 1000, COUNT) + 0.5),), 1.5),
    "tan": (arrays.tan, mpmath.tan, (RNG.uniform(-10.0, 10.0, COUNT),), 3.0),
    "arcsin": (arrays.arcsin, mpmath.asin, (RNG.uniform(-1.0, 1.0, COUNT),), 3.0),
    "arccos near 1": (arrays.arccos, mpmath.acos, (1.0 - 10.0 ** RNG.uniform(-15.0, 0.0, COUNT),), 3.0),
    "arctan2": (arrays.arctan2, mpmath.atan2, (RNG.normal(size=COUNT), RNG.normal(size=COUNT)), 3.0),
    "exp": (arrays.exp, mpmath.exp, (RNG.uniform(-700.0, 700.0, COUNT),), 1.5),
    "log": (arrays.log, mpmath.log, (10.0 ** RNG.uniform(-300.0, 300.0, COUNT),), 1.5),
    "log near 1": (arrays.log, mpmath.log, (1.0 + 10.0 ** RNG.uniform(-14.0, -1.0, COUNT),), 1.5),
    "power": (arrays.power, mpmath.power, (RNG.uniform(1e-3, 2.0, COUNT), RNG.uniform(0.0, 3.0, COUNT)), 3.0 + 42.0),
    "hypot": (arrays.hypot, mpmath.hypot, (RNG.normal(size=COUNT), RNG.normal(size=COUNT)), 1.5),
}


@pytest.mark.parametrize("name", CASES)
def test_functions_are_exact_to_units_in_the_last_place(name: str) -> None:
    function, reference, arguments, bound = CASES[name]
    values = function(*arguments)
    with mpmath.workprec(160):
        for row, value in zip(zip(*arguments), values, strict=True):
            true = reference(*(mpmath.mpf(float(number)) for number in row))
            unit = mpmath.mpf(np.spacing(abs(float(true))))
            assert abs(mpmath.mpf(float(value)) - true) <= bound * unit, row


def test_special_values() -> None:
    assert scalars.exp(-800.0) == 0.0 and scalars.exp(800.0) == np.inf and scalars.exp(0.0) == 1.0
    assert scalars.log(0.0) == -np.inf and scalars.log(np.inf) == np.inf and scalars.log(1.0) == 0.0
    assert scalars.power(0.0, 2.0) == 0.0 and scalars.power(5.0, 0.0) == 1.0
    assert scalars.atan2(0.0, -1.0) == np.pi and scalars.atan2(-0.0, -1.0) == -np.pi
    assert scalars.atan2(0.0, 0.0) == 0.0 and scalars.atan2(1.0, 0.0) == np.pi / 2
    assert scalars.atan(np.inf) == np.pi / 2 and scalars.atan(-1e300) == -np.pi / 2
    for value in (
        *(scalars.sin(bad) for bad in (np.nan, np.inf, 1e7)),
        *(function(np.nan) for function in (scalars.cos, scalars.exp, scalars.log, scalars.atan, scalars.acos)),
        scalars.log(-1.0), scalars.asin(1.1), scalars.acos(-1.1), scalars.power(-2.0, 0.5), scalars.atan2(np.nan, 1.0),
    ):  # fmt: skip
        assert np.isnan(value)


@pytest.mark.parametrize(
    ("left", "right"),
    [((3,), (3,)), ((5, 3), (3,)), ((3,), (3, 4)), ((5, 3), (3, 4)), ((7, 5, 3), (3, 4)), ((7, 5, 3), (7, 3, 2))],
)
def test_products_are_those_of_numpy(left: tuple[int, ...], right: tuple[int, ...]) -> None:
    a, b = RNG.normal(size=left), RNG.normal(size=right)
    product = arrays.matmul(a, b)
    assert np.shape(product) == np.shape(a @ b)
    np.testing.assert_allclose(product, a @ b, rtol=1e-14, atol=1e-14)


def test_linear_functions_are_those_of_numpy() -> None:
    matrix, known = RNG.normal(size=(6, 3, 3)), RNG.normal(size=(6, 3, 2))
    np.testing.assert_allclose(arrays.solve(matrix, known), np.linalg.solve(matrix, known), rtol=1e-10)
    swapped = np.array([[0.0, 1.0], [1.0, 0.0]])
    np.testing.assert_array_equal(arrays.solve(swapped, np.array([2.0, 3.0])), (3.0, 2.0))
    with pytest.raises(np.linalg.LinAlgError):
        arrays.solve(np.ones((2, 2)), np.ones(2))
    values, window = RNG.normal(size=30), RNG.normal(size=5)
    np.testing.assert_allclose(arrays.convolve(values, window), np.convolve(values, window, "valid"), atol=1e-14)
    assert arrays.norm((3.0, 4.0)) == 5.0


def test_the_street_uses_no_function_that_depends_on_the_processor() -> None:
    root = Path(mirror.__file__).parent
    texts = {path: path.read_text() for room in ("synth", "traffic") for path in sorted((root / room).rglob("*.py"))}
    found = [
        f"{path.relative_to(root)}:{node.lineno} {ast.unparse(node)[:60]}"
        for path, text in texts.items()
        for node in ast.walk(ast.parse(text))
        if is_processor_dependent(node, is_compiled="per_pixel" in text or "njit" in text)
    ]
    assert found == []


ELEMENTARY = "sin cos tan asin acos atan atan2 arcsin arccos arctan arctan2 exp log log2 log10 log1p expm1 pow power"
ELEMENTARY += " hypot sinh cosh tanh cbrt hanning hamming sinc dot inner vdot tensordot matmul convolve polyfit"
POSES = "SE3 Poses poses aside _INSTALLED error.draw ego[rows] body"


def is_processor_dependent(node: ast.AST, *, is_compiled: bool) -> bool:
    """Return whether a node of a module calls numpy's or the C library's elementary functions, BLAS or LAPACK.

    Kernels compute small integer powers by products.
    """
    match node:
        case ast.Attribute(value=ast.Name(id="np" | "math"), attr=name):
            return name in ELEMENTARY.split()
        case ast.Call(func=ast.Attribute(value=ast.Attribute(attr="linalg"), attr=name)):
            return name != "norm" or not any(keyword.arg == "axis" for keyword in node.keywords)
        case ast.BinOp(op=ast.MatMult()):
            return not any(word in ast.unparse(node) for word in POSES.split())
        case ast.BinOp(op=ast.Pow(), right=right):
            try:
                return float(ast.literal_eval(right)) not in ((2.0, 3.0, 4.0, 5.0, 6.0) if is_compiled else (2.0,))
            except ValueError:
                return ast.unparse(right) not in ("_SHIFT", "level")
    return False
