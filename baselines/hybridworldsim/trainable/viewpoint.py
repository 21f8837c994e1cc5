"""A pinhole camera in the frame of a block, ready for the rasterizer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
import torch
from torch import Tensor

from mirror.arrays import Float32, Float64
from mirror.errors import UsageError
from mirror.protocols.views.view import RenderView

NEAREST_M: Final = 0.05
"""Smallest depth that a camera sees."""


class Source(NamedTuple):
    """The camera that recorded an image, on which its appearance depends.

    Attributes:
        traversal_id: one drive's pass through the scene.
        camera: name of the camera in the rig.
    """

    traversal_id: str
    camera: str


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """A camera that an image is rendered for.

    Attributes:
        width_px: width of the image.
        height_px: height of the image.
        K: (3, 3) float32 intrinsics, pixels; the centre of the first pixel is at 0.5.
        viewmat: (4, 4) float32 ``camera_SE3_block``.
        source: traversal and camera of the appearance.
    """

    width_px: int
    height_px: int
    K: Tensor
    viewmat: Tensor
    source: Source

    @cached_property
    def centre(self) -> Tensor:
        """(3,) centre of the camera in the block's frame, metres."""
        return -self.viewmat[:3, :3].T @ self.viewmat[:3, 3]

    @cached_property
    def frustum(self) -> Float32:
        """(21,) float32 bounds of the camera's view.

        Rotation by rows, translation, nearest depth; then for either axis the low and the high slope of its planes;
        then the lengths of the normals of these four planes.
        """
        K, matrix = self.K.double().numpy(), self.viewmat.numpy()
        slopes = [
            slope
            for axis, size in ((0, self.width_px), (1, self.height_px))
            for slope in (K[axis, 2] / K[axis, axis], (size - K[axis, 2]) / K[axis, axis])
        ]
        lengths = [(1.0 + slope * slope) ** 0.5 for slope in slopes]
        return np.array((*matrix[:3, :3].ravel(), *matrix[:3, 3], NEAREST_M, *slopes, *lengths), np.float32)

    def on(self, device: torch.device) -> tuple[Tensor, Tensor]:
        """Return `viewmat` and `K` on a device; the copy to a GPU is asynchronous."""
        return self.viewmat.to(device, non_blocking=True), self.K.to(device, non_blocking=True)

    def with_source(self, source: Source) -> Viewpoint:
        """Return the camera with another appearance."""
        return replace(self, source=source)


def require_pinhole(view: RenderView) -> None:
    """Require that a view can be rasterized.

    Raises:
        UsageError: its lens is not a pinhole.
    """
    if view.model != "pinhole" or view.distortion:
        raise UsageError(
            f"a lens of model {view.model}", place=view.path, expected="a pinhole: pixels.space = 'undistorted'",
            remedy="name such a protocol: --protocol",
        )  # fmt: skip


def to_viewpoint(view: RenderView, origin_m: Float64) -> Viewpoint:
    """Convert a view of a protocol to a viewpoint.

    Args:
        view: a view with an undistorted lens.
        origin_m: (3,) origin of the block in the scene's world frame; subtracted in float64.

    Raises:
        UsageError: the lens is not a pinhole.
    """
    require_pinhole(view)
    pose = view.pose
    rotation = pose.matrix()[0, :3, :3].T
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation
    viewmat[:3, 3] = -rotation @ (pose.translation[0] - origin_m)
    intrinsics = np.array([[view.fx_px, 0.0, view.cx_px], [0.0, view.fy_px, view.cy_px], [0.0, 0.0, 1.0]])
    return Viewpoint(
        view.width_px,
        view.height_px,
        torch.from_numpy(intrinsics.astype(np.float32)),
        torch.from_numpy(viewmat.astype(np.float32)),
        Source(view.traversal_id, view.camera),
    )
