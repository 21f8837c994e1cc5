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
    quaternion_gradient,
    scale,
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
    to_viewmat: Any,
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
        to_viewmat: (12,) output, the sums of this part for the rotation, row by row, and the translation.
    """
    means, quats, scales = gaussians
    view_x, view_y = (camera.r00, camera.r01, camera.r02), (camera.r10, camera.r11, camera.r12)
    view_z = (camera.r20, camera.r21, camera.r22)
    zero = lanes.broadcast(0.0)
    sum_x, sum_y, sum_z, sum_t = (zero, zero, zero), (zero, zero, zero), (zero, zero, zero), (zero, zero, zero)
    next_row = 0 if begin == 0 else ids[begin - 1] + 1
    for start in range(begin, end, 8):
        select_rows(ids, start, end, rows)
        world, quaternion = lanes.load_triples(means, rows, 8), lanes.load_quadruples(quats, rows, 8)
        size = lanes.load_triples(scales, rows, 8)
        x, y, z = to_camera(camera, world)
        first, second, third, k, _ = rotation(quaternion)
        inverse_depth = 1.0 / z
        u, v = x * inverse_depth, y * inverse_depth
        over_x, over_y, clamped_u, clamped_v = jacobian(camera, u, v, inverse_depth)
        a, b = row_times_matrix(over_x, first, second, third), row_times_matrix(over_y, first, second, third)
        root_x, root_y = multiply(a, size), multiply(b, size)

        to_mean, to_depth, to_conic, to_compensation = load_upstream(
            upstream, strides, rows, lanes.first_lanes(end - start)
        )
        shape = covariance(root_x, root_y)
        to_xx, to_xy, to_yy = covariance_gradient(camera, shape, to_conic, to_compensation)
        to_root_x = combine(2.0 * to_xx, root_x, 2.0 * to_xy, root_y)
        to_root_y = combine(2.0 * to_xy, root_x, 2.0 * to_yy, root_y)
        to_size = add(multiply(to_root_x, a), multiply(to_root_y, b))
        to_a, to_b = multiply(to_root_x, size), multiply(to_root_y, size)
        to_quaternion = quaternion_gradient(
            quaternion,
            k,
            combine(over_x[0], to_a, over_y[0], to_b),
            combine(over_x[1], to_a, over_y[1], to_b),
            combine(over_x[2], to_a, over_y[2], to_b),
        )

        # rows of the Jacobian: fx / z * (view_x - u view_z), fy / z * (view_y - v view_z)
        to_over_x = (dot(to_a, first), dot(to_a, second), dot(to_a, third))
        to_over_y = (dot(to_b, first), dot(to_b, second), dot(to_b, third))
        by_x, by_y = camera.fx * inverse_depth, camera.fy * inverse_depth
        depth_x, depth_y = dot(to_over_x, view_z), dot(to_over_y, view_z)
        to_inverse = camera.fx * (dot(to_over_x, view_x) - clamped_u * depth_x)
        to_inverse = to_inverse + camera.fy * (dot(to_over_y, view_y) - clamped_v * depth_y)
        free_u, free_v = (u >= camera.left) & (u <= camera.right), (v >= camera.top) & (v <= camera.bottom)
        to_u = camera.fx * to_mean[0] - lanes.select(free_u, by_x * depth_x, 0.0)
        to_v = camera.fy * to_mean[1] - lanes.select(free_v, by_y * depth_y, 0.0)
        to_inverse = to_inverse + x * to_u + y * to_v
        to_x, to_y = inverse_depth * to_u, inverse_depth * to_v
        to_z = to_depth - inverse_depth * inverse_depth * to_inverse
        to_world = row_times_matrix((to_x, to_y, to_z), view_x, view_y, view_z)

        sum_x = add(sum_x, combine(by_x, to_over_x, to_x, world))
        sum_y = add(sum_y, combine(by_y, to_over_y, to_y, world))
        tilted = combine(0.0 - by_x * clamped_u, to_over_x, 0.0 - by_y * clamped_v, to_over_y)
        sum_z = add(sum_z, add(tilted, scale(to_z, world)))
        sum_t = add(sum_t, (to_x, to_y, to_z))
        next_row = store_gradients(rows, end - start, next_row, buffer, to_world, to_quaternion, to_size, output)
    store_viewmat_sums(sum_x, sum_y, sum_z, sum_t, to_viewmat)
