"""Projects Gaussians through a lens by the unscented transform, eight at a time, with gradients.

Seven points of a Gaussian are projected: its mean, and the points at `UT_SPREAD` standard deviations in both
directions of each axis. Their mean and covariance are the ellipse. The sums are relative to the projected mean, so that
they do not cancel: with w the weight of the other six points and d their offsets,
``mean = centre + m``, ``m = w sum d``,
``covariance = w sum d d' + (beta - alpha^2) m m'``.
"""

from __future__ import annotations

from typing import Any, Final

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
    quaternion_gradient,
    select_rows,
    store_gradients,
    store_viewmat_sums,
)
from hybridworldsim.rasterizer.cpu.projection.kernel_lens import project_point
from hybridworldsim.rasterizer.lenses import UT_ALPHA, UT_BETA, UT_SPREAD

WEIGHT: Final = 0.5 / UT_SPREAD**2
OUTER: Final = UT_BETA - UT_ALPHA**2
PIXELS: Final = 72  # offset in the scratch, after the axes: x and y of seven points
POINTS: Final = 184  # offset after the pixels: seven gradients in the camera frame
SCRATCH: Final = 352
"""Size of a kernel's float64 scratch array."""


@kernel(inline="always")
def axes_in_camera(camera: Any, first: Any, second: Any, third: Any) -> Any:
    """Compute the rows of the rotation from a Gaussian to the camera; its columns are the Gaussian's axes."""
    return (
        row_times_matrix((camera.r00, camera.r01, camera.r02), first, second, third),
        row_times_matrix((camera.r10, camera.r11, camera.r12), first, second, third),
        row_times_matrix((camera.r20, camera.r21, camera.r22), first, second, third),
    )


@kernel(inline="always")
def store_steps(axes: Any, scale: Any, scratch: Any) -> None:
    """Store the steps from the mean to the points, axis by axis."""
    lanes.store(scratch, 0, UT_SPREAD * scale[0] * axes[0][0])
    lanes.store(scratch, 8, UT_SPREAD * scale[0] * axes[1][0])
    lanes.store(scratch, 16, UT_SPREAD * scale[0] * axes[2][0])
    lanes.store(scratch, 24, UT_SPREAD * scale[1] * axes[0][1])
    lanes.store(scratch, 32, UT_SPREAD * scale[1] * axes[1][1])
    lanes.store(scratch, 40, UT_SPREAD * scale[1] * axes[2][1])
    lanes.store(scratch, 48, UT_SPREAD * scale[2] * axes[0][2])
    lanes.store(scratch, 56, UT_SPREAD * scale[2] * axes[1][2])
    lanes.store(scratch, 64, UT_SPREAD * scale[2] * axes[2][2])


@kernel(inline="always")
def sigma_point(number: Any, mean: Any, scratch: Any) -> Any:
    """Compute one of the seven points: 0 is the mean, 1 to 3 lie at positive, 4 to 6 at negative steps."""
    sign = 0.0 if number == 0 else (1.0 if number < 4 else -1.0)
    axis = 24 * ((number + 2) % 3)
    return (
        mean[0] + sign * lanes.load(scratch, axis),
        mean[1] + sign * lanes.load(scratch, axis + 8),
        mean[2] + sign * lanes.load(scratch, axis + 16),
    )


@kernel(inline="always")
def moments(scratch: Any) -> Any:
    """Compute the shift of the mean, and xx, xy, yy and the determinant of the covariance, from the points' pixels.

    The function replaces the pixels of points 1 to 6 by their offsets d.
    """
    centre_x, centre_y = lanes.load(scratch, PIXELS), lanes.load(scratch, PIXELS + 8)
    zero = lanes.broadcast(0.0)
    shift_x, shift_y, xx, xy, yy, sharp, across = zero, zero, zero, zero, zero, zero, zero
    for number in range(1, 7):
        at = PIXELS + 16 * number
        x, y = lanes.load(scratch, at) - centre_x, lanes.load(scratch, at + 8) - centre_y
        lanes.store(scratch, at, x)
        lanes.store(scratch, at + 8, y)
        shift_x, shift_y = shift_x + WEIGHT * x, shift_y + WEIGHT * y
        xx, xy, yy = xx + x * x, xy + x * y, yy + y * y
    # the determinant as a sum of squared minors (Cauchy-Binet), which is exact for needles
    for number in range(1, 7):
        at = PIXELS + 16 * number
        x, y = lanes.load(scratch, at), lanes.load(scratch, at + 8)
        minor = x * shift_y - y * shift_x
        across = across + minor * minor
        for other in range(1, number):
            minor = x * lanes.load(scratch, PIXELS + 16 * other + 8) - y * lanes.load(scratch, PIXELS + 16 * other)
            sharp = sharp + minor * minor
    return (
        (shift_x, shift_y),
        (
            WEIGHT * xx + OUTER * shift_x * shift_x,
            WEIGHT * xy + OUTER * shift_x * shift_y,
            WEIGHT * yy + OUTER * shift_y * shift_y,
            WEIGHT * WEIGHT * sharp + WEIGHT * OUTER * across,
        ),
    )


@kernel(inline="always")
def _step_gradient(coordinate: Any, scratch: Any) -> Any:
    """Compute the gradient to one coordinate of the three axes, which have a length of one standard deviation."""
    return (
        UT_SPREAD * (lanes.load(scratch, POINTS + 24 + coordinate) - lanes.load(scratch, POINTS + 96 + coordinate)),
        UT_SPREAD * (lanes.load(scratch, POINTS + 48 + coordinate) - lanes.load(scratch, POINTS + 120 + coordinate)),
        UT_SPREAD * (lanes.load(scratch, POINTS + 72 + coordinate) - lanes.load(scratch, POINTS + 144 + coordinate)),
    )


@kernel(inline="always")
def spread_gradient(
    camera: Any,
    quat: Any,
    k: Any,
    scale: Any,
    axes: Any,
    first: Any,
    second: Any,
    third: Any,
    grad_mean_camera: Any,
    world: Any,
    scratch: Any,
) -> Any:
    """Compute the gradients to quaternion and scales, and to the rows of the view's rotation, from those to the points.

    Args:
        camera: `KernelCamera`.
        quat: four lanes.
        k: 2 / squared norm of the quaternion.
        scale: three lanes.
        axes: rows of the rotation from the Gaussian to the camera.
        first: first row of the Gaussian's rotation.
        second: second row.
        third: third row.
        grad_mean_camera: gradient to the mean in the camera frame.
        world: the mean.
        scratch: the gradients to the points.
    """
    along_x, along_y, along_z = _step_gradient(0, scratch), _step_gradient(8, scratch), _step_gradient(16, scratch)
    grad_scale = (
        along_x[0] * axes[0][0] + along_y[0] * axes[1][0] + along_z[0] * axes[2][0],
        along_x[1] * axes[0][1] + along_y[1] * axes[1][1] + along_z[1] * axes[2][1],
        along_x[2] * axes[0][2] + along_y[2] * axes[1][2] + along_z[2] * axes[2][2],
    )
    grad_x = (along_x[0] * scale[0], along_x[1] * scale[1], along_x[2] * scale[2])
    grad_y = (along_y[0] * scale[0], along_y[1] * scale[1], along_y[2] * scale[2])
    grad_z = (along_z[0] * scale[0], along_z[1] * scale[1], along_z[2] * scale[2])
    grad_quat = quaternion_gradient(
        quat,
        k,
        add(combine(camera.r00, grad_x, camera.r10, grad_y), multiply_by(camera.r20, grad_z)),
        add(combine(camera.r01, grad_x, camera.r11, grad_y), multiply_by(camera.r21, grad_z)),
        add(combine(camera.r02, grad_x, camera.r12, grad_y), multiply_by(camera.r22, grad_z)),
    )
    return (
        grad_quat,
        grad_scale,
        add((dot(grad_x, first), dot(grad_x, second), dot(grad_x, third)), multiply_by(grad_mean_camera[0], world)),
        add((dot(grad_y, first), dot(grad_y, second), dot(grad_y, third)), multiply_by(grad_mean_camera[1], world)),
        add((dot(grad_z, first), dot(grad_z, second), dot(grad_z, third)), multiply_by(grad_mean_camera[2], world)),
    )


@kernel()
def unscented_part(
    camera: Any, lens: Any, gaussians: Any, begin: Any, end: Any, rows: Any, scratch: Any, output: Any, counts: Any
) -> Any:
    """Project a range of Gaussians and write the visible ones in order; return the number written.

    Args:
        camera: `KernelCamera`.
        lens: `KernelLens`.
        gaussians: (3 N,), (4 N,), (3 N,), (N,).
        begin: first Gaussian.
        end: one past the last.
        rows: (end - begin + 8,) int64 scratch.
        scratch: (SCRATCH,) float64 scratch.
        output: arrays as in `RECORD`, end - begin + 8 rows.
        counts: (6,) int64 numbers of culled Gaussians in the order of `CAUSES`; they are increased.
    """
    means, quats, scales, opacities = gaussians
    found = find_candidates(camera, gaussians, begin, end, rows, counts)
    written = 0
    for start in range(0, found, 8):
        mean = to_camera(camera, lanes.load_triples(means, rows, start))
        first, second, third, _, is_rotation = rotation(lanes.load_quadruples(quats, rows, start))
        store_steps(axes_in_camera(camera, first, second, third), lanes.load_triples(scales, rows, start), scratch)
        visible = 0
        for number in range(7):
            x, y, _, _, valid = project_point(camera, lens, sigma_point(number, mean, scratch))
            lanes.store(scratch, PIXELS + 16 * number, x)
            lanes.store(scratch, PIXELS + 16 * number + 8, y)
            inside = (x >= lens.left) & (x < lens.right) & (y >= lens.top) & (y < lens.bottom)
            visible |= lanes.to_bits(valid & inside)
        shift, shape = moments(scratch)
        centre = lanes.load(scratch, PIXELS) + shift[0], lanes.load(scratch, PIXELS + 8) + shift[1]
        lanes_in_use = lanes.first_lanes(found - start)
        whole = lanes_in_use & is_rotation
        valid_lanes = whole & lanes.from_bits(visible)
        counts[2] += lanes.count_set(whole) - lanes.count_set(valid_lanes)
        counts[5] += lanes.count_set(lanes_in_use) - lanes.count_set(whole)
        opacity = lanes.gather(opacities, rows, start, 1, 0)
        written = write_records(
            camera, rows, start, valid_lanes, centre, mean[2], shape, opacity, written, output, counts
        )
    return written


@kernel()
def unscented_part_backward(
    camera: Any,
    lens: Any,
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
    grad_viewmat: Any,
) -> None:
    """Compute the gradients of a range of visible Gaussians; write zeros for invisible Gaussians between them.

    Args:
        camera: `KernelCamera`.
        lens: `KernelLens`.
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
        grad_viewmat: (12,) output, the sums of this part for the rotation, row by row, and the translation.
    """
    means, quats, scales = gaussians
    view_x, view_y = (camera.r00, camera.r01, camera.r02), (camera.r10, camera.r11, camera.r12)
    view_z = (camera.r20, camera.r21, camera.r22)
    zero = lanes.broadcast(0.0)
    sum_x, sum_y, sum_z, sum_t = (zero, zero, zero), (zero, zero, zero), (zero, zero, zero), (zero, zero, zero)
    next_row = 0 if begin == 0 else ids[begin - 1] + 1
    for start in range(begin, end, 8):
        select_rows(ids, start, end, rows)
        world, quat = lanes.load_triples(means, rows, 8), lanes.load_quadruples(quats, rows, 8)
        scale = lanes.load_triples(scales, rows, 8)
        mean = to_camera(camera, world)
        first, second, third, k, _ = rotation(quat)
        axes = axes_in_camera(camera, first, second, third)
        store_steps(axes, scale, scratch)
        for number in range(7):
            x, y, _, _, _ = project_point(camera, lens, sigma_point(number, mean, scratch))
            lanes.store(scratch, PIXELS + 16 * number, x)
            lanes.store(scratch, PIXELS + 16 * number + 8, y)
        shift, shape = moments(scratch)

        grad_mean2d, grad_depth, grad_conic, grad_compensation = load_upstream(
            upstream, strides, rows, lanes.first_lanes(end - start)
        )
        grad_xx, grad_xy, grad_yy = covariance_gradient(camera, shape, grad_conic, grad_compensation)
        shift_x = WEIGHT * (grad_mean2d[0] + 2.0 * OUTER * (grad_xx * shift[0] + grad_xy * shift[1]))
        shift_y = WEIGHT * (grad_mean2d[1] + 2.0 * OUTER * (grad_xy * shift[0] + grad_yy * shift[1]))
        rest_x, rest_y = grad_mean2d
        grad_mean_camera = (zero, zero, grad_depth)
        for back in range(7):
            number = 6 - back  # the mean is last: its gradient is the rest
            grad_pixel_x, grad_pixel_y = rest_x, rest_y
            if number > 0:
                at = PIXELS + 16 * number
                x, y = lanes.load(scratch, at), lanes.load(scratch, at + 8)
                grad_pixel_x = 2.0 * WEIGHT * (grad_xx * x + grad_xy * y) + shift_x
                grad_pixel_y = 2.0 * WEIGHT * (grad_xy * x + grad_yy * y) + shift_y
                rest_x, rest_y = rest_x - grad_pixel_x, rest_y - grad_pixel_y
            _, _, slope_x, slope_y, _ = project_point(camera, lens, sigma_point(number, mean, scratch))
            grad_point = combine(grad_pixel_x, slope_x, grad_pixel_y, slope_y)
            lanes.store(scratch, POINTS + 24 * number, grad_point[0])
            lanes.store(scratch, POINTS + 24 * number + 8, grad_point[1])
            lanes.store(scratch, POINTS + 24 * number + 16, grad_point[2])
            grad_mean_camera = add(grad_mean_camera, grad_point)

        grad_quat, grad_scale, part_x, part_y, part_z = spread_gradient(
            camera, quat, k, scale, axes, first, second, third, grad_mean_camera, world, scratch
        )
        sum_x, sum_y, sum_z = add(sum_x, part_x), add(sum_y, part_y), add(sum_z, part_z)
        sum_t = add(sum_t, grad_mean_camera)
        grad_mean = row_times_matrix(grad_mean_camera, view_x, view_y, view_z)
        next_row = store_gradients(rows, end - start, next_row, buffer, grad_mean, grad_quat, grad_scale, output)
    store_viewmat_sums(sum_x, sum_y, sum_z, sum_t, grad_viewmat)
