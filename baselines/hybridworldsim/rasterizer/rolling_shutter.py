"""Rolling shutters: the directions, the time of a row, and the motion of a camera while its rows are exposed.

Names, numbers and conventions are those of gsplat 1.5 and 1.6. `viewmats` are the poses at the start of the first row's
exposure, `viewmats_rs` those at the start of the last row's. Between them the translation of the view matrix is linear,
and its rotation turns at a constant rate (slerp). The time of a pixel is 0 in the first row's centre and 1 in the last
one's; gsplat rounds it to whole rows, here it is continuous, and a point's time is that of the row it is seen in.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import torch
from torch import Tensor

from hybridworldsim.rasterizer.lenses import IMAGE_MARGIN
from mirror.errors import UsageError

TIME_FIRST: Final = -IMAGE_MARGIN
TIME_LAST: Final = 1.0 + IMAGE_MARGIN
"""Times of points beyond the image are clamped to this range: it ends where points no longer count as visible."""

SLACK_MIN: Final = 0.1
"""Least value of 1 minus the speed of a point's image along the readout, in images per readout. A faster point is
exposed again and again; it does not count as visible."""

TURN_MAX_DEG: Final = 60.0
TRAVEL_MAX_M: Final = 50.0
"""Largest rotation and distance between two end poses. A vehicle moves a few metres while an image is read out."""

NEWTON_STEPS: Final = 12
PIXEL_TOLERANCE: Final = 1e-5
SLOPE_TOLERANCE: Final = 1e-7
"""Last steps of Newton's method, in readouts: for pixels, whose error is of the second order in it (2e-7 pixels), and
for gradients, whose error is of the first (2e-6)."""


class RollingShutterType(IntEnum):
    """The direction in which the rows or columns of an image are exposed one after the other."""

    ROLLING_TOP_TO_BOTTOM = 0
    ROLLING_LEFT_TO_RIGHT = 1
    ROLLING_BOTTOM_TO_TOP = 2
    ROLLING_RIGHT_TO_LEFT = 3
    GLOBAL = 4


@dataclass(frozen=True, eq=False)
class ShutterMotion:
    """The shutter of one image.

    Attributes:
        per_x: time per pixel in x, in readouts; 0 if rows are read out.
        per_y: time per pixel in y, in readouts; 0 if columns are read out.
        offset: time at pixel (0, 0), in readouts.
        viewmat_end: (4, 4) camera_SE3_world at the last row.
    """

    per_x: float
    per_y: float
    offset: float
    viewmat_end: Tensor


def to_shutter_type(given: object) -> RollingShutterType:
    """Convert an argument `rolling_shutter` to a type; None is global.

    Raises:
        UsageError: it is no type of gsplat's.
    """
    name = "GLOBAL" if given is None else getattr(given, "name", given)
    if name not in RollingShutterType.__members__:
        raise UsageError(
            f"no such shutter: {given!r}",
            place="rolling_shutter",
            expected=" or ".join(RollingShutterType.__members__),
        )
    return RollingShutterType[str(name)]


def time_of_pixels(kind: RollingShutterType, width: int, height: int) -> tuple[float, float, float]:
    """Compute the time of pixel (x, y), ``per_x x + per_y y + offset`` in readouts, for a rolling shutter.

    Raises:
        UsageError: the raster has a single row or column, so that it has no such direction.
    """
    sideways = kind in (RollingShutterType.ROLLING_LEFT_TO_RIGHT, RollingShutterType.ROLLING_RIGHT_TO_LEFT)
    size = width if sideways else height
    if size < 2:
        raise UsageError(
            f"an image of {width} x {height} pixels has no direction {kind.name}",
            place="rolling_shutter",
            expected=f"at least two {'columns' if sideways else 'rows'}",
        )
    step, offset = 1.0 / (size - 1), -0.5 / (size - 1)
    if kind in (RollingShutterType.ROLLING_BOTTOM_TO_TOP, RollingShutterType.ROLLING_RIGHT_TO_LEFT):
        step, offset = -step, (size - 0.5) / (size - 1)
    return (step, 0.0, offset) if sideways else (0.0, step, offset)


def compute_motion(viewmat: Tensor, viewmat_end: Tensor) -> Tensor:
    """Compute the motion (6,) float64 between two view matrices: a rotation vector, and the translation's change.

    The rotation vector w turns the camera's axes: the rotation at time t is exp(t w) times the first. Differentiable to
    both matrices; rotations are at most `TURN_MAX_DEG`.
    """
    first, last = viewmat.double(), viewmat_end.double()
    turn = last[:3, :3] @ first[:3, :3].T
    axis = 0.5 * torch.stack([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    # the axis has the length sin(angle); angle / sin(angle) is a series about 0, where the root has no slope
    squared = (axis * axis).sum()
    is_small = squared < 1e-4
    root = torch.where(is_small, 0.25, squared).sqrt()
    series = 1.0 + squared * (1 / 6 + squared * (3 / 40 + squared * (15 / 336)))
    vector = axis * torch.where(is_small, series, torch.asin(root) / root)
    return torch.cat([vector, last[:3, 3] - first[:3, 3]])


def rotation_at(vector: Tensor, time: Tensor) -> Tensor:
    """Compute the rotations (..., 3, 3) that a rotation vector (3,) has reached at times (...)."""
    zero = torch.zeros_like(vector[0])
    x, y, z = vector.unbind()
    generator = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
    # (1 - cos) / angle^2 and (angle - sin) / angle^3 as series, which are smooth at 0
    q = (vector * vector).sum() * time * time
    first = sum((-q) ** k / math.factorial(2 * k + 2) for k in range(9))
    second = sum((-q) ** k / math.factorial(2 * k + 3) for k in range(9))
    sine, versine = time * (1.0 - q * second), time * time * first
    identity = torch.eye(3, dtype=vector.dtype)
    return identity + sine[..., None, None] * generator + versine[..., None, None] * (generator @ generator)
