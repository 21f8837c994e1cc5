"""A pinhole camera in the frame of a block, ready for the rasterizer."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from torch import Tensor

from mirror.arrays import Float32, Float64
from mirror.errors import UsageError
from mirror.geometry.poses import Poses
from mirror.protocols.views.view import RenderView

_log: Final = logging.getLogger("hybridworldsim")

NEAREST_M: Final = 0.05
"""Smallest depth that a camera sees."""

ROLLING_MARGIN: Final = 0.1
"""Share of the raster by which the view of a rolling shutter is wider than that of its mid-exposure, on each side."""


class Source(NamedTuple):
    """The camera that recorded an image, on which its appearance depends.

    Attributes:
        traversal_id: one drive's pass through the scene.
        camera: name of the camera in the rig.
    """

    traversal_id: str
    camera: str


class ReadoutPoses(NamedTuple):
    """The poses of a camera while its rows or columns are exposed.

    Attributes:
        kind: name of a `RollingShutterType`, such as ROLLING_TOP_TO_BOTTOM.
        first: (4, 4) float32 ``camera_SE3_block`` at the line that is exposed first.
        last: (4, 4) float32 at the line that is exposed last.
    """

    kind: str
    first: Tensor
    last: Tensor


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """A camera that an image is rendered for.

    Attributes:
        width_px: width of the image.
        height_px: height of the image.
        K: (3, 3) float32 intrinsics, pixels; the centre of the first pixel is at 0.5.
        viewmat: (4, 4) float32 ``camera_SE3_block``.
        source: traversal and camera of the appearance.
        readout: the poses of a rolling shutter; None: all of the image is seen from `viewmat`, which is else the pose
            at mid-exposure.
    """

    width_px: int
    height_px: int
    K: Tensor
    viewmat: Tensor
    source: Source
    readout: ReadoutPoses | None = None

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
        # rows that are exposed earlier or later see points beside the view of mid-exposure
        margin = 0.0 if self.readout is None else ROLLING_MARGIN
        slopes = [
            edge / K[axis, axis] + margin * size / abs(K[axis, axis])
            for axis, size in ((0, self.width_px), (1, self.height_px))
            for edge in (K[axis, 2], size - K[axis, 2])
        ]
        lengths = [(1.0 + slope * slope) ** 0.5 for slope in slopes]
        return np.array((*matrix[:3, :3].ravel(), *matrix[:3, 3], NEAREST_M, *slopes, *lengths), np.float32)

    def on(self, device: torch.device) -> tuple[Tensor, Tensor]:
        """Return `viewmat` and `K` on a device; the copy to a GPU is asynchronous."""
        return self.viewmat.to(device, non_blocking=True), self.K.to(device, non_blocking=True)

    def cameras_on(self, device: torch.device) -> dict[str, Any]:
        """Return the camera's arguments of `rasterization`, on a device.

        On a GPU a rolling shutter is seen from its mid-exposure, which is logged once: gsplat's unscented transform
        has no gradients there.
        """
        matrix, K = self.on(device)
        if self.readout is not None and device.type == "cuda":
            _warn_of_global_shutter()
        if self.readout is None or device.type == "cuda":
            return {"viewmats": matrix[None], "Ks": K[None]}
        first, last = (pose.to(device, non_blocking=True)[None] for pose in (self.readout.first, self.readout.last))
        ends = {"viewmats": first, "viewmats_rs": last}
        return {**ends, "Ks": K[None], "rolling_shutter": self.readout.kind, "with_ut": True}

    def with_source(self, source: Source) -> Viewpoint:
        """Return the camera with another appearance."""
        return replace(self, source=source)


@cache
def _warn_of_global_shutter() -> None:
    _log.warning(
        "rolling shutters are rendered at mid-exposure on a GPU; --device cpu renders each row at its own time"
    )


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
    intrinsics = np.array([[view.fx_px, 0.0, view.cx_px], [0.0, view.fy_px, view.cy_px], [0.0, 0.0, 1.0]])
    return Viewpoint(
        view.width_px,
        view.height_px,
        torch.from_numpy(intrinsics.astype(np.float32)),
        _to_viewmat(view.pose, origin_m),
        Source(view.traversal_id, view.camera),
        None
        if view.shutter is None
        else ReadoutPoses(
            f"ROLLING_{view.shutter.direction.upper()}",
            _to_viewmat(view.shutter.world_SE3_first, origin_m),
            _to_viewmat(view.shutter.world_SE3_last, origin_m),
        ),
    )


def _to_viewmat(pose: Poses, origin_m: Float64) -> Tensor:
    """Convert one ``world_SE3_camera`` to ``camera_SE3_block`` (4, 4), float32."""
    rotation = pose.matrix()[0, :3, :3].T
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation
    viewmat[:3, 3] = -rotation @ (pose.translation[0] - origin_m)
    return torch.from_numpy(viewmat.astype(np.float32))
