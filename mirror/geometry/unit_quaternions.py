"""Quaternion arithmetic that trusts its input to be unit quaternions: what `Poses` holds, checked when it was made.

`mirror.geometry.quaternions` has the same functions with that check. The kernels work on one component at a time, each
contiguous in memory: three times as fast as on rows of four.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mirror.arrays import AnyArray, Float64
from mirror.geometry.blocks import fill, split


def canonical(quaternion: Float64) -> Float64:
    """Return the quaternion (..., 4) of each rotation with a positive first non-zero component."""
    scalar = quaternion[..., 0]
    if (scalar > 0).all():
        return quaternion
    flip = scalar < 0
    zero = scalar == 0
    for axis in (1, 2, 3):
        flip |= zero & (quaternion[..., axis] < 0)
        zero &= quaternion[..., axis] == 0
    # Adding zero turns -0.0 into 0.0, so that equal rotations have equal bytes.
    return np.where(flip[..., None], -quaternion, quaternion) + 0.0


def multiply_unit(first: Float64, second: Float64) -> Float64:
    """Return `quaternion_multiply` of unit quaternions."""
    return canonical(broadcast(_multiply_kernel, 4, first, second))


def invert_unit(quaternion: Float64) -> Float64:
    """Return `quaternion_inverse` of unit quaternions."""
    return canonical(quaternion * (1.0, -1.0, -1.0, -1.0) + 0.0)


def rotate_unit(quaternion: Float64, points: Float64) -> Float64:
    """Return `rotate` by unit quaternions."""
    return broadcast(_rotate_kernel, 3, quaternion, points)


def slerp_unit(first: Float64, second: Float64, fraction: Float64) -> Float64:
    """Return `slerp` between unit quaternions."""
    return canonical(broadcast(slerp_kernel, 4, first, second, fraction[..., None]))


def matrix_unit(quaternion: Float64) -> Float64:
    """Return `matrix_from_quaternion` of unit quaternions, as rows of nine."""
    return broadcast(_matrix_kernel, 9, quaternion)


def log_unit(quaternion: Float64) -> Float64:
    """Return `quaternion_log` of canonical quaternions."""
    return broadcast(_log_kernel, 3, quaternion)


def sinc(angle: Float64) -> Float64:
    """Return ``sin(angle) / angle``, 1 at 0."""
    divisor = np.where(angle == 0.0, 1.0, angle)
    return np.asarray(np.where(angle == 0.0, 1.0, np.sin(angle) / divisor))


def broadcast(kernel: Callable[..., None], components: int, *arrays: Float64) -> Float64:
    """Return the (..., ``components``) result of a kernel over the arrays' broadcast batch axes."""
    axes = max(array.ndim for array in arrays)
    arrays = tuple(array.reshape(*(1,) * (axes - array.ndim), *array.shape) for array in arrays)
    shape = arrays[0].shape[:-1]
    if any(array.shape[:-1] != shape for array in arrays):
        shape = np.broadcast_shapes(*(array.shape[:-1] for array in arrays))
    out = np.empty((*shape, components))
    fill(kernel, out, *arrays)
    return out


def slerp_kernel(out: AnyArray, first: AnyArray, second: AnyArray, fraction: AnyArray) -> None:
    """Write `slerp`, not yet canonical, into ``out`` (..., 4); ``fraction`` is (..., 1)."""
    a, b, u = split(first), split(second), fraction[..., 0]
    products = a * b
    b = b * np.copysign(1.0, products[0] + products[1] + products[2] + products[3])
    # The chord is at most sqrt(2), where the arc sine of its half is well conditioned; near zero it is exact.
    squares = b - a
    squares *= squares
    angle = 2.0 * np.arcsin(0.5 * np.sqrt(squares[0] + squares[1] + squares[2] + squares[3]))
    sine = np.sin(angle)
    rest = 1.0 - u
    if sine.all():
        of_first, of_second = np.sin(rest * angle) / sine, np.sin(u * angle) / sine
    else:
        turning = sine > 0.0
        divisor = np.where(turning, sine, 1.0)
        of_first = np.where(turning, np.sin(rest * angle) / divisor, rest)
        of_second = np.where(turning, np.sin(u * angle) / divisor, u)
    np.add(of_first * a, of_second * b, out=out.transpose(out.ndim - 1, *range(out.ndim - 1)))


def _multiply_kernel(out: AnyArray, first: AnyArray, second: AnyArray) -> None:
    (aw, ax, ay, az), (bw, bx, by, bz) = split(first), split(second)
    w = aw * bw - ax * bx - ay * by - az * bz
    x = aw * bx + ax * bw + ay * bz - az * by
    y = aw * by - ax * bz + ay * bw + az * bx
    z = aw * bz + ax * by - ay * bx + az * bw
    scale = 1.0 / np.sqrt(w * w + x * x + y * y + z * z)
    for component, value in enumerate((w, x, y, z)):
        np.multiply(value, scale, out=out[..., component])


def _rotate_kernel(out: AnyArray, quaternion: AnyArray, points: AnyArray) -> None:
    (w, x, y, z), (px, py, pz) = split(quaternion), split(points)
    tx = 2.0 * (y * pz - z * py)
    ty = 2.0 * (z * px - x * pz)
    tz = 2.0 * (x * py - y * px)
    np.add(px, w * tx + (y * tz - z * ty), out=out[..., 0])
    np.add(py, w * ty + (z * tx - x * tz), out=out[..., 1])
    np.add(pz, w * tz + (x * ty - y * tx), out=out[..., 2])


def _matrix_kernel(out: AnyArray, quaternion: AnyArray) -> None:
    w, x, y, z = split(quaternion)
    xx, yy, zz = 2.0 * x * x, 2.0 * y * y, 2.0 * z * z
    xy, xz, yz = 2.0 * x * y, 2.0 * x * z, 2.0 * y * z
    wx, wy, wz = 2.0 * w * x, 2.0 * w * y, 2.0 * w * z
    entries = (1.0 - yy - zz, xy - wz, xz + wy, xy + wz, 1.0 - xx - zz, yz - wx, xz - wy, yz + wx, 1.0 - xx - yy)
    for entry, value in enumerate(entries):
        out[..., entry] = value


def _log_kernel(out: AnyArray, quaternion: AnyArray) -> None:
    w, x, y, z = split(quaternion)
    sine = np.sqrt(x * x + y * y + z * z)
    # The ratio tends to 2 / qw; the same, possibly underflowing, sine stands in both places.
    ratio = np.where(sine > 0.0, 2.0 * np.arctan2(sine, w) / np.where(sine > 0.0, sine, 1.0), 2.0)
    for component, value in enumerate((x, y, z)):
        np.multiply(value, ratio, out=out[..., component])
