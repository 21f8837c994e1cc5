"""Reasons why the images of a drive cannot be tracked, with the measured spacing and the one that tracking needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mirror.calibration.frame_choice import FrameChoice
from mirror.errors import UsageError
from mirror.geometry import Poses, matrix_from_quaternion

_TOO_FAR = 1.5
"""Images are too far apart if their spacing is this many times the steps with which tracking is measured."""
_MOVING = 0.05
"""The vehicle moves between two images that are more than this many steps apart: 17 cm, which no fix feigns."""


@dataclass(frozen=True)
class PairAttempt:
    """An attempt to track points from one image of a camera to the next.

    Attributes:
        camera: name of the camera.
        corners: number of corners in the first image.
        tracks: number of them that were found in the second image and passed all tests.
    """

    camera: str
    corners: int
    tracks: int


@dataclass(frozen=True)
class ImageSpacing:
    """Spacing of a drive's images: medians over neighbouring images between which the vehicle moves.

    Images of a standing vehicle would hide how far apart those of the drive are.

    Attributes:
        distance_m: distance between them.
        turn_deg: change of course between them.
        interval_s: time between them.
    """

    distance_m: float
    turn_deg: float
    interval_s: float

    @classmethod
    def of(cls, poses: Poses, stamps_ns: Sequence[int]) -> ImageSpacing:
        """Measure the spacing of frames.

        Args:
            poses: (N,) poses of the vehicle, N >= 2.
            stamps_ns: N times, ascending.
        """
        turns = matrix_from_quaternion(poses.rotation)
        course = np.degrees(np.unwrap(np.arctan2(turns[:, 1, 0], turns[:, 0, 0])))
        pairs = np.stack(
            [
                np.linalg.norm(np.diff(poses.translation, axis=0), axis=1),
                np.abs(np.diff(course)),
                np.diff(np.asarray(stamps_ns, np.int64)) * 1e-9,
            ],
            axis=1,
        )
        usual = FrameChoice()
        moving = np.hypot(pairs[:, 0] / usual.step_m, pairs[:, 1] / usual.step_deg) > _MOVING
        return cls(*np.median(pairs[moving] if moving.any() else pairs, axis=0).tolist())

    def steps(self, choice: FrameChoice) -> float:
        """Return the spacing of the images, measured in steps of a choice of frames."""
        return float(np.hypot(self.distance_m / choice.step_m, self.turn_deg / choice.step_deg))

    @property
    def is_too_far(self) -> bool:
        """Return whether the images are farther apart than the measured range of tracking."""
        return self.steps(FrameChoice()) > _TOO_FAR

    def __str__(self) -> str:
        return f"{self.distance_m:.1f} m and {self.turn_deg:.0f} degrees ({self.interval_s:.2g} s)"

    def needed(self) -> str:
        """Return the image rate that tracking needs at this speed."""
        usual = FrameChoice()
        rate = self.steps(usual) / self.interval_s
        apart = f"{usual.step_m:g} m or {usual.step_deg:g} degrees apart"
        return f"images {apart}, which are {rate:.2g} a second at this speed"


def untracked_error(
    attempts: Sequence[PairAttempt], least: int, chosen: ImageSpacing, recorded: ImageSpacing
) -> UsageError:
    """Return the error for a drive in which no two images have enough tracks.

    Args:
        attempts: what tracking found in each pair of neighbouring images; may be empty.
        least: smallest number of tracks of a pair.
        chosen: spacing of the frames that were tracked.
        recorded: spacing of all recorded frames.
    """
    corners, tracks = (np.array([getattr(one, name) for one in attempts]) for name in ("corners", "tracks"))
    if not len(attempts):
        return UsageError(
            "no camera has images in two neighbouring frames", expected="images of the same camera in frames that "
            f"follow each other; these are {chosen} apart", remedy="record the images of a camera in every frame",
        )  # fmt: skip
    found = (
        f"none of {len(attempts)} pairs of neighbouring images has {least} tracks: of {np.median(corners):.0f} points "
        f"in an image {np.median(tracks):.0f} are found in the next one (medians; {tracks.max()} at most); the "
        f"images are {chosen} apart (medians)"
    )
    if np.median(corners) < least:
        remedy = "choose drives by day, with texture in the images"
        return UsageError(found, expected=f"at least {least} points in an image", remedy=remedy)
    if not chosen.is_too_far:
        remedy = "check that poses, lenses and images belong together, and that the images are sharp"
        return UsageError(found, expected=f"at least {least} tracks of a pair of images", remedy=remedy)
    usual = FrameChoice().step_m
    denser = recorded.steps(FrameChoice()) < 1.0 / _TOO_FAR * chosen.steps(FrameChoice())
    return UsageError(
        found, expected=chosen.needed(),
        remedy=f"choose nearer frames: --step-m {usual:g}" if denser else "ingest more of the recorded images, or "
        "record at a higher rate",
    )  # fmt: skip
