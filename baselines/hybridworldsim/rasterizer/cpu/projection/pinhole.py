"""Projects Gaussians into a pinhole camera by EWA splatting, eight at a time, and keeps those that reach the image.

All computations are in float64. The 3D covariance is not computed: its square root, the axes times the scales, is
projected. The 2D determinant is then a sum of squares (Cauchy-Binet), which is exact for needles. Conventions are
gsplat's (`ProjectionEWA3DGSFused.cu`, `Utils.cuh`).
"""

from __future__ import annotations

from typing import Any

from hybridworldsim.kernels import lanes
from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.rasterizer.cpu.projection.ellipses import (
    dot,
    find_candidates,
    multiply,
    rotation,
    row_times_matrix,
    to_camera,
    write_records,
)


@kernel(inline="always")
def jacobian(camera: Any, u: Any, v: Any, inverse_depth: Any) -> Any:
    """Compute the two rows of d pixel / d world, and the clamped u = x/z and v = y/z used for them."""
    u = lanes.min_or_b(lanes.max_or_b(u, camera.left), camera.right)
    v = lanes.min_or_b(lanes.max_or_b(v, camera.top), camera.bottom)
    a, b = camera.fx * inverse_depth, camera.fy * inverse_depth
    return (
        (a * (camera.r00 - u * camera.r20), a * (camera.r01 - u * camera.r21), a * (camera.r02 - u * camera.r22)),
        (b * (camera.r10 - v * camera.r20), b * (camera.r11 - v * camera.r21), b * (camera.r12 - v * camera.r22)),
        u,
        v,
    )


@kernel(inline="always")
def covariance(a: Any, b: Any) -> Any:
    """Compute xx, xy, yy and the determinant of the 2D covariance from its root rows a and b."""
    m0 = a[1] * b[2] - a[2] * b[1]
    m1 = a[2] * b[0] - a[0] * b[2]
    m2 = a[0] * b[1] - a[1] * b[0]
    return dot(a, a), dot(a, b), dot(b, b), m0 * m0 + m1 * m1 + m2 * m2


@kernel()
def project_part(camera: Any, gaussians: Any, begin: Any, end: Any, rows: Any, output: Any, counts: Any) -> Any:
    """Project a range of Gaussians and write the visible ones in order; return the number written.

    Args:
        camera: `KernelCamera`.
        gaussians: (3 N,), (4 N,), (3 N,), (N,).
        begin: first Gaussian.
        end: one past the last.
        rows: (end - begin + 8,) int64 scratch.
        output: arrays as in `RECORD`, end - begin + 8 rows.
        counts: (6,) int64 numbers of culled Gaussians in the order of `CAUSES`; they are increased.
    """
    means, quats, scales, opacities = gaussians
    found = find_candidates(camera, gaussians, begin, end, rows, counts)
    written = 0
    for start in range(0, found, 8):
        x, y, z = to_camera(camera, lanes.load_triples(means, rows, start))
        first, second, third, _, is_rotation = rotation(lanes.load_quadruples(quats, rows, start))
        inverse_depth = 1.0 / z
        u, v = x * inverse_depth, y * inverse_depth
        over_x, over_y, _, _ = jacobian(camera, u, v, inverse_depth)
        a, b = row_times_matrix(over_x, first, second, third), row_times_matrix(over_y, first, second, third)
        scale = lanes.load_triples(scales, rows, start)
        shape = covariance(multiply(a, scale), multiply(b, scale))
        mean = camera.fx * u + camera.cx, camera.fy * v + camera.cy
        opacity = lanes.gather(opacities, rows, start, 1, 0)
        lanes_in_use = lanes.first_lanes(found - start)
        valid_lanes = lanes_in_use & is_rotation
        counts[5] += lanes.count_set(lanes_in_use) - lanes.count_set(valid_lanes)
        written = write_records(camera, rows, start, valid_lanes, mean, z, shape, opacity, written, output, counts)
    return written
