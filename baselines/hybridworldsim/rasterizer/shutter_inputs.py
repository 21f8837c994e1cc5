"""Checks the arguments `rolling_shutter` and `viewmats_rs`, and makes the shutter of each image."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from hybridworldsim.rasterizer.inputs import Inputs, check_tensor, refuse_nonfinite, shape_error
from hybridworldsim.rasterizer.rolling_shutter import (
    TRAVEL_MAX_M,
    TURN_MAX_DEG,
    RollingShutterType,
    ShutterMotion,
    time_of_pixels,
    to_shutter_type,
)
from mirror.errors import UsageError


def make_shutters(
    inputs: Inputs, rolling_shutter: object, viewmats_rs: Tensor | None, with_ut: bool
) -> Sequence[ShutterMotion | None]:
    """Make the shutter of each image; None for a global shutter.

    Args:
        inputs: the checked inputs.
        rolling_shutter: a `RollingShutterType`, a member of gsplat's enumeration, its name, or None.
        viewmats_rs: (..., C, 4, 4) camera from world at the last row.
        with_ut: whether the unscented transform is used, which rolling shutters need.

    Raises:
        UsageError: the direction is unknown, or the raster does not have it; an argument is missing; end poses are no
            poses of one camera in one frame.
    """
    kind = to_shutter_type(rolling_shutter)
    images = len(inputs.means) * inputs.cameras
    if kind is RollingShutterType.GLOBAL:
        if viewmats_rs is not None:
            raise UsageError(
                "end poses with a global shutter", place="viewmats_rs", remedy="rolling_shutter=ROLLING_..., or None"
            )
        return [None] * images
    if not with_ut:
        raise UsageError(f"{kind.name} without the unscented transform", place="rolling_shutter", remedy="with_ut=True")
    if viewmats_rs is None:
        raise UsageError(
            f"{kind.name} without the poses at the last row",
            place="viewmats_rs",
            expected="camera from world, (..., C, 4, 4); viewmats are then those at the first row",
        )
    check_tensor("viewmats_rs", viewmats_rs, inputs.means[0])
    expected = (*inputs.batch, inputs.cameras, 4, 4)
    if viewmats_rs.shape != expected:
        raise shape_error("viewmats_rs", viewmats_rs, str(expected))
    refuse_nonfinite("viewmats_rs", viewmats_rs.flatten(0, len(inputs.batch)), "image")
    per_x, per_y, offset = time_of_pixels(kind, inputs.width, inputs.height)
    starts, ends = inputs.viewmats.reshape(-1, 4, 4), viewmats_rs.reshape(-1, 4, 4)
    for image in range(images):
        _require_one_frame(image, starts[image].detach().double(), ends[image].detach().double())
    return [ShutterMotion(per_x, per_y, offset, ends[image]) for image in range(images)]


def _require_one_frame(image: int, start: Tensor, end: Tensor) -> None:
    """Refuse end poses that no camera reaches within one readout: they are poses of different frames or worlds."""
    turn = end[:3, :3] @ start[:3, :3].T
    antisymmetric = 0.5 * torch.stack([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    degrees = math.degrees(math.atan2(float(antisymmetric.norm()), 0.5 * (float(turn.trace()) - 1.0)))
    centres = [-torch.linalg.solve(pose[:3, :3], pose[:3, 3]) for pose in (start, end)]
    travel_m = float((centres[1] - centres[0]).norm())
    if degrees <= TURN_MAX_DEG and travel_m <= TRAVEL_MAX_M:
        return
    raise UsageError(
        f"the end pose of image {image} is {travel_m:.4g} m and {degrees:.3g} degrees from its first pose",
        place="viewmats_rs",
        expected=f"poses of one readout in one frame, at most {TRAVEL_MAX_M:g} m and {TURN_MAX_DEG:g} degrees apart",
    )
