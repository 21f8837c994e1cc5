"""Projects points through a lens, eight at a time, with derivatives."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hybridworldsim.kernels import lanes
from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.rasterizer.cpu.projection.kernel_camera import KernelCamera
from hybridworldsim.rasterizer.lenses import IMAGE_MARGIN, RADIAL_MIN, LensDistortion


class KernelLens(NamedTuple):
    """A lens in the form that kernels take.

    Attributes:
        fisheye: whether the lens is a fisheye; else it is a pinhole with distortion.
        k1: to `k6` radial, `p1` and `p2` tangential, `s1` to `s4` thin prism coefficients; 0 for missing ones.
        last: largest angle to the optical axis that a fisheye shows, radians.
        left: `right`, `top`, `bottom`: bounds of the pixels at which a point counts as visible.
    """

    fisheye: bool
    k1: float
    k2: float
    k3: float
    k4: float
    k5: float
    k6: float
    p1: float
    p2: float
    s1: float
    s2: float
    s3: float
    s4: float
    last: float
    left: float
    right: float
    top: float
    bottom: float


def to_kernel_lens(lens: LensDistortion, camera: KernelCamera) -> KernelLens:
    """Convert a lens to the form that kernels take.

    Args:
        lens: the lens.
        camera: the camera of the lens.
    """
    width, height = int(camera.width), int(camera.height)
    fisheye = lens.model == "fisheye"
    last = lens.max_angle(camera.fx, camera.fy, camera.cx, camera.cy, width, height) if fisheye else 0.0
    coefficients = [0.0] * 12
    for begin, given in ((0, lens.radial_coeffs), (6, lens.tangential_coeffs), (8, lens.thin_prism_coeffs)):
        coefficients[begin : begin + len(given)] = given
    margin_x, margin_y = IMAGE_MARGIN * width, IMAGE_MARGIN * height
    bounds = (-margin_x, width + margin_x, -margin_y, height + margin_y)
    return KernelLens(fisheye, *map(float, (*coefficients, last, *bounds)))


@kernel(inline="always")
def _arctan(opposite: Any, adjacent: Any) -> Any:
    """Compute atan(opposite / adjacent) to 1e-15 relative; both are at least 0, and not both are 0."""
    steep = opposite > adjacent
    t = lanes.select(steep, adjacent / opposite, opposite / adjacent)
    # the angle is halved twice, so that t < 0.2
    t = t / (1.0 + lanes.sqrt(1.0 + t * t))
    t = t / (1.0 + lanes.sqrt(1.0 + t * t))
    q = t * t
    series = 1 / 17 - q * (1 / 19 - q * (1 / 21))
    series = 1 / 9 - q * (1 / 11 - q * (1 / 13 - q * (1 / 15 - q * series)))
    series = 1.0 - q * (1 / 3 - q * (1 / 5 - q * (1 / 7 - q * series)))
    angle = 4.0 * t * series
    return lanes.select(steep, 0.5 * np.pi - angle, angle)


@kernel(inline="always")
def _project_fisheye(camera: Any, lens: Any, x: Any, y: Any, z: Any) -> Any:
    """Compute `project_point` for z > 0 by OpenCV's fisheye model."""
    squared = x * x + y * y
    off_axis = squared > 0.0
    r = lanes.select(off_axis, lanes.sqrt(squared), 1.0)
    full = _arctan(r, z)
    angle = lanes.min_or_b(full, lens.last)
    q = angle * angle
    distorted = angle * (1.0 + q * (lens.k1 + q * (lens.k2 + q * (lens.k3 + q * lens.k4))))
    derivative = 1.0 + q * (3.0 * lens.k1 + q * (5.0 * lens.k2 + q * (7.0 * lens.k3 + q * 9.0 * lens.k4)))
    derivative = lanes.select(full <= lens.last, derivative, 0.0) / (squared + z * z)
    magnification = lanes.select(off_axis, distorted / r, 1.0 / z)
    # derivatives of the magnification: by the radius, divided by the radius, and by depth; both are 0 on the axis
    outward = lanes.select(off_axis, (derivative * z - magnification) / (r * r), 0.0)
    deeper = lanes.select(off_axis, 0.0 - derivative, 0.0)
    fx, fy = camera.fx, camera.fy
    return (
        fx * magnification * x + camera.cx,
        fy * magnification * y + camera.cy,
        (fx * (magnification + x * x * outward), fx * x * y * outward, fx * x * deeper),
        (fy * x * y * outward, fy * (magnification + y * y * outward), fy * y * deeper),
        magnification > 0.0,
        lanes.select(off_axis, full, -1.0) < lens.last,
    )


@kernel(inline="always")
def _project_pinhole(camera: Any, lens: Any, x: Any, y: Any, z: Any) -> Any:
    """Compute `project_point` for z > 0 by OpenCV's rational and thin prism model (Brown-Conrady)."""
    u, v = x / z, y / z
    q = u * u + v * v
    numerator = 1.0 + q * (lens.k1 + q * (lens.k2 + q * lens.k3))
    denominator = 1.0 + q * (lens.k4 + q * (lens.k5 + q * lens.k6))
    possible = denominator > 0.0
    denominator = lanes.select(possible, denominator, 1.0)
    radial = numerator / denominator
    numerator_slope = lens.k1 + q * (2.0 * lens.k2 + q * 3.0 * lens.k3)
    denominator_slope = lens.k4 + q * (2.0 * lens.k5 + q * 3.0 * lens.k6)
    slope = 2.0 * (numerator_slope - radial * denominator_slope) / denominator
    prism_u, prism_v = 2.0 * (lens.s1 + 2.0 * lens.s2 * q), 2.0 * (lens.s3 + 2.0 * lens.s4 * q)
    distorted_u = radial * u + 2.0 * lens.p1 * u * v + lens.p2 * (q + 2.0 * u * u) + q * (lens.s1 + q * lens.s2)
    distorted_v = radial * v + lens.p1 * (q + 2.0 * v * v) + 2.0 * lens.p2 * u * v + q * (lens.s3 + q * lens.s4)
    mixed = u * v * slope + 2.0 * (lens.p1 * u + lens.p2 * v)
    fx_over_z, fy_over_z = camera.fx / z, camera.fy / z
    uu = fx_over_z * (radial + u * u * slope + 2.0 * lens.p1 * v + 6.0 * lens.p2 * u + u * prism_u)
    uv, vu = fx_over_z * (mixed + v * prism_u), fy_over_z * (mixed + u * prism_v)
    vv = fy_over_z * (radial + v * v * slope + 6.0 * lens.p1 * v + 2.0 * lens.p2 * u + v * prism_v)
    return (
        camera.fx * distorted_u + camera.cx,
        camera.fy * distorted_v + camera.cy,
        (uu, uv, 0.0 - (uu * u + uv * v)),
        (vu, vv, 0.0 - (vu * u + vv * v)),
        possible,
        radial > RADIAL_MIN,
    )


@kernel(inline="always")
def project_point(camera: Any, lens: Any, point: Any) -> Any:
    """Project a point of the camera frame; return x and y in pixels, their derivatives, and a mask.

    A point behind the camera, or outside the domain of the lens, lies at (0, 0) with derivatives of 0. The mask marks
    points that count as visible if they lie in the image.
    """
    in_front = point[2] > 0.0
    z = lanes.select(in_front, point[2], 1.0)
    if lens.fisheye:
        x, y, slope_x, slope_y, possible, valid = _project_fisheye(camera, lens, point[0], point[1], z)
    else:
        x, y, slope_x, slope_y, possible, valid = _project_pinhole(camera, lens, point[0], point[1], z)
    possible = possible & in_front
    return (
        lanes.select(possible, x, 0.0),
        lanes.select(possible, y, 0.0),
        (
            lanes.select(possible, slope_x[0], 0.0),
            lanes.select(possible, slope_x[1], 0.0),
            lanes.select(possible, slope_x[2], 0.0),
        ),
        (
            lanes.select(possible, slope_y[0], 0.0),
            lanes.select(possible, slope_y[1], 0.0),
            lanes.select(possible, slope_y[2], 0.0),
        ),
        valid & possible,
    )
