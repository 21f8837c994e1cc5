"""Calibration checking: how far the mountings of a rig's cameras are from what their images show.

`mirror.calibration.tracking` tracks points between images, `mirror.calibration.estimate` estimates the rotation errors
of all cameras jointly with their uncertainty. The names below are imported on first use.
"""

from __future__ import annotations

from mirror.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from mirror.calibration.estimate import CameraEstimate as CameraEstimate
    from mirror.calibration.estimate import estimate_rotations as estimate_rotations
    from mirror.calibration.frame_choice import FrameChoice as FrameChoice
    from mirror.calibration.rig import PosePrior as PosePrior
    from mirror.calibration.rig import TrackedRig as TrackedRig
    from mirror.calibration.tracking import PairTracks as PairTracks
    from mirror.calibration.tracking import TrackedImage as TrackedImage
    from mirror.calibration.tracking import TrackingOptions as TrackingOptions
    from mirror.calibration.tracking import track_rig as track_rig

__all__ = [
    "CameraEstimate",
    "FrameChoice",
    "PairTracks",
    "PosePrior",
    "TrackedImage",
    "TrackedRig",
    "TrackingOptions",
    "estimate_rotations",
    "track_rig",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "CameraEstimate": "mirror.calibration.estimate",
        "FrameChoice": "mirror.calibration.frame_choice",
        "PairTracks": "mirror.calibration.tracking",
        "PosePrior": "mirror.calibration.rig",
        "TrackedImage": "mirror.calibration.tracking",
        "TrackedRig": "mirror.calibration.rig",
        "TrackingOptions": "mirror.calibration.tracking",
        "estimate_rotations": "mirror.calibration.estimate",
        "track_rig": "mirror.calibration.tracking",
    },
)
