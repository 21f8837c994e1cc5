"""Elementary functions of one number, with the same bits on every x86-64 processor; for Python and for kernels.

Errors, in units in the last place: below 1.5 for `sin`, `cos`, `exp`, `log` and `hypot`, below 3 for the others, and
``3 + 2 |y log x|`` for `power` (tests/portable/test_portable.py). Angles of `sin`, `cos` and `tan` are below 10^6 rad.
"""

from __future__ import annotations

import math
from typing import Final

from mirror.compiled import inner_per_pixel, per_pixel

# Parts of pi/2 and of log 2 (Cody and Waite, 1980): the leading parts have 33 bits, so that their products with the
# number of periods are exact.
_PIO2_1: Final = float.fromhex("0x1.921fb54400000p+0")
_PIO2_2: Final = float.fromhex("0x1.0b4611a600000p-34")
_PIO2_3: Final = float.fromhex("0x1.3198a2e037073p-69")
_LN2_1: Final = float.fromhex("0x1.62e42fef00000p-1")
_LN2_2: Final = float.fromhex("0x1.473de6af278edp-34")
_PI: Final = math.pi
_HALF_PI: Final = 0.5 * math.pi
_QUARTER_PI: Final = 0.25 * math.pi
_SQRT_HALF: Final = float.fromhex("0x1.6a09e667f3bcdp-1")
# 1.5 * 2^52: adding it to a number below 2^51 and subtracting it again rounds the number to an integer.
_ROUNDING: Final = 6755399441055744.0
_EXP_MAX: Final = 709.78
_EXP_MIN: Final = -745.2
_ATAN_EIGHTHS: Final = tuple(
    float.fromhex(text)
    for text in (
        "0x0.0p+0",
        "0x1.fd5ba9aac2f6ep-4",
        "0x1.f5b75f92c80ddp-3",
        "0x1.6f61941e4def1p-2",
        "0x1.dac670561bb4fp-2",
        "0x1.1e00babdefeb4p-1",
        "0x1.4978fa3269ee1p-1",
        "0x1.700a7c5784634p-1",
        "0x1.921fb54442d18p-1",
    )
)
"""Arc tangents of 0, 1/8, ... 1."""

_compiled: Final = per_pixel()
_inner: Final = inner_per_pixel()


@_inner
def _sin_core(r: float) -> float:
    """The sine of an angle of at most pi/4, by its Taylor series."""
    z = r * r
    tail = -1.0 / 1307674368000.0
    tail = 1.0 / 6227020800.0 + z * tail
    tail = -1.0 / 39916800.0 + z * tail
    tail = 1.0 / 362880.0 + z * tail
    tail = -1.0 / 5040.0 + z * tail
    tail = 1.0 / 120.0 + z * tail
    tail = -1.0 / 6.0 + z * tail
    return r + r * (z * tail)


@_inner
def _cos_core(r: float) -> float:
    """The cosine of an angle of at most pi/4, by its Taylor series."""
    z = r * r
    tail = 1.0 / 20922789888000.0
    tail = -1.0 / 87178291200.0 + z * tail
    tail = 1.0 / 479001600.0 + z * tail
    tail = -1.0 / 3628800.0 + z * tail
    tail = 1.0 / 40320.0 + z * tail
    tail = -1.0 / 720.0 + z * tail
    tail = 1.0 / 24.0 + z * tail
    half = 0.5 * z
    whole = 1.0 - half
    # The rounding error of `whole` is exact and added back.
    return whole + ((1.0 - whole) - half + z * (z * tail))


@_inner
def _reduce(x: float) -> tuple[float, float, int]:
    """The angle less multiples of pi/2, as a sum of two numbers, and the quadrant."""
    count = (x * (2.0 / _PI) + _ROUNDING) - _ROUNDING
    first = x - count * _PIO2_1
    second = count * _PIO2_2
    r = first - second
    # The rounding error of the difference (Knuth), and the third part of pi/2.
    back = first - r
    rest = ((first - (r + back)) + (back - second)) - count * _PIO2_3
    return r, rest, int(count) & 3


@_compiled
def sin(x: float) -> float:
    """Return the sine of an angle below 10^6 rad; NaN for others."""
    x = float(x)
    if not abs(x) < 1e6:
        return math.nan
    r, rest, quadrant = _reduce(x)
    value = _sin_core(r) + rest * _cos_core(r) if quadrant & 1 == 0 else _cos_core(r) - rest * _sin_core(r)
    return -value if quadrant & 2 else value


@_compiled
def cos(x: float) -> float:
    """Return the cosine of an angle below 10^6 rad; NaN for others."""
    x = float(x)
    if not abs(x) < 1e6:
        return math.nan
    r, rest, quadrant = _reduce(x)
    value = _cos_core(r) - rest * _sin_core(r) if quadrant & 1 == 0 else _sin_core(r) + rest * _cos_core(r)
    return -value if quadrant in (1, 2) else value


@_compiled
def tan(x: float) -> float:
    """Return the tangent of an angle below 10^6 rad; NaN for others."""
    return sin(x) / cos(x)


@_compiled
def atan(x: float) -> float:
    """Return the arc tangent, in -pi/2..pi/2 rad."""
    x = float(x)
    size = abs(x)
    if size == math.inf:
        return math.copysign(_HALF_PI, x)
    inverted = size > 1.0
    t = 1.0 / size if inverted else size
    if t != t:
        return t
    eighth = int(8.0 * t + 0.5)
    near = eighth / 8.0
    u = (t - near) / (1.0 + t * near)
    z = u * u
    tail = -1.0 / 15.0
    tail = 1.0 / 13.0 + z * tail
    tail = -1.0 / 11.0 + z * tail
    tail = 1.0 / 9.0 + z * tail
    tail = -1.0 / 7.0 + z * tail
    tail = 1.0 / 5.0 + z * tail
    tail = -1.0 / 3.0 + z * tail
    angle = _ATAN_EIGHTHS[eighth] + (u + u * (z * tail))
    return math.copysign(_HALF_PI - angle if inverted else angle, x)


@_compiled
def atan2(y: float, x: float) -> float:
    """Return the angle of a point (x, y), in -pi..pi rad; 0 or pi with the sign of y for points on the x axis."""
    y, x = float(y), float(x)
    if x != x or y != y:
        return math.nan
    wide, high = abs(x), abs(y)
    if wide == math.inf and high == math.inf:
        angle = _QUARTER_PI
    elif high <= wide:
        angle = atan(high / wide) if wide > 0.0 else 0.0
    else:
        angle = _HALF_PI - atan(wide / high)
    if math.copysign(1.0, x) < 0.0:
        angle = _PI - angle
    return math.copysign(angle, y)


@_compiled
def asin(x: float) -> float:
    """Return the arc sine, in -pi/2..pi/2 rad; NaN outside -1..1."""
    x = float(x)
    return atan2(x, math.sqrt((1.0 - x) * (1.0 + x))) if abs(x) <= 1.0 else math.nan


@_compiled
def acos(x: float) -> float:
    """Return the arc cosine, in 0..pi rad; NaN outside -1..1."""
    x = float(x)
    return atan2(math.sqrt((1.0 - x) * (1.0 + x)), x) if abs(x) <= 1.0 else math.nan


@_compiled
def exp(x: float) -> float:
    """Return the exponential function."""
    x = float(x)
    if x != x:
        return x
    if x > _EXP_MAX:
        return math.inf
    if x < _EXP_MIN:
        return 0.0
    count = (x * (1.0 / 0.6931471805599453) + _ROUNDING) - _ROUNDING
    high = x - count * _LN2_1
    low = count * _LN2_2
    r = high - low
    rest = (high - r) - low
    tail = 1.0 / 6227020800.0
    tail = 1.0 / 479001600.0 + r * tail
    tail = 1.0 / 39916800.0 + r * tail
    tail = 1.0 / 3628800.0 + r * tail
    tail = 1.0 / 362880.0 + r * tail
    tail = 1.0 / 40320.0 + r * tail
    tail = 1.0 / 5040.0 + r * tail
    tail = 1.0 / 720.0 + r * tail
    tail = 1.0 / 120.0 + r * tail
    tail = 1.0 / 24.0 + r * tail
    tail = 1.0 / 6.0 + r * tail
    tail = 0.5 + r * tail
    value = 1.0 + (r + (rest + r * (r * tail)))
    return math.ldexp(value, int(count))


@_compiled
def log(x: float) -> float:
    """Return the natural logarithm; -inf for 0, NaN for negative numbers."""
    x = float(x)
    if x != x or x < 0.0:
        return math.nan
    if x == 0.0:
        return -math.inf
    if x == math.inf:
        return x
    mantissa, exponent = math.frexp(x)
    if mantissa < _SQRT_HALF:
        mantissa, exponent = 2.0 * mantissa, exponent - 1
    f = mantissa - 1.0
    s = f / (2.0 + f)
    z = s * s
    tail = 1.0 / 23.0
    tail = 1.0 / 21.0 + z * tail
    tail = 1.0 / 19.0 + z * tail
    tail = 1.0 / 17.0 + z * tail
    tail = 1.0 / 15.0 + z * tail
    tail = 1.0 / 13.0 + z * tail
    tail = 1.0 / 11.0 + z * tail
    tail = 1.0 / 9.0 + z * tail
    tail = 1.0 / 7.0 + z * tail
    tail = 0.2 + z * tail
    tail = 1.0 / 3.0 + z * tail
    # log(1 + f) = f - s (f - 2 z tail): f is exact, and the rest is small.
    fraction = f - s * (f - 2.0 * (z * tail))
    return exponent * _LN2_1 + (fraction + exponent * _LN2_2)


@_compiled
def power(x: float, y: float) -> float:
    """Return a power of a number of at least 0; NaN for negative numbers."""
    x, y = float(x), float(y)
    if y == 0.0:
        return 1.0
    if x == 0.0:
        return 0.0 if y > 0.0 else math.inf
    return exp(y * log(x))


@_compiled
def hypot(x: float, y: float) -> float:
    """Return the length of a vector of components between 1e-150 and 1e150, or 0."""
    x, y = float(x), float(y)
    return math.sqrt(x * x + y * y)
