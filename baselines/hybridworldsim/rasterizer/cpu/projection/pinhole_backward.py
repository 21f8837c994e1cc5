"""Gradients of the EWA projection, from recomputed values, eight Gaussians at a time, in float64."""

from __future__ import annotations

from typing import Any

from hybridworldsim.kernels import lanes
from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.rasterizer.cpu.projection.ellipses import dot, multiply, rotation, row_times_matrix, to_camera
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
from hybridworldsim.rasterizer.cpu.projection.pinhole import covariance, jacobian


@kernel()
def project_part_backward(
    camera: Any,
    gaussians: Any,
    ids: Any,
    upstream: Any,
    strides: Any,
    begin: Any,
    end: Any,
    rows: Any,
    buffer: Any,
    output: Any,
    grad_viewmat: Any,
) -> None:
    """Compute the gradients of a range of visible Gaussians; write zeros for invisible Gaussians between them.

    Args:
        camera: `KernelCamera`.
        gaussians: (3 N,), (4 N,), (3 N,).
        ids: (M,) indices of the visible Gaussians, ascending.
        upstream: gradients to the output records, see the module `gradients`.
        strides: strides of `upstream`.
        begin: first visible Gaussian.
        end: one past the last.
        rows: (16,) int64 scratch.
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
        x, y, z = to_camera(camera, world)
        first, second, third, k, _ = rotation(quat)
        inverse_depth = 1.0 / z
        u, v = x * inverse_depth, y * inverse_depth
        over_x, over_y, clamped_u, clamped_v = jacobian(camera, u, v, inverse_depth)
        a, b = row_times_matrix(over_x, first, second, third), row_times_matrix(over_y, first, second, third)
        root_x, root_y = multiply(a, scale), multiply(b, scale)

        grad_mean2d, grad_depth, grad_conic, grad_compensation = load_upstream(
            upstream, strides, rows, lanes.first_lanes(end - start)
        )
        shape = covariance(root_x, root_y)
        grad_xx, grad_xy, grad_yy = covariance_gradient(camera, shape, grad_conic, grad_compensation)
        grad_root_x = combine(2.0 * grad_xx, root_x, 2.0 * grad_xy, root_y)
        grad_root_y = combine(2.0 * grad_xy, root_x, 2.0 * grad_yy, root_y)
        grad_scale = add(multiply(grad_root_x, a), multiply(grad_root_y, b))
        grad_a, grad_b = multiply(grad_root_x, scale), multiply(grad_root_y, scale)
        grad_quat = quaternion_gradient(
            quat,
            k,
            combine(over_x[0], grad_a, over_y[0], grad_b),
            combine(over_x[1], grad_a, over_y[1], grad_b),
            combine(over_x[2], grad_a, over_y[2], grad_b),
        )

        # rows of the Jacobian: fx / z * (view_x - u view_z), fy / z * (view_y - v view_z)
        grad_over_x = (dot(grad_a, first), dot(grad_a, second), dot(grad_a, third))
        grad_over_y = (dot(grad_b, first), dot(grad_b, second), dot(grad_b, third))
        fx_over_z, fy_over_z = camera.fx * inverse_depth, camera.fy * inverse_depth
        depth_x, depth_y = dot(grad_over_x, view_z), dot(grad_over_y, view_z)
        grad_inverse = camera.fx * (dot(grad_over_x, view_x) - clamped_u * depth_x)
        grad_inverse = grad_inverse + camera.fy * (dot(grad_over_y, view_y) - clamped_v * depth_y)
        free_u, free_v = (u >= camera.left) & (u <= camera.right), (v >= camera.top) & (v <= camera.bottom)
        grad_u = camera.fx * grad_mean2d[0] - lanes.select(free_u, fx_over_z * depth_x, 0.0)
        grad_v = camera.fy * grad_mean2d[1] - lanes.select(free_v, fy_over_z * depth_y, 0.0)
        grad_inverse = grad_inverse + x * grad_u + y * grad_v
        grad_x, grad_y = inverse_depth * grad_u, inverse_depth * grad_v
        grad_z = grad_depth - inverse_depth * inverse_depth * grad_inverse
        grad_mean = row_times_matrix((grad_x, grad_y, grad_z), view_x, view_y, view_z)

        sum_x = add(sum_x, combine(fx_over_z, grad_over_x, grad_x, world))
        sum_y = add(sum_y, combine(fy_over_z, grad_over_y, grad_y, world))
        tilted = combine(0.0 - fx_over_z * clamped_u, grad_over_x, 0.0 - fy_over_z * clamped_v, grad_over_y)
        sum_z = add(sum_z, add(tilted, multiply_by(grad_z, world)))
        sum_t = add(sum_t, (grad_x, grad_y, grad_z))
        next_row = store_gradients(rows, end - start, next_row, buffer, grad_mean, grad_quat, grad_scale, output)
    store_viewmat_sums(sum_x, sum_y, sum_z, sum_t, grad_viewmat)
