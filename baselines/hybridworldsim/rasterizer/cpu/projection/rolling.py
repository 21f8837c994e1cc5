"""Projects the points of Gaussians that are exposed row by row, eight Gaussians at a time, with gradients.

The seven points of the unscented transform are each projected at the time of the row (or column) that they are seen in.
A point is x0 in the axes of the first pose. At time t, in readouts, it is ``p = E(t) x0 + T + t D`` in the camera, with
``E(t) = exp(t w)``. With u its pixel, J the slope of the lens and c the time per pixel, Newton's method solves
``c u(t) + offset = t``; the slope of the left side is ``k = c J p'``. A change dp of the point at constant time moves
the pixel by ``du = J dp + J p' dt``, with ``dt = c du = c J dp / (1 - k)`` (implicit function theorem).
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

from hybridworldsim.kernels import lanes
from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.rasterizer.cpu.projection.ellipses import dot
from hybridworldsim.rasterizer.cpu.projection.gradients import add, combine, multiply_by
from hybridworldsim.rasterizer.cpu.projection.kernel_lens import project_point
from hybridworldsim.rasterizer.cpu.projection.sigma_points import (
    MOTION,
    PIXELS,
    SLOPES,
    get_triple,
    put_triple,
    sigma_point,
)
from hybridworldsim.rasterizer.rolling_shutter import (
    NEWTON_STEPS,
    SLACK_MIN,
    TIME_FIRST,
    TIME_LAST,
)

_TIMES: Final = MOTION  # seven times
_RATES: Final = MOTION + 56  # offset after the times: 1 / (1 - k) of each point, 0 where its time does not change
_AHEAD: Final = MOTION + 112  # offset after the rates: time by which a step along each axis moves the row of the mean
_TURNED: Final = MOTION + 136  # offset after those: the seven points, turned


class KernelShutter(NamedTuple):
    """A rolling shutter in the form that kernels take.

    Attributes:
        per_x: `per_y`, `offset`: time of pixel (x, y), in readouts.
        t0: to `t2`, translation of the first view matrix, metres.
        w0: to `w2`, rotation vector of the readout.
        d0: to `d2`, change of the translation over the readout, metres.
    """

    per_x: float
    per_y: float
    offset: float
    t0: float
    t1: float
    t2: float
    w0: float
    w1: float
    w2: float
    d0: float
    d1: float
    d2: float


@kernel(inline="always")
def _cross(a: Any, b: Any) -> Any:
    """Compute the vector product of two triples."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel(inline="always")
def _turns(shutter: Any, time: Any) -> Any:
    """Compute a and b of ``E(t) = 1 + a [w] + b [w]^2``, and ``(t - a) / |w|^2``, by series that are exact to 1e-13.

    They are a = sin(t |w|) / |w| and b = (1 - cos(t |w|)) / |w|^2.
    """
    q = (shutter.w0 * shutter.w0 + shutter.w1 * shutter.w1 + shutter.w2 * shutter.w2) * time * time
    first = 1 / 20922789888000  # 1 / 16!
    second = 1 / 355687428096000  # 1 / 17!
    first = 1 / 87178291200 - q * first
    second = 1 / 1307674368000 - q * second
    first = 1 / 479001600 - q * first
    second = 1 / 6227020800 - q * second
    first = 1 / 3628800 - q * first
    second = 1 / 39916800 - q * second
    first = 1 / 40320 - q * first
    second = 1 / 362880 - q * second
    first = 1 / 720 - q * first
    second = 1 / 5040 - q * second
    first = 1 / 24 - q * first
    second = 1 / 120 - q * second
    first = 1 / 2 - q * first
    second = 1 / 6 - q * second
    cubic = time * time * time * second
    return time * (1.0 - q * second), time * time * first, cubic


@kernel(inline="always")
def _turn(shutter: Any, a: Any, b: Any, point: Any) -> Any:
    """Rotate a triple by 1 + a [w] + b [w]^2."""
    vector = shutter.w0, shutter.w1, shutter.w2
    across = _cross(vector, point)
    return add(point, combine(a, across, b, _cross(vector, across)))


@kernel(inline="always")
def _project_at(camera: Any, lens: Any, shutter: Any, point: Any, time: Any) -> Any:
    """Project a point at a time; return x, y, their slopes, the mask of `project_point`, velocity and turned point."""
    a, b, _ = _turns(shutter, time)
    turned = _turn(shutter, a, b, point)
    velocity = add(_cross((shutter.w0, shutter.w1, shutter.w2), turned), (shutter.d0, shutter.d1, shutter.d2))
    place = (
        turned[0] + shutter.t0 + time * shutter.d0,
        turned[1] + shutter.t1 + time * shutter.d1,
        turned[2] + shutter.t2 + time * shutter.d2,
    )
    x, y, slope_x, slope_y, valid = project_point(camera, lens, place)
    return x, y, slope_x, slope_y, valid, velocity, turned


@kernel(inline="always")
def solve_points(camera: Any, lens: Any, shutter: Any, mean: Any, tolerance: Any, scratch: Any) -> Any:
    """Store pixel, time, rate and slopes of the seven points; return the bits of the lanes that show one of them.

    Newton's method ends after a step of at most the tolerance, in readouts. The pixel is then moved by that step, so
    that its error is of the second order; the slopes are those before it, and their error is of the first.
    """
    visible = 0
    start = lanes.broadcast(0.5)
    for number in range(7):
        point = sigma_point(number, mean, scratch)
        time = start
        if number > 0:
            # the mean's row, and what the step to this point changes
            ahead = lanes.load(scratch, _AHEAD + 8 * ((number + 2) % 3))
            time = start + ahead if number < 4 else start - ahead
            time = lanes.min_or_b(lanes.max_or_b(time, TIME_FIRST), TIME_LAST)
        step = lanes.broadcast(1.0)
        for _ in range(NEWTON_STEPS):
            x, y, slope_x, slope_y, valid, velocity, turned = _project_at(camera, lens, shutter, point, time)
            speed_x, speed_y = dot(slope_x, velocity), dot(slope_y, velocity)
            slack = 1.0 - (shutter.per_x * speed_x + shutter.per_y * speed_y)
            determined = slack > SLACK_MIN
            rate = 1.0 / lanes.max_or_b(slack, SLACK_MIN)
            # a lane that has converged stays, so that lanes do not depend on each other
            active = lanes.abs_(step) > tolerance
            aim = time + (shutter.per_x * x + shutter.per_y * y + shutter.offset - time) * rate
            rate = lanes.select((aim < TIME_FIRST) | (aim > TIME_LAST), 0.0, rate)
            aim = lanes.min_or_b(lanes.max_or_b(aim, TIME_FIRST), TIME_LAST)
            step = lanes.select(active, aim - time, 0.0)
            x, y, time = x + step * speed_x, y + step * speed_y, time + step
            if lanes.to_bits(lanes.abs_(step) > tolerance) == 0:
                break
        determined = determined & (lanes.abs_(step) <= tolerance)
        if lanes.to_bits(determined) != 255:
            middle = _project_at(camera, lens, shutter, point, lanes.broadcast(0.5))
            x, y = lanes.select(determined, x, middle[0]), lanes.select(determined, y, middle[1])
            slope_x, slope_y = _choose(determined, slope_x, middle[2]), _choose(determined, slope_y, middle[3])
            turned = _choose(determined, turned, middle[6])
            time, rate = lanes.select(determined, time, 0.5), lanes.select(determined, rate, 0.0)
        if number == 0:
            start = time
            a, b, _ = _turns(shutter, time)
            row_slope = combine(shutter.per_x * rate, slope_x, shutter.per_y * rate, slope_y)
            for axis in range(3):
                forth = sigma_point(1 + axis, (0.0, 0.0, 0.0), scratch)
                lanes.store(scratch, _AHEAD + 8 * ((axis + 3) % 3), dot(row_slope, _turn(shutter, a, b, forth)))
        lanes.store(scratch, PIXELS + 16 * number, x)
        lanes.store(scratch, PIXELS + 16 * number + 8, y)
        lanes.store(scratch, _TIMES + 8 * number, time)
        lanes.store(scratch, _RATES + 8 * number, rate)
        put_triple(scratch, SLOPES + 48 * number, slope_x)
        put_triple(scratch, SLOPES + 48 * number + 24, slope_y)
        put_triple(scratch, _TURNED + 24 * number, turned)
        inside = (x >= lens.left) & (x < lens.right) & (y >= lens.top) & (y < lens.bottom)
        visible |= lanes.to_bits(valid & determined & inside)
    return visible


@kernel(inline="always")
def _choose(mask: Any, a: Any, b: Any) -> Any:
    """Select the triple ``a`` where the mask is set, else ``b``."""
    return lanes.select(mask, a[0], b[0]), lanes.select(mask, a[1], b[1]), lanes.select(mask, a[2], b[2])


@kernel(inline="always")
def middle_of_readout(shutter: Any, mean: Any) -> Any:
    """Return the time of mid-readout, in readouts, and the mean as it is turned then."""
    half = lanes.broadcast(0.5)
    a, b, _ = _turns(shutter, half)
    return half, _turn(shutter, a, b, mean)


@kernel(inline="always")
def seen_of(number: Any, scratch: Any) -> Any:
    """Return the time of one of the seven points, and the point as it is turned then."""
    return lanes.load(scratch, _TIMES + 8 * number), get_triple(scratch, _TURNED + 24 * number)


@kernel(inline="always")
def pixel_gradient(
    shutter: Any, number: Any, turned: Any, grad_x: Any, grad_y: Any, slope_x: Any, slope_y: Any, scratch: Any
) -> Any:
    """Compute the gradients to the pixel of a point at constant time, from those at the time of its row."""
    vector = shutter.w0, shutter.w1, shutter.w2
    velocity = add(_cross(vector, turned), (shutter.d0, shutter.d1, shutter.d2))
    grad_time = grad_x * dot(slope_x, velocity) + grad_y * dot(slope_y, velocity)
    grad_time = grad_time * lanes.load(scratch, _RATES + 8 * number)
    return grad_x + grad_time * shutter.per_x, grad_y + grad_time * shutter.per_y


@kernel(inline="always")
def motion_gradients(shutter: Any, time: Any, turned: Any, grad_place: Any, sum_w: Any, sum_d: Any) -> Any:
    """Turn the gradient to a place in the camera back to the first pose, and add to the sums of the motion.

    Args:
        shutter: `KernelShutter`.
        time: when the point is seen, in readouts.
        turned: the point as it is turned then.
        grad_place: gradient to its place in the camera.
        sum_w: sum of the gradients to the rotation vector.
        sum_d: sum of the gradients to the change of the translation.

    Returns:
        The gradient to the point in the axes of the first pose, and both sums.
    """
    vector = shutter.w0, shutter.w1, shutter.w2
    a, b, cubic = _turns(shutter, time)
    moment = _cross(turned, grad_place)
    across = _cross(vector, moment)
    sum_w = add(sum_w, multiply_by(time, moment))
    sum_w = add(sum_w, combine(0.0 - b, across, cubic, _cross(vector, across)))
    return _turn(shutter, 0.0 - a, b, grad_place), sum_w, add(sum_d, multiply_by(time, grad_place))
