"""Projects Gaussians through a lens by the unscented transform, eight at a time, with gradients.

Seven points of a Gaussian are projected: its mean, and the points at `UT_SPREAD` standard deviations in both
directions of each axis. Their mean and covariance are the ellipse. The sums are relative to the projected mean, so that
they do not cancel: with w the weight of the other six points and d their offsets,
``mean = centre + m``, ``m = w sum d``,
``covariance = w sum d d' + (beta - alpha^2) m m'``.

With a rolling shutter each point is projected at the time of its own row (`rolling`); without one all points have one
pose. A kernel is compiled for either: ``shutter is None`` is decided by the type of the argument.
"""

from __future__ import annotations

from typing import Any

from hybridworldsim.kernels import lanes
from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.rasterizer.cpu.projection.ellipses import (
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
    select_rows,
    store_gradients,
    store_viewmat_sums,
)
from hybridworldsim.rasterizer.cpu.projection.kernel_lens import project_point
from hybridworldsim.rasterizer.cpu.projection.rolling import (
    middle_of_readout,
    motion_gradients,
    pixel_gradient,
    seen_of,
    solve_points,
)
from hybridworldsim.rasterizer.cpu.projection.sigma_points import (
    OUTER,
    PIXELS,
    POINTS,
    SLOPES,
    WEIGHT,
    axes_in_camera,
    get_triple,
    moments,
    put_triple,
    sigma_point,
    spread_gradient,
    store_steps,
)
from hybridworldsim.rasterizer.rolling_shutter import PIXEL_TOLERANCE, SLOPE_TOLERANCE


@kernel(inline="always")
def _project_points(camera: Any, lens: Any, mean: Any, scratch: Any, with_slopes: Any) -> Any:
    """Store pixels, and slopes if asked, of the seven points; return the bits of the lanes that show one of them."""
    visible = 0
    for number in range(7):
        x, y, slope_x, slope_y, valid = project_point(camera, lens, sigma_point(number, mean, scratch))
        lanes.store(scratch, PIXELS + 16 * number, x)
        lanes.store(scratch, PIXELS + 16 * number + 8, y)
        if with_slopes:
            put_triple(scratch, SLOPES + 48 * number, slope_x)
            put_triple(scratch, SLOPES + 48 * number + 24, slope_y)
        inside = (x >= lens.left) & (x < lens.right) & (y >= lens.top) & (y < lens.bottom)
        visible |= lanes.to_bits(valid & inside)
    return visible


@kernel()
def unscented_part(
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
        camera: the same, or with a shutter that at the first row, without its translation.
        lens: `KernelLens`.
        shutter: `KernelShutter`, or None.
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
        if shutter is None:
            visible = _project_points(camera, lens, mean, scratch, False)
        else:
            visible = solve_points(camera, lens, shutter, mean, PIXEL_TOLERANCE, scratch)
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
def unscented_part_backward(
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
        camera: the same, or with a shutter that at the first row, without its translation.
        lens: `KernelLens`.
        shutter: `KernelShutter`, or None.
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
        grad_view: (12,) output, the sums of this part for the rotation of `camera`, row by row, and the translation;
            (18,) with a shutter, which adds the sums for the rotation vector and for the change of the translation.
    """
    means, quats, scales = gaussians
    view_x, view_y = (camera.r00, camera.r01, camera.r02), (camera.r10, camera.r11, camera.r12)
    view_z = (camera.r20, camera.r21, camera.r22)
    zero = lanes.broadcast(0.0)
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
        if shutter is None:
            _project_points(camera, lens, mean, scratch, True)
        else:
            solve_points(camera, lens, shutter, mean, SLOPE_TOLERANCE, scratch)
        shift, shape = moments(scratch)

        grad_mean2d, grad_depth, grad_conic, grad_compensation = load_upstream(
            upstream, strides, rows, lanes.first_lanes(end - start)
        )
        grad_xx, grad_xy, grad_yy = covariance_gradient(middle, shape, grad_conic, grad_compensation)
        shift_x = WEIGHT * (grad_mean2d[0] + 2.0 * OUTER * (grad_xx * shift[0] + grad_xy * shift[1]))
        shift_y = WEIGHT * (grad_mean2d[1] + 2.0 * OUTER * (grad_xy * shift[0] + grad_yy * shift[1]))
        rest_x, rest_y = grad_mean2d
        grad_place = (zero, zero, grad_depth)
        sum_t = add(sum_t, grad_place)
        if shutter is None:
            grad_mean = grad_place
        else:
            time, turned = middle_of_readout(shutter, mean)
            grad_mean, sum_w, sum_d = motion_gradients(shutter, time, turned, grad_place, sum_w, sum_d)
        for back in range(7):
            number = 6 - back  # the mean is last: its gradient is the rest
            slope_x = get_triple(scratch, SLOPES + 48 * number)
            slope_y = get_triple(scratch, SLOPES + 48 * number + 24)
            grad_x, grad_y = rest_x, rest_y
            if number > 0:
                at = PIXELS + 16 * number
                x, y = lanes.load(scratch, at), lanes.load(scratch, at + 8)
                grad_x = 2.0 * WEIGHT * (grad_xx * x + grad_xy * y) + shift_x
                grad_y = 2.0 * WEIGHT * (grad_xy * x + grad_yy * y) + shift_y
                rest_x, rest_y = rest_x - grad_x, rest_y - grad_y
            if shutter is None:
                grad_point = combine(grad_x, slope_x, grad_y, slope_y)
                sum_t = add(sum_t, grad_point)
            else:
                time, turned = seen_of(number, scratch)
                grad_x, grad_y = pixel_gradient(shutter, number, turned, grad_x, grad_y, slope_x, slope_y, scratch)
                grad_place = combine(grad_x, slope_x, grad_y, slope_y)
                sum_t = add(sum_t, grad_place)
                grad_point, sum_w, sum_d = motion_gradients(shutter, time, turned, grad_place, sum_w, sum_d)
            put_triple(scratch, POINTS + 24 * number, grad_point)
            grad_mean = add(grad_mean, grad_point)

        grad_quat, grad_scale, part_x, part_y, part_z = spread_gradient(
            camera, quat, k, scale, axes, first, second, third, grad_mean, world, scratch
        )
        sum_x, sum_y, sum_z = add(sum_x, part_x), add(sum_y, part_y), add(sum_z, part_z)
        grad_means = row_times_matrix(grad_mean, view_x, view_y, view_z)
        next_row = store_gradients(rows, end - start, next_row, buffer, grad_means, grad_quat, grad_scale, output)
    store_viewmat_sums(sum_x, sum_y, sum_z, sum_t, grad_view)
    if shutter is not None:
        grad_view[12], grad_view[13] = lanes.sum_lanes(sum_w[0]), lanes.sum_lanes(sum_w[1])
        grad_view[14], grad_view[15] = lanes.sum_lanes(sum_w[2]), lanes.sum_lanes(sum_d[0])
        grad_view[16], grad_view[17] = lanes.sum_lanes(sum_d[1]), lanes.sum_lanes(sum_d[2])
