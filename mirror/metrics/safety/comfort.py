"""Comfort of the ego's motion: accelerations, jerks and turning within nuPlan's bounds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.metrics.safety.state_log import StateLog

COMFORT_BOUNDS: Final[Mapping[str, tuple[float, float]]] = {
    "longitudinal_acceleration_mps2": (-4.05, 2.40),
    "lateral_acceleration_mps2": (-4.89, 4.89),
    "jerk_mps3": (0.0, 8.37),
    "longitudinal_jerk_mps3": (-4.13, 4.13),
    "yaw_acceleration_radps2": (-1.93, 1.93),
    "yaw_rate_radps": (-0.95, 0.95),
}
"""Bounds of nuPlan (``ego_is_comfortable``), which NAVSIM takes over: least and largest comfortable value."""

_ACCELERATION_WINDOW: Final = 9
_JERK_WINDOW: Final = 15
_YAW_WINDOW: Final = 5
LEAST_STAMPS: Final = 4
"""A log with fewer stamps has no comfort: a polynomial of degree 3 needs four."""


@dataclass(frozen=True, eq=False)
class Comfort:
    """The comfort of a drive by nuPlan's bounds, with its worst quantities.

    Attributes:
        is_comfortable: all quantities stay within their bounds at all stamps.
        quantities: (T,) values of each quantity, under the names of `COMFORT_BOUNDS`.
        worst: for each quantity, the value that comes nearest to a bound or exceeds it most, and its stamp.
        stamp_ns: the first stamp at which a bound is exceeded; None: comfortable.
    """

    is_comfortable: bool
    quantities: Mapping[str, Float64]
    worst: Mapping[str, tuple[float, int]]
    stamp_ns: int | None


def differentiate(times_s: Float64, values: Float64, *, window: int, degree: int, order: int) -> Float64:
    """Differentiate samples by fitting a polynomial to the samples around each one (Savitzky and Golay, 1964).

    The samples need not be evenly spaced. Near the ends the window is shifted, not shortened. The result is exact for
    polynomials up to the degree.

    Args:
        times_s: (T,) increasing times.
        values: (T,) samples, or (T, C).
        window: number of samples in a window; at most T are used.
        degree: degree of the polynomial.
        order: order of the derivative.

    Raises:
        UsageError: there are fewer samples than the polynomial has coefficients.
    """
    from mirror.metrics.safety.comfort_kernels import local_derivatives

    count = min(window, len(times_s))
    if count <= degree:
        raise UsageError(f"{len(times_s)} samples", expected=f"at least {degree + 1}")
    # Times in a window are at most 2 after this.
    scale = 0.5 * max(count - 1, 1) * (times_s[-1] - times_s[0]) / max(len(times_s) - 1, 1)
    samples = np.ascontiguousarray(values.reshape(len(times_s), -1))
    # Large constant parts, such as a heading after many turns, would cost digits.
    found = local_derivatives(times_s, samples - samples[0], count, degree, order, scale)
    return np.asarray(found.reshape(values.shape) / scale**order)


def measure_comfort(log: StateLog, bounds: Mapping[str, tuple[float, float]] = COMFORT_BOUNDS) -> Comfort:
    """Compare the ego's motion with bounds of comfort.

    The quantities are derivatives of logged velocities and headings, by `differentiate`: acceleration over 9 stamps,
    jerk as its derivative over 15, yaw rate and yaw acceleration over 5, with the degrees of nuPlan (2, and 3 for the
    yaw acceleration). nuPlan smooths a recorded acceleration over 8 stamps instead; a log of states has none.
    Longitudinal and lateral refer to the heading at the stamp; jerk is the derivative of the norm of the acceleration,
    as in nuPlan.

    Args:
        log: states; only the ego is read.
        bounds: least and largest comfortable value of each quantity.

    Raises:
        UsageError: the log has fewer than four stamps.
    """
    times = log.times_s
    if len(times) < LEAST_STAMPS:
        raise UsageError(f"{len(times)} stamps", expected=f"at least {LEAST_STAMPS}")
    velocity = np.stack([log.vx_mps[:, 0], log.vy_mps[:, 0]], axis=1)
    acceleration = differentiate(times, velocity, window=_ACCELERATION_WINDOW, degree=2, order=1)
    cos, sin = np.cos(log.yaw_rad[:, 0]), np.sin(log.yaw_rad[:, 0])
    ahead = acceleration[:, 0] * cos + acceleration[:, 1] * sin
    norm = np.hypot(acceleration[:, 0], acceleration[:, 1])
    jerks = differentiate(times, np.stack([ahead, norm], axis=1), window=_JERK_WINDOW, degree=2, order=1)
    yaw = np.unwrap(log.yaw_rad[:, 0])
    quantities = {
        "longitudinal_acceleration_mps2": ahead,
        "lateral_acceleration_mps2": acceleration[:, 1] * cos - acceleration[:, 0] * sin,
        "jerk_mps3": np.abs(jerks[:, 1]),
        "longitudinal_jerk_mps3": jerks[:, 0],
        "yaw_acceleration_radps2": differentiate(times, yaw, window=_YAW_WINDOW, degree=3, order=2),
        "yaw_rate_radps": differentiate(times, yaw, window=_YAW_WINDOW, degree=2, order=1),
    }
    worst, exceeded = {}, np.zeros(len(times), np.bool_)
    for name, (low, high) in bounds.items():
        beyond = np.maximum(low - quantities[name], quantities[name] - high)
        row = int(np.argmax(beyond))
        worst[name] = float(quantities[name][row]), int(log.stamps_ns[row])
        exceeded |= beyond > 0.0
    stamp = int(log.stamps_ns[np.argmax(exceeded)]) if exceeded.any() else None
    return Comfort(not exceeded.any(), quantities, worst, stamp)
