"""What an estimator of depth is: one function from a picture and its neighbours to a depth map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mirror.arrays import Bool, Float32, Float64, UInt8
from mirror.errors import UsageError
from mirror.geometry.poses import Poses


@dataclass(frozen=True, eq=False)
class PosedPicture:
    """An undistorted picture of a pinhole camera, and where it was taken.

    Attributes:
        rgb: (H, W, 3).
        K: (3, 3) intrinsics in px; the centre of the first pixel is at (0.5, 0.5).
        world_SE3_camera: one pose; camera x right, y down, z forward.
        valid: (H, W) True where the picture shows the static scene: not a moving object, the vehicle itself, or what
            the lens does not see. Other pixels neither get a depth nor give evidence for one.
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
            raise UsageError(f"{len(self.world_SE3_camera)} poses of one picture", expected="one pose")


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Depth of every pixel of a picture.

    Attributes:
        depth_m: (H, W) along the camera's z; NaN where unknown.
        confidence: (H, W) from 0 (unknown) to 1; each estimator's own scale.
    """

    depth_m: Float32
    confidence: Float32


class DepthEstimator(Protocol):
    """Estimates the depth of a picture from others that see the same."""

    def __call__(
        self, reference: PosedPicture, sources: Sequence[PosedPicture], near_m: float, far_m: float
    ) -> DepthMap:
        """The depth of ``reference``.

        Args:
            reference: the picture.
            sources: its neighbours, best first, of any size each; without any, nothing is known.
            near_m: smallest depth searched.
            far_m: largest depth searched.

        Raises:
            UsageError: not 0 < near_m < far_m, or pictures too large for the estimator.
        """
        ...
