"""Quaternion arithmetic that trusts its input to be unit quaternions: what `Poses` holds, checked when it was made.

`mirror.geometry.quaternions` has the same functions with that check.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mirror.arrays import AnyArray, Float64
from mirror.geometry.blocks import fill


def canonical(quaternion: Float64) -> Float64:
    """Of the two quaternions (..., 4) of each rotation, the one whose first non-zero component is positive."""
    flip = quaternion[..., 0] < 0
    zero = quaternion[..., 0] == 0
    if zero.any():
        for axis in (1, 2, 3):
            flip = flip | (zero & (quaternion[..., axis] < 0))
            zero = zero & (quaternion[..., axis] == 0)
    if not flip.any():
        return quaternion
    return np.where(flip[..., None], -quaternion, quaternion)


def multiply_unit(first: Float64, second: Float64) -> Float64:
    """`quaternion_multiply` of quaternions known to be unit."""
    return _broadcast(_multiply_kernel, 4, first, second)


def invert_unit(quaternion: Float64) -> Float64:
    """`quaternion_inverse` of quaternions known to be unit."""
    return canonical(quaternion * (1.0, -1.0, -1.0, -1.0) + 0.0)


def rotate_unit(quaternion: Float64, points: Float64) -> Float64:
    """`rotate` by quaternions known to be unit."""
    return _broadcast(rotate_kernel, 3, quaternion, points)


def slerp_unit(first: Float64, second: Float64, fraction: Float64) -> Float64:
    """`slerp` between quaternions known to be unit."""
    return _broadcast(slerp_kernel, 4, first, second, fraction[..., None])


def log_unit(quaternion: Float64) -> Float64:
    """`quaternion_log` of quaternions known to be canonical."""
    vector = quaternion[..., 1:]
    sine = np.sqrt(np.einsum("...i,...i->...", vector, vector))
    # The ratio tends to 2 / qw; the same, possibly underflowing, sine stands in both places.
    nonzero = sine > 0
    ratio = np.where(nonzero, 2.0 * np.arctan2(sine, quaternion[..., 0]) / np.where(nonzero, sine, 1.0), 2.0)
    return np.asarray(vector * ratio[..., None])


def sinc(angle: Float64) -> Float64:
    """``sin(angle) / angle``, 1 at 0."""
    nonzero = angle != 0
    return np.where(nonzero, np.sin(angle) / np.where(nonzero, angle, 1.0), 1.0)


def slerp_kernel(out: AnyArray, first: AnyArray, second: AnyArray, fraction: AnyArray) -> None:
    """Write `slerp` into ``out`` (..., 4); ``fraction`` is (..., 1)."""
    a, b, u = _split(first), _split(second), fraction[..., 0]
    dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    towards = np.where(dot < 0, -1.0, 1.0)
    b = [towards * component for component in b]
    d = [q - p for p, q in zip(a, b)]
    # The chord between the two is at most sqrt(2), where the arc sine of its half is well conditioned.
    half_chord = 0.5 * np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2] + d[3] * d[3])
    angle = 2.0 * np.arcsin(half_chord)
    sine = 2.0 * half_chord * np.sqrt(1.0 - half_chord * half_chord)
    turning = sine > 0
    divisor = np.where(turning, sine, 1.0)
    of_first = np.where(turning, np.sin((1.0 - u) * angle) / divisor, 1.0 - u)
    of_second = np.where(turning, np.sin(u * angle) / divisor, u)
    for component in range(4):
        out[..., component] = of_first * a[component] + of_second * b[component]
    _canonical_in_place(out)


def _multiply_kernel(out: AnyArray, first: AnyArray, second: AnyArray) -> None:
    (aw, ax, ay, az), (bw, bx, by, bz) = _split(first), _split(second)
    w = aw * bw - ax * bx - ay * by - az * bz
    x = aw * bx + ax * bw + ay * bz - az * by
    y = aw * by - ax * bz + ay * bw + az * bx
    z = aw * bz + ax * by - ay * bx + az * bw
    scale = 1.0 / np.sqrt(w * w + x * x + y * y + z * z)
    for component, value in enumerate((w, x, y, z)):
        out[..., component] = value * scale
    _canonical_in_place(out)


def rotate_kernel(out: AnyArray, quaternion: AnyArray, points: AnyArray) -> None:
    """Write the turned points into ``out`` (..., 3)."""
    (w, x, y, z), (px, py, pz) = _split(quaternion), _split(points)
    tx = 2.0 * (y * pz - z * py)
    ty = 2.0 * (z * px - x * pz)
    tz = 2.0 * (x * py - y * px)
    out[..., 0] = px + w * tx + (y * tz - z * ty)
    out[..., 1] = py + w * ty + (z * tx - x * tz)
    out[..., 2] = pz + w * tz + (x * ty - y * tx)


def matrix_kernel(out: AnyArray, quaternion: AnyArray) -> None:
    """Write rotation matrices, row by row, into ``out`` (..., 9)."""
    w, x, y, z = _split(quaternion)
    xx, yy, zz = 2.0 * x * x, 2.0 * y * y, 2.0 * z * z
    xy, xz, yz = 2.0 * x * y, 2.0 * x * z, 2.0 * y * z
    wx, wy, wz = 2.0 * w * x, 2.0 * w * y, 2.0 * w * z
    entries = (1.0 - yy - zz, xy - wz, xz + wy, xy + wz, 1.0 - xx - zz, yz - wx, xz - wy, yz + wx, 1.0 - xx - yy)
    for entry, value in enumerate(entries):
        out[..., entry] = value


def shepperd_kernel(out: AnyArray, matrix: AnyArray) -> None:
    """Write the quaternions of rotation matrices (..., 9), not yet canonical, into ``out`` (..., 4)."""
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = _split(matrix)
    trace = m00 + m11 + m22
    largest = np.argmax(np.stack((trace, m00, m11, m22)), axis=0)
    # Row k holds 4 * q[k] * q: the row of the largest component has no cancellation.
    rows = (
        (1.0 + trace, m21 - m12, m02 - m20, m10 - m01),
        (m21 - m12, 1.0 + m00 - m11 - m22, m10 + m01, m02 + m20),
        (m02 - m20, m10 + m01, 1.0 - m00 + m11 - m22, m21 + m12),
        (m10 - m01, m02 + m20, m21 + m12, 1.0 - m00 - m11 + m22),
    )
    chosen = [np.choose(largest, [row[component] for row in rows]) for component in range(4)]
    scale = 1.0 / np.sqrt(sum(component * component for component in chosen))
    for component, value in enumerate(chosen):
        out[..., component] = value * scale


def _canonical_in_place(quaternion: AnyArray) -> None:
    quaternion[...] = canonical(quaternion)


def _broadcast(kernel: Callable[..., None], components: int, *arrays: Float64) -> Float64:
    shape = np.broadcast_shapes(*(array.shape[:-1] for array in arrays))
    out = np.empty((*shape, components))
    fill(kernel, out, *(array.reshape(*(1,) * (out.ndim - array.ndim), *array.shape) for array in arrays))
    return out


def _split(array: AnyArray) -> list[AnyArray]:
    return [array[..., component] for component in range(array.shape[-1])]
