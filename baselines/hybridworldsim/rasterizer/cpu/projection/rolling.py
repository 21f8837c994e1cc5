"""Projects Gaussians that are exposed row by row, eight at a time, with gradients.

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
from hybridworldsim.rasterizer.cpu.projection.ellipses import (
    dot,
    find_candidates,
    rotation,
    row_times_matrix,
    to_camera,
    write_records,
)
from hybridworldsim.rasterizer.cpu.projection.gradients import (
    add,
    combine,
    covariance_gradient,
    load_upstream,
    multiply_by,
    select_rows,
    store_gradients,
    store_viewmat_sums,
)
from hybridworldsim.rasterizer.cpu.projection.kernel_lens import project_point
from hybridworldsim.rasterizer.cpu.projection.unscented import (
    OUTER,
    PIXELS,
    POINTS,
    WEIGHT,
    axes_in_camera,
    moments,
    sigma_point,
    spread_gradient,
    store_steps,
)
from hybridworldsim.rasterizer.rolling_shutter import (
    NEWTON_STEPS,
    PIXEL_TOLERANCE,
    SLACK_MIN,
    SLOPE_TOLERANCE,
    TIME_FIRST,
    TIME_LAST,
)

_TIMES: Final = 352  # offset in the scratch, after the gradients to points: seven times
_RATES: Final = 408  # offset after the times: 1 / (1 - k) of each point, 0 where its time does not change
_AHEAD: Final = 464  # offset after the rates: time by which a step along each axis moves the row of the mean
_SLOPES: Final = 488  # offset after those: slopes of x and y of each point
_TURNED: Final = 824  # offset after the slopes: the seven points, turned
SCRATCH: Final = 992
"""Size of a kernel's float64 scratch array."""


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
def _solve_points(camera: Any, lens: Any, shutter: Any, mean: Any, tolerance: Any, scratch: Any) -> Any:
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
        _put_triple(scratch, _SLOPES + 48 * number, slope_x)
        _put_triple(scratch, _SLOPES + 48 * number + 24, slope_y)
        _put_triple(scratch, _TURNED + 24 * number, turned)
        inside = (x >= lens.left) & (x < lens.right) & (y >= lens.top) & (y < lens.bottom)
        visible |= lanes.to_bits(valid & determined & inside)
    return visible


@kernel(inline="always")
def _choose(mask: Any, a: Any, b: Any) -> Any:
    """Select the triple ``a`` where the mask is set, else ``b``."""
    return lanes.select(mask, a[0], b[0]), lanes.select(mask, a[1], b[1]), lanes.select(mask, a[2], b[2])


@kernel(inline="always")
def _put_triple(scratch: Any, at: Any, triple: Any) -> None:
    """Store a triple of lanes in the scratch."""
    lanes.store(scratch, at, triple[0])
    lanes.store(scratch, at + 8, triple[1])
    lanes.store(scratch, at + 16, triple[2])


@kernel(inline="always")
def _get_triple(scratch: Any, at: Any) -> Any:
    """Load a triple of lanes from the scratch."""
    return lanes.load(scratch, at), lanes.load(scratch, at + 8), lanes.load(scratch, at + 16)


@kernel()
def rolling_part(
    middle: Any,
    camera: Any,
    lens: Any,
    shutter: Any,
    gaussians: Any,
    begin: Any,
    end: Any,
    rows: Any,
    scratch: Any,
    output: Any,
    counts: Any,
) -> Any:
    """Project a range of Gaussians and write the visible ones in order; return the number written.

    Args:
        middle: `KernelCamera` at mid-readout, which depths and early culling use.
        camera: `KernelCamera` at the first row, without its translation.
        lens: `KernelLens`.
        shutter: `KernelShutter`.
        gaussians: (3 N,), (4 N,), (3 N,), (N,).
        begin: first Gaussian.
        end: one past the last.
        rows: (end - begin + 8,) int64 scratch.
        scratch: (SCRATCH,) float64 scratch.
        output: arrays as in `RECORD`, end - begin + 8 rows.
        counts: (6,) int64 numbers of culled Gaussians in the order of `CAUSES`; they are increased.
    """
    means, quats, scales, opacities = gaussians
    found = find_candidates(middle, gaussians, begin, end, rows, counts)
    written = 0
    for start in range(0, found, 8):
        world = lanes.load_triples(means, rows, start)
        mean = to_camera(camera, world)
        first, second, third, _, is_rotation = rotation(lanes.load_quadruples(quats, rows, start))
        store_steps(axes_in_camera(camera, first, second, third), lanes.load_triples(scales, rows, start), scratch)
        visible = _solve_points(camera, lens, shutter, mean, PIXEL_TOLERANCE, scratch)
        shift, shape = moments(scratch)
        centre = lanes.load(scratch, PIXELS) + shift[0], lanes.load(scratch, PIXELS + 8) + shift[1]
        lanes_in_use = lanes.first_lanes(found - start)
        whole = lanes_in_use & is_rotation
        valid_lanes = whole & lanes.from_bits(visible)
        counts[2] += lanes.count_set(whole) - lanes.count_set(valid_lanes)
        counts[5] += lanes.count_set(lanes_in_use) - lanes.count_set(whole)
        opacity = lanes.gather(opacities, rows, start, 1, 0)
        depth = to_camera(middle, world)[2]
        written = write_records(
            middle, rows, start, valid_lanes, centre, depth, shape, opacity, written, output, counts
        )
    return written


@kernel()
def rolling_part_backward(
    middle: Any,
    camera: Any,
    lens: Any,
    shutter: Any,
    gaussians: Any,
    ids: Any,
    upstream: Any,
    strides: Any,
    begin: Any,
    end: Any,
    rows: Any,
    scratch: Any,
    buffer: Any,
    output: Any,
    grad_view: Any,
) -> None:
    """Compute the gradients of a range of visible Gaussians; write zeros for invisible Gaussians between them.

    Args:
        middle: `KernelCamera` at mid-readout.
        camera: `KernelCamera` at the first row, without its translation.
        lens: `KernelLens`.
        shutter: `KernelShutter`.
        gaussians: (3 N,), (4 N,), (3 N,).
        ids: (M,) indices of the visible Gaussians, ascending.
        upstream: gradients to the output records, see the module `gradients`.
        strides: strides of `upstream`.
        begin: first visible Gaussian.
        end: one past the last.
        rows: (16,) int64 scratch.
        scratch: (SCRATCH,) float64 scratch.
        buffer: (80,) scratch in the dtype of the output.
        output: (N, 3), (N, 4), (N, 3), the gradients; the caller fills the rows after the last visible Gaussian.
        grad_view: (18,) output, the sums of this part for the first pose's rotation, row by row, and translation, for
            the rotation vector and for the change of the translation.
    """
    means, quats, scales = gaussians
    view_x, view_y = (camera.r00, camera.r01, camera.r02), (camera.r10, camera.r11, camera.r12)
    view_z = (camera.r20, camera.r21, camera.r22)
    vector = shutter.w0, shutter.w1, shutter.w2
    zero, half = lanes.broadcast(0.0), lanes.broadcast(0.5)
    sum_x, sum_y, sum_z, sum_t = (zero, zero, zero), (zero, zero, zero), (zero, zero, zero), (zero, zero, zero)
    sum_w, sum_d = (zero, zero, zero), (zero, zero, zero)
    next_row = 0 if begin == 0 else ids[begin - 1] + 1
    for start in range(begin, end, 8):
        select_rows(ids, start, end, rows)
        world, quat = lanes.load_triples(means, rows, 8), lanes.load_quadruples(quats, rows, 8)
        scale = lanes.load_triples(scales, rows, 8)
        mean = to_camera(camera, world)
        first, second, third, k, _ = rotation(quat)
        axes = axes_in_camera(camera, first, second, third)
        store_steps(axes, scale, scratch)
        _solve_points(camera, lens, shutter, mean, SLOPE_TOLERANCE, scratch)
        shift, shape = moments(scratch)

        grad_mean2d, grad_depth, grad_conic, grad_compensation = load_upstream(
            upstream, strides, rows, lanes.first_lanes(end - start)
        )
        grad_xx, grad_xy, grad_yy = covariance_gradient(middle, shape, grad_conic, grad_compensation)
        shift_x = WEIGHT * (grad_mean2d[0] + 2.0 * OUTER * (grad_xx * shift[0] + grad_xy * shift[1]))
        shift_y = WEIGHT * (grad_mean2d[1] + 2.0 * OUTER * (grad_xy * shift[0] + grad_yy * shift[1]))
        rest_x, rest_y = grad_mean2d
        grad_turned_mean = (zero, zero, zero)
        for back in range(8):
            # the mean is last but one: its gradient is the rest; then follows its depth, at mid-readout
            number = 6 - back if back < 7 else 0
            time = lanes.load(scratch, _TIMES + 8 * number) if back < 7 else half
            slope_x = _get_triple(scratch, _SLOPES + 48 * number)
            slope_y = _get_triple(scratch, _SLOPES + 48 * number + 24)
            turned = _get_triple(scratch, _TURNED + 24 * number)
            if back == 7:
                a, b, _ = _turns(shutter, half)
                turned = _turn(shutter, a, b, mean)
            velocity = add(_cross(vector, turned), (shutter.d0, shutter.d1, shutter.d2))
            grad_pixel_x, grad_pixel_y = rest_x, rest_y
            if number > 0:
                at = PIXELS + 16 * number
                x, y = lanes.load(scratch, at), lanes.load(scratch, at + 8)
                grad_pixel_x = 2.0 * WEIGHT * (grad_xx * x + grad_xy * y) + shift_x
                grad_pixel_y = 2.0 * WEIGHT * (grad_xy * x + grad_yy * y) + shift_y
                rest_x, rest_y = rest_x - grad_pixel_x, rest_y - grad_pixel_y
            grad_time = grad_pixel_x * dot(slope_x, velocity) + grad_pixel_y * dot(slope_y, velocity)
            grad_time = grad_time * lanes.load(scratch, _RATES + 8 * number)
            grad_place = combine(
                grad_pixel_x + grad_time * shutter.per_x, slope_x, grad_pixel_y + grad_time * shutter.per_y, slope_y
            )
            if back == 7:
                grad_place = (zero, zero, grad_depth)
            a, b, cubic = _turns(shutter, time)
            grad_point = _turn(shutter, 0.0 - a, b, grad_place)
            if number > 0:
                lanes.store(scratch, POINTS + 24 * number, grad_point[0])
                lanes.store(scratch, POINTS + 24 * number + 8, grad_point[1])
                lanes.store(scratch, POINTS + 24 * number + 16, grad_point[2])
            grad_turned_mean = add(grad_turned_mean, grad_point)
            moment = _cross(turned, grad_place)
            across = _cross(vector, moment)
            sum_t, sum_d = add(sum_t, grad_place), add(sum_d, multiply_by(time, grad_place))
            sum_w = add(sum_w, multiply_by(time, moment))
            sum_w = add(sum_w, combine(0.0 - b, across, cubic, _cross(vector, across)))

        grad_quat, grad_scale, part_x, part_y, part_z = spread_gradient(
            camera, quat, k, scale, axes, first, second, third, grad_turned_mean, world, scratch
        )
        sum_x, sum_y, sum_z = add(sum_x, part_x), add(sum_y, part_y), add(sum_z, part_z)
        grad_mean = row_times_matrix(grad_turned_mean, view_x, view_y, view_z)
        next_row = store_gradients(rows, end - start, next_row, buffer, grad_mean, grad_quat, grad_scale, output)
    store_viewmat_sums(sum_x, sum_y, sum_z, sum_t, grad_view)
    grad_view[12], grad_view[13] = lanes.sum_lanes(sum_w[0]), lanes.sum_lanes(sum_w[1])
    grad_view[14], grad_view[15] = lanes.sum_lanes(sum_w[2]), lanes.sum_lanes(sum_d[0])
    grad_view[16], grad_view[17] = lanes.sum_lanes(sum_d[1]), lanes.sum_lanes(sum_d[2])
