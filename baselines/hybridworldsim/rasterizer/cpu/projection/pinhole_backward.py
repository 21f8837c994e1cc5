"""Gradients of the EWA projection: recomputed from the inputs, eight Gaussians at a time, in float64."""

from __future__ import annotations

from typing import Any

from hybridworldsim.kernels import lanes
from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.rasterizer.cpu.projection.ellipses import along, dot, rotation, times, to_camera
from hybridworldsim.rasterizer.cpu.projection.gradients import (
    asked_for,
    covariance_gradient,
    hand_back,
    mixed,
    plus,
    quaternion_gradient,
    scaled,
    select_rows,
    total_rows,
)
from hybridworldsim.rasterizer.cpu.projection.pinhole import covariance, jacobian


@kernel()
def project_part_backward(
    view: Any,
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
    """Gradients of the Gaussians that a camera saw, of a range; zeros for those between that it did not see.

    Args:
        view: `View`.
        gaussians: (3 N,), (4 N,), (3 N,).
        ids: (M,) of the Gaussians seen, ascending.
        upstream: gradients to what was written of them, see the module `gradients`.
        strides: of these.
        begin: first of those seen.
        end: past the last.
        rows: (16,) int64, for its own use, as is `buffer` (80,), of the output's type.
        buffer: see `rows`.
        output: (N, 3), (N, 4), (N, 3) get gradients; what is past the last Gaussian seen is left to the caller.
        to_viewmat: (12,) gets the part's sum for the rotation, row by row, and the translation.
    """
    means, quats, scales = gaussians
    view_x, view_y = (view.r00, view.r01, view.r02), (view.r10, view.r11, view.r12)
    view_z = (view.r20, view.r21, view.r22)
    zero = lanes.spread(0.0)
    sum_x, sum_y, sum_z, sum_t = (zero, zero, zero), (zero, zero, zero), (zero, zero, zero), (zero, zero, zero)
    done = 0 if begin == 0 else ids[begin - 1] + 1
    for start in range(begin, end, 8):
        select_rows(ids, start, end, rows)
        world, quaternion = lanes.triples(means, rows, 8), lanes.quadruples(quats, rows, 8)
        size = lanes.triples(scales, rows, 8)
        x, y, z = to_camera(view, world)
        first, second, third, k, _ = rotation(quaternion)
        inverse_depth = 1.0 / z
        u, v = x * inverse_depth, y * inverse_depth
        over_x, over_y, clamped_u, clamped_v = jacobian(view, u, v, inverse_depth)
        a, b = along(over_x, first, second, third), along(over_y, first, second, third)
        root_x, root_y = times(a, size), times(b, size)

        to_mean, to_depth, to_conic, to_compensation = asked_for(
            upstream, strides, rows, lanes.first_lanes(end - start)
        )
        shape = covariance(root_x, root_y)
        to_xx, to_xy, to_yy = covariance_gradient(view, shape, to_conic, to_compensation)
        to_root_x = mixed(2.0 * to_xx, root_x, 2.0 * to_xy, root_y)
        to_root_y = mixed(2.0 * to_xy, root_x, 2.0 * to_yy, root_y)
        to_size = plus(times(to_root_x, a), times(to_root_y, b))
        to_a, to_b = times(to_root_x, size), times(to_root_y, size)
        to_quaternion = quaternion_gradient(
            quaternion,
            k,
            mixed(over_x[0], to_a, over_y[0], to_b),
            mixed(over_x[1], to_a, over_y[1], to_b),
            mixed(over_x[2], to_a, over_y[2], to_b),
        )

        # rows of the Jacobian: fx / z * (view_x - u view_z), fy / z * (view_y - v view_z)
        to_over_x = (dot(to_a, first), dot(to_a, second), dot(to_a, third))
        to_over_y = (dot(to_b, first), dot(to_b, second), dot(to_b, third))
        by_x, by_y = view.fx * inverse_depth, view.fy * inverse_depth
        depth_x, depth_y = dot(to_over_x, view_z), dot(to_over_y, view_z)
        to_inverse = view.fx * (dot(to_over_x, view_x) - clamped_u * depth_x)
        to_inverse = to_inverse + view.fy * (dot(to_over_y, view_y) - clamped_v * depth_y)
        free_u, free_v = (u >= view.left) & (u <= view.right), (v >= view.top) & (v <= view.bottom)
        to_u = view.fx * to_mean[0] - lanes.choose(free_u, by_x * depth_x, 0.0)
        to_v = view.fy * to_mean[1] - lanes.choose(free_v, by_y * depth_y, 0.0)
        to_inverse = to_inverse + x * to_u + y * to_v
        to_x, to_y = inverse_depth * to_u, inverse_depth * to_v
        to_z = to_depth - inverse_depth * inverse_depth * to_inverse
        to_world = along((to_x, to_y, to_z), view_x, view_y, view_z)

        sum_x = plus(sum_x, mixed(by_x, to_over_x, to_x, world))
        sum_y = plus(sum_y, mixed(by_y, to_over_y, to_y, world))
        tilted = mixed(0.0 - by_x * clamped_u, to_over_x, 0.0 - by_y * clamped_v, to_over_y)
        sum_z = plus(sum_z, plus(tilted, scaled(to_z, world)))
        sum_t = plus(sum_t, (to_x, to_y, to_z))
        done = hand_back(rows, end - start, done, buffer, to_world, to_quaternion, to_size, output)
    total_rows(sum_x, sum_y, sum_z, sum_t, to_viewmat)
