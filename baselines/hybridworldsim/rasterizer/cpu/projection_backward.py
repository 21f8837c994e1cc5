"""Gradients of the EWA projection: recomputed from the inputs, eight Gaussians at a time, in float64."""

from __future__ import annotations

from typing import Any

from hybridworldsim.rasterizer.cpu import lanes
from hybridworldsim.rasterizer.cpu.ellipses import along, dot, rotation, times, to_camera
from hybridworldsim.rasterizer.cpu.kernels import kernel
from hybridworldsim.rasterizer.cpu.projection import covariance, jacobian

_RATIO_MIN = 1e-290


@kernel(inline="always")
def _scaled(factor: Any, triple: Any) -> Any:
    return factor * triple[0], factor * triple[1], factor * triple[2]


@kernel(inline="always")
def _mixed(a: Any, first: Any, b: Any, second: Any) -> Any:
    return a * first[0] + b * second[0], a * first[1] + b * second[1], a * first[2] + b * second[2]


@kernel(inline="always")
def _plus(a: Any, b: Any) -> Any:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel(inline="always")
def covariance_gradient(view: Any, xx: Any, xy: Any, yy: Any, sharp: Any, to_conic: Any, to_compensation: Any) -> Any:
    """Gradient to xx, xy and yy of the 2D covariance (xy as one of two equal entries).

    Args:
        view: `View`.
        xx: of the covariance before the blur, as are `xy` and `yy`.
        xy: see `xx`.
        yy: see `xx`.
        sharp: its determinant.
        to_conic: gradients to the three entries of the conic.
        to_compensation: gradient to the compensation.
    """
    blurred_x, blurred_y = xx + view.blur, yy + view.blur
    inverse = 1.0 / (sharp + view.blur * (xx + yy) + view.blur * view.blur)
    p, q, r = blurred_y * inverse, 0.0 - xy * inverse, blurred_x * inverse
    half = 0.5 * to_conic[1]
    t00, t01 = p * to_conic[0] + q * half, p * half + q * to_conic[2]
    t10, t11 = q * to_conic[0] + r * half, q * half + r * to_conic[2]
    to_xx, to_xy, to_yy = 0.0 - (t00 * p + t01 * q), 0.0 - (t00 * q + t01 * r), 0.0 - (t10 * q + t11 * r)
    if view.antialiased:
        ratio = sharp * inverse
        free = (ratio > view.ratio_min) & (ratio > _RATIO_MIN)
        to_ratio = lanes.choose(free, 0.5 * to_compensation / lanes.root(ratio), 0.0) * inverse
        to_xx = to_xx + to_ratio * (yy - ratio * blurred_y)
        to_xy = to_xy + to_ratio * (ratio - 1.0) * xy
        to_yy = to_yy + to_ratio * (xx - ratio * blurred_x)
    return to_xx, to_xy, to_yy


@kernel(inline="always")
def quaternion_gradient(quaternion: Any, k: Any, first: Any, second: Any, third: Any) -> Any:
    """Gradient to a quaternion of any norm, from that to the rows of its rotation; k = 2 / squared norm."""
    w, x, y, z = quaternion
    v01, v02, v12 = second[0] + first[1], first[2] + third[0], second[2] + third[1]
    d21, d02, d10 = third[1] - second[2], first[2] - third[0], second[0] - first[1]
    to_w = k * (x * d21 + y * d02 + z * d10)
    to_x = k * (w * d21 + y * v01 + z * v02 - 2.0 * x * (second[1] + third[2]))
    to_y = k * (w * d02 + x * v01 + z * v12 - 2.0 * y * (first[0] + third[2]))
    to_z = k * (w * d10 + x * v02 + y * v12 - 2.0 * z * (first[0] + second[1]))
    # a longer quaternion is the same rotation
    outward = 0.5 * k * (to_w * w + to_x * x + to_y * y + to_z * z)
    return to_w - outward * w, to_x - outward * x, to_y - outward * y, to_z - outward * z


@kernel()
def project_part_backward(
    view: Any,
    means: Any,
    quats: Any,
    scales: Any,
    ids: Any,
    to_means2d: Any,
    to_depths: Any,
    to_conics: Any,
    to_compensations: Any,
    strides: Any,
    begin: Any,
    end: Any,
    rows: Any,
    buffer: Any,
    to_means: Any,
    to_quats: Any,
    to_scales: Any,
    to_viewmat: Any,
) -> Any:
    """Gradients of the Gaussians that a camera saw, of a range; zeros for those between that it did not see.

    Args:
        view: `View`.
        means: (3 N,) flat.
        quats: (4 N,) flat.
        scales: (3 N,) flat.
        ids: (M,) of the Gaussians seen, ascending.
        to_means2d: (2 M,) gradient, as are the next three.
        to_depths: (M,).
        to_conics: (3 M,).
        to_compensations: (M,).
        strides: of these four from Gaussian to Gaussian; 0 for one that is three zeros, for all.
        begin: first of those seen.
        end: past the last.
        rows: (16,) int64, for its own use, as is `buffer` (80,), of the gradients' type.
        buffer: see `rows`.
        to_means: (N, 3) gets gradients, as do all that follow; those past the last Gaussian that is seen are
            left to the caller.
        to_quats: (N, 4).
        to_scales: (N, 3).
        to_viewmat: (12,) gets the part's sum for the rotation, row by row, and the translation.
    """
    row_means2d, row_depths, row_conics, row_compensations = strides
    view_x, view_y = (view.r00, view.r01, view.r02), (view.r10, view.r11, view.r12)
    view_z = (view.r20, view.r21, view.r22)
    zero = lanes.spread(0.0)
    sum_x, sum_y, sum_z, sum_t = (zero, zero, zero), (zero, zero, zero), (zero, zero, zero), (zero, zero, zero)
    done = 0 if begin == 0 else ids[begin - 1] + 1
    for start in range(begin, end, 8):
        for lane in range(8):
            rows[lane] = start + lane if start + lane < end else start
            rows[8 + lane] = ids[rows[lane]]
        left = lanes.first_lanes(end - start)
        world, quaternion = lanes.triples(means, rows, 8), lanes.quadruples(quats, rows, 8)
        x, y, z = to_camera(view, world)
        first, second, third, k = rotation(quaternion)
        inverse_depth = 1.0 / z
        u, v = x * inverse_depth, y * inverse_depth
        over_x, over_y, clamped_u, clamped_v = jacobian(view, u, v, inverse_depth)
        a, b = along(over_x, first, second, third), along(over_y, first, second, third)
        size = lanes.triples(scales, rows, 8)
        root_x, root_y = times(a, size), times(b, size)
        xx, xy, yy, sharp = covariance(root_x, root_y)

        to_conic = (
            lanes.choose(left, lanes.gather(to_conics, rows, 0, row_conics, 0), 0.0),
            lanes.choose(left, lanes.gather(to_conics, rows, 0, row_conics, 1), 0.0),
            lanes.choose(left, lanes.gather(to_conics, rows, 0, row_conics, 2), 0.0),
        )
        to_compensation = lanes.choose(left, lanes.gather(to_compensations, rows, 0, row_compensations, 0), 0.0)
        to_xx, to_xy, to_yy = covariance_gradient(view, xx, xy, yy, sharp, to_conic, to_compensation)
        to_root_x = _mixed(2.0 * to_xx, root_x, 2.0 * to_xy, root_y)
        to_root_y = _mixed(2.0 * to_xy, root_x, 2.0 * to_yy, root_y)
        to_size = _plus(times(to_root_x, a), times(to_root_y, b))
        to_a, to_b = times(to_root_x, size), times(to_root_y, size)
        to_w, to_i, to_j, to_k = quaternion_gradient(
            quaternion,
            k,
            _mixed(over_x[0], to_a, over_y[0], to_b),
            _mixed(over_x[1], to_a, over_y[1], to_b),
            _mixed(over_x[2], to_a, over_y[2], to_b),
        )

        # rows of the Jacobian: fx / z * (view_x - u view_z), fy / z * (view_y - v view_z)
        to_over_x = (dot(to_a, first), dot(to_a, second), dot(to_a, third))
        to_over_y = (dot(to_b, first), dot(to_b, second), dot(to_b, third))
        by_x, by_y = view.fx * inverse_depth, view.fy * inverse_depth
        depth_x, depth_y = dot(to_over_x, view_z), dot(to_over_y, view_z)
        to_inverse = view.fx * (dot(to_over_x, view_x) - clamped_u * depth_x)
        to_inverse = to_inverse + view.fy * (dot(to_over_y, view_y) - clamped_v * depth_y)
        free_u, free_v = (u >= view.left) & (u <= view.right), (v >= view.top) & (v <= view.bottom)
        mean_x = lanes.choose(left, lanes.gather(to_means2d, rows, 0, row_means2d, 0), 0.0)
        mean_y = lanes.choose(left, lanes.gather(to_means2d, rows, 0, row_means2d, 1), 0.0)
        to_u = view.fx * mean_x - lanes.choose(free_u, by_x * depth_x, 0.0)
        to_v = view.fy * mean_y - lanes.choose(free_v, by_y * depth_y, 0.0)
        to_inverse = to_inverse + x * to_u + y * to_v
        to_depth = lanes.choose(left, lanes.gather(to_depths, rows, 0, row_depths, 0), 0.0)
        to_x, to_y = inverse_depth * to_u, inverse_depth * to_v
        to_z = to_depth - inverse_depth * inverse_depth * to_inverse
        to_world = along((to_x, to_y, to_z), view_x, view_y, view_z)

        sum_x = _plus(sum_x, _mixed(by_x, to_over_x, to_x, world))
        sum_y = _plus(sum_y, _mixed(by_y, to_over_y, to_y, world))
        tilted = _mixed(0.0 - by_x * clamped_u, to_over_x, 0.0 - by_y * clamped_v, to_over_y)
        sum_z = _plus(sum_z, _plus(tilted, _scaled(to_z, world)))
        sum_t = _plus(sum_t, (to_x, to_y, to_z))

        lanes.put(buffer, 0, to_world[0])
        lanes.put(buffer, 8, to_world[1])
        lanes.put(buffer, 16, to_world[2])
        lanes.put(buffer, 24, to_w)
        lanes.put(buffer, 32, to_i)
        lanes.put(buffer, 40, to_j)
        lanes.put(buffer, 48, to_k)
        lanes.put(buffer, 56, to_size[0])
        lanes.put(buffer, 64, to_size[1])
        lanes.put(buffer, 72, to_size[2])
        for lane in range(min(8, end - start)):
            row = rows[8 + lane]
            for unseen in range(done, row):
                to_means[unseen, 0], to_means[unseen, 1], to_means[unseen, 2] = 0.0, 0.0, 0.0
                to_quats[unseen, 0], to_quats[unseen, 1] = 0.0, 0.0
                to_quats[unseen, 2], to_quats[unseen, 3] = 0.0, 0.0
                to_scales[unseen, 0], to_scales[unseen, 1], to_scales[unseen, 2] = 0.0, 0.0, 0.0
            to_means[row, 0], to_means[row, 1], to_means[row, 2] = buffer[lane], buffer[8 + lane], buffer[16 + lane]
            to_quats[row, 0], to_quats[row, 1] = buffer[24 + lane], buffer[32 + lane]
            to_quats[row, 2], to_quats[row, 3] = buffer[40 + lane], buffer[48 + lane]
            to_scales[row, 0], to_scales[row, 1] = buffer[56 + lane], buffer[64 + lane]
            to_scales[row, 2] = buffer[72 + lane]
            done = row + 1
    to_viewmat[0], to_viewmat[1], to_viewmat[2] = lanes.total(sum_x[0]), lanes.total(sum_x[1]), lanes.total(sum_x[2])
    to_viewmat[3], to_viewmat[4], to_viewmat[5] = lanes.total(sum_y[0]), lanes.total(sum_y[1]), lanes.total(sum_y[2])
    to_viewmat[6], to_viewmat[7], to_viewmat[8] = lanes.total(sum_z[0]), lanes.total(sum_z[1]), lanes.total(sum_z[2])
    to_viewmat[9], to_viewmat[10] = lanes.total(sum_t[0]), lanes.total(sum_t[1])
    to_viewmat[11] = lanes.total(sum_t[2])
