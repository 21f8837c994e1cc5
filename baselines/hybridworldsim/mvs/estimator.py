"""The interface of depth estimators: a function from an image and its neighbours to a depth map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mirror.arrays import Bool, Float32, Float64, UInt8
from mirror.errors import UsageError
from mirror.geometry.poses import Poses


@dataclass(frozen=True, eq=False)
class StereoImage:
    """An undistorted image of a pinhole camera with its pose.

    Attributes:
        rgb: (H, W, 3).
        K: (3, 3) intrinsics in px; the centre of the first pixel is at (0.5, 0.5).
        world_SE3_camera: one pose; camera x right, y down, z forward.
        valid: (H, W) True where the image shows the static scene. False on moving objects, on the vehicle itself, and
            outside the field of view of the recorded lens: such pixels get no depth and give no evidence for one.

    Raises:
        UsageError: an array has another type or shape, `K` is no intrinsic matrix, or there is not exactly one pose.
    """

    rgb: UInt8
    K: Float64
    world_SE3_camera: Poses
    valid: Bool

    def __post_init__(self) -> None:
        height, width = self.rgb.shape[:2]
        if self.rgb.shape != (height, width, 3) or self.rgb.dtype != np.uint8 or not self.rgb.size:
            raise UsageError(f"rgb is {self.rgb.dtype} {self.rgb.shape}", expected="uint8 (H, W, 3), not empty")
        if self.valid.shape != (height, width) or self.valid.dtype != np.bool_:
            raise UsageError(f"valid is {self.valid.dtype} {self.valid.shape}", expected=f"bool ({height}, {width})")
        if self.K.shape != (3, 3) or not np.isfinite(self.K).all() or min(self.K[0, 0], self.K[1, 1]) <= 0.0:
            raise UsageError(f"K is {self.K.tolist()}", expected="finite intrinsics (3, 3) with positive focal lengths")
        if len(self.world_SE3_camera) != 1:
            raise UsageError(f"one image has {len(self.world_SE3_camera)} poses", expected="one pose")


@dataclass(frozen=True, eq=False)
class DepthMap:
    """The depth of each pixel of an image.

    Attributes:
        depth_m: (H, W) along the camera's z axis; NaN where unknown.
        confidence: (H, W) from 0 (unknown) to 1; each estimator has its own scale.
    """

    depth_m: Float32
    confidence: Float32


class DepthEstimator(Protocol):
    """An estimator of the depth of an image from other images of the same scene."""

    def __call__(self, reference: StereoImage, sources: Sequence[StereoImage], near_m: float, far_m: float) -> DepthMap:
        """Estimate the depth of ``reference``.

        Args:
            reference: the image.
            sources: its neighbours of any size, best first. Without sources the result is unknown everywhere.
            near_m: smallest depth searched.
            far_m: largest depth searched.

        Raises:
            UsageError: not 0 < near_m < far_m, or images too large for the estimator.
        """
        ...


def require_depth_range(near_m: float, far_m: float) -> None:
    """Check a range of depths.

    Raises:
        UsageError: not 0 < near_m < far_m, or far_m is not finite.
    """
    if not 0.0 < near_m < far_m < np.inf:
        raise UsageError(f"depths from {near_m} to {far_m} m", expected="0 < near_m < far_m, finite")


def make_unknown_depth(reference: StereoImage) -> DepthMap:
    """Make a depth map that is unknown everywhere, in the size of an image."""
    shape = reference.valid.shape
    return DepthMap(np.full(shape, np.nan, np.float32), np.zeros(shape, np.float32))
