"""The rigs of a scene with their recorded values, the errors that these may have, and tracks of features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.calibration.rig import PosePrior
from mirror.errors import UsageError
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.geometry.rolling_shutter import RollingShutter


@dataclass(frozen=True)
class RefinementPrior:
    """Errors that the recorded values may have, 1-sigma.

    Rotations of mountings are practically free.

    Attributes:
        poses: errors of poses and of the mountings' positions.
        offset_m: offset along each axis between the recorded positions of two traversals.
        focal_share: focal lengths, as a share.
        centre_share: principal points along each axis, as a share of the image width.
        feature_px: positions of features of scale 0; in proportion to 1 + scale. Also the scale of Cauchy's loss.
    """

    poses: PosePrior = field(default_factory=PosePrior)
    offset_m: float = 0.05
    focal_share: float = 3e-4
    centre_share: float = 3e-4
    feature_px: float = 0.12

    def __post_init__(self) -> None:
        for name in ("offset_m", "focal_share", "centre_share", "feature_px"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise UsageError(f"{value}", place=name, expected="a finite number above 0")


@dataclass(frozen=True, eq=False)
class MovingRigs:
    """K mounted cameras on vehicles that move through one scene, and their I images in F frames.

    A mounting belongs to one camera of one drive. The frames of one traversal share errors of their positions.

    Attributes:
        cameras: K lenses.
        ego_SE3_camera: K mountings.
        world_SE3_ego: I poses of the vehicle at the exposures of the images.
        frame: (I,) frame of each image.
        mounting: (I,) mounting of each image.
        time_s: (F,) times of the frames.
        traversal: (F,) number of the traversal of each frame.
        ego_twist: (I, 6) the vehicle's angular velocity, rad/s, and velocity, m/s, in its own frame at the exposures;
            None: not known, and all features count as seen at mid-exposure.
        shutters: K declared shutters; empty: all are global.
    """

    cameras: Sequence[Camera]
    ego_SE3_camera: Poses
    world_SE3_ego: Poses
    frame: Int64
    mounting: Int64
    time_s: Float64
    traversal: Int64
    ego_twist: Float64 | None = None
    shutters: Sequence[RollingShutter] = ()

    @property
    def are_rolling(self) -> bool:
        """Return whether some camera has a rolling shutter that moves."""
        return self.ego_twist is not None and any(shutter.is_rolling for shutter in self.shutters)

    def world_SE3_cameras(self) -> Poses:  # noqa: N802
        """Return the poses of the I images in the world."""
        return self.world_SE3_ego @ self.ego_SE3_camera[self.mounting]


@dataclass(frozen=True, eq=False)
class FeatureTracks:
    """M observations of features, grouped by track.

    Attributes:
        track: (M,) number of the track, ascending from 0 without gaps.
        image: (M,) image.
        uv_px: (M, 2) positions.
        scale_px: (M,) scales of the features.
    """

    track: Int64
    image: Int64
    uv_px: Float64
    scale_px: Float64

    def __len__(self) -> int:
        """Number of tracks."""
        return int(self.track[-1]) + 1 if len(self.track) else 0

    @property
    def starts(self) -> Int64:
        """(T + 1,) first observation of each track, and M."""
        return np.searchsorted(self.track, np.arange(len(self) + 1)).astype(np.int64)
