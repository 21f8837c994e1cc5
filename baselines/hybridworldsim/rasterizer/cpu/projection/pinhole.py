"""Project Gaussians into one pinhole camera by EWA splatting, eight at a time, and keep those that reach the picture.

Everything is float64 until it is stored. The covariance never forms in three dimensions: its square root, the axes
times the scales, is projected, so that the 2D determinant is a sum of squares (Cauchy-Binet) and a needle keeps its
width. Conventions are gsplat's (`ProjectionEWA3DGSFused.cu`, `Utils.cuh`).
"""

from __future__ import annotations

from typing import Any

from hybridworldsim.kernels import lanes
from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.rasterizer.cpu.projection.ellipses import (
    along,
    candidates,
    dot,
    record,
    rotation,
    times,
    to_camera,
)


@kernel(inline="always")
def jacobian(view: Any, u: Any, v: Any, inverse_depth: Any) -> Any:
    """Of pixels by world coordinates: its two rows, and the clamped u = x/z, v = y/z that they were taken at."""
    u = lanes.lesser(lanes.greater(u, view.left), view.right)
    v = lanes.lesser(lanes.greater(v, view.top), view.bottom)
    a, b = view.fx * inverse_depth, view.fy * inverse_depth
    return (
        (a * (view.r00 - u * view.r20), a * (view.r01 - u * view.r21), a * (view.r02 - u * view.r22)),
        (b * (view.r10 - v * view.r20), b * (view.r11 - v * view.r21), b * (view.r12 - v * view.r22)),
        u,
        v,
    )


@kernel(inline="always")
def covariance(a: Any, b: Any) -> Any:
    """xx, xy, yy and determinant of the 2D covariance whose root has the rows a and b."""
    m0 = a[1] * b[2] - a[2] * b[1]
    m1 = a[2] * b[0] - a[0] * b[2]
    m2 = a[0] * b[1] - a[1] * b[0]
    return dot(a, a), dot(a, b), dot(b, b), m0 * m0 + m1 * m1 + m2 * m2


@kernel()
def project_part(view: Any, gaussians: Any, begin: Any, end: Any, rows: Any, output: Any, counts: Any) -> Any:
    """Project Gaussians of a range and write those that the camera sees, in order; return how many.

    Args:
        view: `View`.
        gaussians: (3 N,), (4 N,), (3 N,), (N,).
        begin: first Gaussian.
        end: past the last.
        rows: (end - begin + 8,) int64, for its own use.
        output: arrays as in `RECORD`, end - begin + 8 rows.
        counts: (6,) int64, is increased by how many were culled, by the order of `CAUSES`.
    """
    means, quats, scales, opacities = gaussians
    found = candidates(view, gaussians, begin, end, rows, counts)
    seen = 0
    for start in range(0, found, 8):
        x, y, z = to_camera(view, lanes.triples(means, rows, start))
        first, second, third, _, turned = rotation(lanes.quadruples(quats, rows, start))
        inverse_depth = 1.0 / z
        u, v = x * inverse_depth, y * inverse_depth
        over_x, over_y, _, _ = jacobian(view, u, v, inverse_depth)
        a, b = along(over_x, first, second, third), along(over_y, first, second, third)
        size = lanes.triples(scales, rows, start)
        shape = covariance(times(a, size), times(b, size))
        mean = view.fx * u + view.cx, view.fy * v + view.cy
        opacity = lanes.gather(opacities, rows, start, 1, 0)
        left = lanes.first_lanes(found - start)
        shown = left & turned
        counts[5] += lanes.how_many(left) - lanes.how_many(shown)
        seen = record(view, rows, start, shown, mean, z, shape, opacity, seen, output, counts)
    return seen
