"""Projects Gaussians through a lens: the mean and covariance of seven projected points are the ellipse."""

from __future__ import annotations

import torch
from torch import Tensor

from hybridworldsim.rasterizer.lenses import IMAGE_MARGIN, RADIAL_MIN, UT_ALPHA, UT_BETA, UT_SPREAD, LensDistortion
from hybridworldsim.rasterizer.reference.rolling import RollingView, project_rolling


def project_unscented(
    means_c: Tensor,
    axes_c: Tensor,
    K: Tensor,
    width: int,
    height: int,
    lens: LensDistortion,
    rolling: RollingView | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Project by the unscented transform (Wan and van der Merwe 2000), with gsplat's parameters.

    The points are the mean, and the points at `UT_SPREAD` standard deviations in both directions of each axis. A point
    behind the camera, or outside the domain of the lens, lies at pixel (0, 0), as in gsplat.

    Args:
        means_c: (N, 3) metres, camera; with a rolling shutter, in the first camera's axes without its translation.
        axes_c: (N, 3, 3) axes as columns, with the length of one standard deviation, metres, camera.
        K: (3, 3) fx, fy, cx, cy in pixels.
        width: width of the image, pixels.
        height: height of the image, pixels.
        lens: the distortion.
        rolling: motion of the camera; None for a global shutter.

    Returns:
        Means (N, 2) in pixels; roots (N, 2, 7) of the covariances, which are roots @ roots.T, pixel^2; and whether (N,)
        the lens shows at least one of the points.
    """
    steps = UT_SPREAD * axes_c.mT  # (N, 3, 3): one axis per row
    points = torch.cat([means_c[:, None], means_c[:, None] + steps, means_c[:, None] - steps], dim=1)  # (N, 7, 3)

    def projection(points_c: Tensor) -> tuple[Tensor, Tensor]:
        return PROJECTIONS[lens.model](points_c, K, width, height, lens)

    # (N, 7, 2), (N, 7)
    pixels, valid = projection(points) if rolling is None else project_rolling(points, rolling, projection)

    # The textbook's sums have weights of about -99 and +17 that cancel. About the image of the mean, with w the weight
    # of the other six, they are  mean = centre + m,  m = w sum d,  covariance = w sum d d' + (beta - alpha^2) m m'.
    weight = 0.5 / UT_SPREAD**2
    offsets = pixels[:, 1:] - pixels[:, :1]  # (N, 6, 2): d
    shift = weight * offsets.sum(1)  # (N, 2): m
    roots = torch.cat([weight**0.5 * offsets, (UT_BETA - UT_ALPHA**2) ** 0.5 * shift[:, None]], dim=1)  # (N, 7, 2)

    size = torch.tensor([width, height], dtype=K.dtype)
    inside = ((pixels >= -IMAGE_MARGIN * size) & (pixels < (1 + IMAGE_MARGIN) * size)).all(-1)  # (N, 7)
    return pixels[:, 0] + shift, roots.mT, (inside & valid).any(1)


def _brown_conrady(points: Tensor, K: Tensor, width: int, height: int, lens: LensDistortion) -> tuple[Tensor, Tensor]:
    """Project camera points (..., 3) to pixels (..., 2) by OpenCV's rational and thin prism model; mark valid ones."""
    k1, k2, k3, k4, k5, k6 = lens.radial_coeffs
    p1, p2 = lens.tangential_coeffs
    s1, s2, s3, s4 = lens.thin_prism_coeffs
    is_behind = points[..., 2] <= 0.0
    in_front = torch.where(is_behind[..., None], torch.tensor([0.0, 0.0, 1.0], dtype=points.dtype), points)
    u, v = (in_front[..., :2] / in_front[..., 2:]).unbind(-1)
    r2 = u * u + v * v
    numerator = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    denominator = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    impossible = is_behind | (denominator <= 0.0)  # NaN stays NaN, and such a Gaussian is degenerate
    radial = numerator / torch.where(impossible, 1.0, denominator)
    distorted = torch.stack(
        [
            radial * u + 2 * p1 * u * v + p2 * (r2 + 2 * u * u) + r2 * (s1 + r2 * s2),
            radial * v + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v + r2 * (s3 + r2 * s4),
        ],
        dim=-1,
    )
    pixels = K.diagonal()[:2] * distorted + K[:2, 2]
    return torch.where(impossible[..., None], 0.0, pixels), ~impossible & (radial > RADIAL_MIN)


def _fisheye(points: Tensor, K: Tensor, width: int, height: int, lens: LensDistortion) -> tuple[Tensor, Tensor]:
    """Project camera points (..., 3) to pixels (..., 2) by OpenCV's fisheye model; mark valid points."""
    k1, k2, k3, k4 = lens.radial_coeffs
    fx, fy, cx, cy = (float(K.detach()[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    max_angle = lens.max_angle(fx, fy, cx, cy, width, height)
    x, y, z = points.unbind(-1)
    on_axis = (x == 0.0) & (y == 0.0)
    r = torch.hypot(torch.where(on_axis, 1.0, x), y)
    full_angle = torch.atan2(r, z)
    angle = full_angle.clamp(max=max_angle)
    a2 = angle * angle
    distorted_angle = angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
    is_behind = z <= 0.0
    # on the axis, angle / radius tends to 1 / z
    magnification = torch.where(on_axis, 1.0 / torch.where(is_behind, 1.0, z), distorted_angle / r)
    impossible = is_behind | (magnification <= 0.0)
    pixels = K.diagonal()[:2] * magnification[..., None] * points[..., :2] + K[:2, 2]
    return torch.where(impossible[..., None], 0.0, pixels), ~impossible & ((full_angle < max_angle) | on_axis)


PROJECTIONS = {"pinhole": _brown_conrady, "fisheye": _fisheye}
