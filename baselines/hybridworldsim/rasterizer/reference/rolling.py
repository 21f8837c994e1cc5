"""Projects points that are exposed row by row: each at the time of the row or column that it is seen in."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from hybridworldsim.rasterizer.rolling_shutter import (
    NEWTON_STEPS,
    SLACK_MIN,
    TIME_FIRST,
    TIME_LAST,
    ShutterMotion,
    compute_motion,
    rotation_at,
)

Projection = Callable[[Tensor], tuple[Tensor, Tensor]]
"""Projects points (..., 3) of the camera frame to pixels (..., 2), and marks those that the lens shows (...)."""


class RollingView(NamedTuple):
    """A camera that moves while it exposes.

    Attributes:
        per_pixel: (2,) time per pixel in x and y, in readouts.
        offset: time at pixel (0, 0).
        translation: (3,) of the first view matrix, metres.
        vector: (3,) rotation vector of the readout.
        drift: (3,) change of the translation over the readout, metres.
    """

    per_pixel: Tensor
    offset: float
    translation: Tensor
    vector: Tensor
    drift: Tensor

    def to_camera(self, points: Tensor, time: Tensor) -> Tensor:
        """Transform points (..., 3), turned into the first camera's axes, to the camera frame at times (...)."""
        turned = (rotation_at(self.vector, time) @ points[..., None])[..., 0]
        return turned + self.translation + time[..., None] * self.drift


def to_rolling_view(viewmat: Tensor, shutter: ShutterMotion) -> RollingView:
    """Convert a first view matrix (4, 4) and a shutter to the motion between them."""
    motion = compute_motion(viewmat, shutter.viewmat_end)
    per_pixel = torch.tensor([shutter.per_x, shutter.per_y], dtype=torch.float64)
    return RollingView(per_pixel, shutter.offset, viewmat.double()[:3, 3], motion[:3], motion[3:])


def project_rolling(points: Tensor, view: RollingView, projection: Projection) -> tuple[Tensor, Tensor]:
    """Project points at the times of their rows; differentiable to the points and to both end poses.

    The time t of a point solves ``t = time of the row of the point's image at t``, clamped to `TIME_FIRST` ..
    `TIME_LAST`. Newton's method starts at mid-readout. The last step is taken with derivatives, which gives the
    derivatives of the solution (implicit function theorem).

    Args:
        points: (..., 3) turned into the first camera's axes, without its translation, metres.
        view: the motion of the camera.
        projection: the lens.

    Returns:
        Pixels (..., 2), and whether (...) the lens shows a point whose time is determined.
    """
    with torch.no_grad():
        time = torch.full(points.shape[:-1], 0.5, dtype=torch.float64)
        for _ in range(NEWTON_STEPS):
            error, slack = _miss(points, view, projection, time)
            time = (time + error / slack.clamp(min=SLACK_MIN)).clamp(TIME_FIRST, TIME_LAST)
        error, slack = _miss(points, view, projection, time)
        is_clamped = (time <= TIME_FIRST) | (time >= TIME_LAST)
        is_determined = (slack > SLACK_MIN) & (is_clamped | (error.abs() < 1e-9))
        time = torch.where(is_determined, time, 0.5)
        is_free = is_determined & ~is_clamped
    pixels, _ = projection(view.to_camera(points, time))
    miss = pixels @ view.per_pixel + view.offset - time
    time = time + torch.where(is_free, miss / slack, 0.0)
    pixels, valid = projection(view.to_camera(points, time))
    return pixels, valid & is_determined


def _miss(points: Tensor, view: RollingView, projection: Projection, time: Tensor) -> tuple[Tensor, Tensor]:
    """Compute by how much (...) the row at a time lies after that time, and 1 minus the slope of the row's time."""
    with torch.enable_grad():
        at = time.clone().requires_grad_()
        pixels, _ = projection(view.to_camera(points, at))
        row_time = pixels @ view.per_pixel + view.offset
        (slope,) = torch.autograd.grad(row_time.sum(), at)
    return (row_time - at).detach(), 1.0 - slope
