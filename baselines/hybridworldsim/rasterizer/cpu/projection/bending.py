"""Where a lens shows points, eight at a time, and how fast that moves."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hybridworldsim.kernels import lanes
from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.rasterizer.cpu.projection.view import View
from hybridworldsim.rasterizer.lenses import IMAGE_MARGIN, RADIAL_MIN, Lens


class Bending(NamedTuple):
    """A lens, as kernels take it.

    Attributes:
        fisheye: whether it is one; else a pinhole's.
        k1: to `k6` radial, `p1` and `p2` tangential, `s1` to `s4` thin prism coefficients; zero where there are none.
        last: angle to the optical axis beyond which a fisheye shows nothing, radians.
        left: `right`, `top`, `bottom`: bounds of the pixels at which a point counts as seen.
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


def bending_of(lens: Lens, view: View) -> Bending:
    """Gather what kernels need of a lens.

    Args:
        lens: what bends the rays.
        view: the camera behind it.
    """
    width, height = int(view.width), int(view.height)
    fisheye = lens.model == "fisheye"
    last = lens.max_angle(view.fx, view.fy, view.cx, view.cy, width, height) if fisheye else 0.0
    coefficients = [0.0] * 12
    for begin, given in ((0, lens.radial_coeffs), (6, lens.tangential_coeffs), (8, lens.thin_prism_coeffs)):
        coefficients[begin : begin + len(given)] = given
    beside_x, beside_y = IMAGE_MARGIN * width, IMAGE_MARGIN * height
    bounds = (-beside_x, width + beside_x, -beside_y, height + beside_y)
    return Bending(fisheye, *map(float, (*coefficients, last, *bounds)))


@kernel(inline="always")
def _angle(opposite: Any, adjacent: Any) -> Any:
    """Inverse tangent of opposite / adjacent, neither negative and not both zero, to 1e-15 relative."""
    steep = opposite > adjacent
    t = lanes.choose(steep, adjacent / opposite, opposite / adjacent)
    # halved twice: t < 0.2
    t = t / (1.0 + lanes.root(1.0 + t * t))
    t = t / (1.0 + lanes.root(1.0 + t * t))
    q = t * t
    series = 1 / 17 - q * (1 / 19 - q * (1 / 21))
    series = 1 / 9 - q * (1 / 11 - q * (1 / 13 - q * (1 / 15 - q * series)))
    series = 1.0 - q * (1 / 3 - q * (1 / 5 - q * (1 / 7 - q * series)))
    angle = 4.0 * t * series
    return lanes.choose(steep, 0.5 * np.pi - angle, angle)


@kernel(inline="always")
def _through_fisheye(view: Any, lens: Any, x: Any, y: Any, z: Any) -> Any:
    """As `pixel`, for z > 0 (OpenCV's fisheye model)."""
    squared = x * x + y * y
    off_axis = squared > 0.0
    r = lanes.choose(off_axis, lanes.root(squared), 1.0)
    full = _angle(r, z)
    angle = lanes.lesser(full, lens.last)
    q = angle * angle
    grown = angle * (1.0 + q * (lens.k1 + q * (lens.k2 + q * (lens.k3 + q * lens.k4))))
    growth = 1.0 + q * (3.0 * lens.k1 + q * (5.0 * lens.k2 + q * (7.0 * lens.k3 + q * 9.0 * lens.k4)))
    growth = lanes.choose(full <= lens.last, growth, 0.0) / (squared + z * z)
    scale = lanes.choose(off_axis, grown / r, 1.0 / z)
    # of the scale: by the radius, over the radius, and by depth; on the axis neither moves a pixel
    outward = lanes.choose(off_axis, (growth * z - scale) / (r * r), 0.0)
    deeper = lanes.choose(off_axis, 0.0 - growth, 0.0)
    fx, fy = view.fx, view.fy
    return (
        fx * scale * x + view.cx,
        fy * scale * y + view.cy,
        (fx * (scale + x * x * outward), fx * x * y * outward, fx * x * deeper),
        (fy * x * y * outward, fy * (scale + y * y * outward), fy * y * deeper),
        scale > 0.0,
        lanes.choose(off_axis, full, -1.0) < lens.last,
    )


@kernel(inline="always")
def _through_pinhole(view: Any, lens: Any, x: Any, y: Any, z: Any) -> Any:
    """As `pixel`, for z > 0 (Brown-Conrady, OpenCV's rational and thin prism model)."""
    u, v = x / z, y / z
    q = u * u + v * v
    above = 1.0 + q * (lens.k1 + q * (lens.k2 + q * lens.k3))
    below = 1.0 + q * (lens.k4 + q * (lens.k5 + q * lens.k6))
    possible = below > 0.0
    below = lanes.choose(possible, below, 1.0)
    radial = above / below
    above_slope = lens.k1 + q * (2.0 * lens.k2 + q * 3.0 * lens.k3)
    below_slope = lens.k4 + q * (2.0 * lens.k5 + q * 3.0 * lens.k6)
    slope = 2.0 * (above_slope - radial * below_slope) / below
    prism_u, prism_v = 2.0 * (lens.s1 + 2.0 * lens.s2 * q), 2.0 * (lens.s3 + 2.0 * lens.s4 * q)
    bent_u = radial * u + 2.0 * lens.p1 * u * v + lens.p2 * (q + 2.0 * u * u) + q * (lens.s1 + q * lens.s2)
    bent_v = radial * v + lens.p1 * (q + 2.0 * v * v) + 2.0 * lens.p2 * u * v + q * (lens.s3 + q * lens.s4)
    mixed = u * v * slope + 2.0 * (lens.p1 * u + lens.p2 * v)
    by_x, by_y = view.fx / z, view.fy / z
    uu = by_x * (radial + u * u * slope + 2.0 * lens.p1 * v + 6.0 * lens.p2 * u + u * prism_u)
    uv, vu = by_x * (mixed + v * prism_u), by_y * (mixed + u * prism_v)
    vv = by_y * (radial + v * v * slope + 6.0 * lens.p1 * v + 2.0 * lens.p2 * u + v * prism_v)
    return (
        view.fx * bent_u + view.cx,
        view.fy * bent_v + view.cy,
        (uu, uv, 0.0 - (uu * u + uv * v)),
        (vu, vv, 0.0 - (vu * u + vv * v)),
        possible,
        radial > RADIAL_MIN,
    )


@kernel(inline="always")
def pixel(view: Any, lens: Any, point: Any) -> Any:
    """Where a point of the camera's frame is shown, x and y in pixels, and gradients of both to it.

    What is behind the camera, or impossible for the lens, lies at (0, 0) and does not move. The last that is returned
    is where a point counts as seen if it lies in the picture.
    """
    ahead = point[2] > 0.0
    z = lanes.choose(ahead, point[2], 1.0)
    if lens.fisheye:
        x, y, slope_x, slope_y, possible, valid = _through_fisheye(view, lens, point[0], point[1], z)
    else:
        x, y, slope_x, slope_y, possible, valid = _through_pinhole(view, lens, point[0], point[1], z)
    possible = possible & ahead
    return (
        lanes.choose(possible, x, 0.0),
        lanes.choose(possible, y, 0.0),
        (
            lanes.choose(possible, slope_x[0], 0.0),
            lanes.choose(possible, slope_x[1], 0.0),
            lanes.choose(possible, slope_x[2], 0.0),
        ),
        (
            lanes.choose(possible, slope_y[0], 0.0),
            lanes.choose(possible, slope_y[1], 0.0),
            lanes.choose(possible, slope_y[2], 0.0),
        ),
        valid & possible,
    )
