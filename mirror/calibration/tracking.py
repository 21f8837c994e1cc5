"""Points tracked between two images of one camera: Lucas-Kanade, checked both ways and by one relative pose.

The tracker works in OpenCV's pixel coordinates, in which the first pixel has its centre at (0, 0); every point that
leaves this module has half a pixel added, which is the convention of `mirror.geometry.Camera`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float32, Float64, UInt8
from mirror.calibration.affine import refine_tracks
from mirror.calibration.spacing import PairAttempt
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera

OPENCV_OFFSET_PX: Final = 0.5
_COARSE_PX: Final = 21
_FINE_PX: Final = 11
_LEVELS: Final = 4
_ASSUMED_DISTANCE_M: Final = 15.0


@dataclass(frozen=True)
class TrackingOptions:
    """Settings of the tracker of image features.

    Attributes:
        points: largest number of points per image.
        spacing_px: smallest distance between points, at an image width of 960 px.
        quality: smallest corner response, as a share of the largest.
        both_ways_px: largest distance between a point and its track there and back.
        epipolar_px: largest distance from the epipolar line of the relative pose that most tracks fit.
        least: smallest number of tracks of a pair of images; a pair with fewer is left out.
    """

    points: int = 600
    spacing_px: float = 12.0
    quality: float = 0.004
    both_ways_px: float = 0.3
    epipolar_px: float = 1.0
    least: int = 25


@dataclass(frozen=True, eq=False)
class PairTracks:
    """Tracks between two images of one camera.

    Attributes:
        camera: name of the camera.
        first: number of the first frame.
        second: number of the second frame.
        first_px: (N, 2) points in the first image; the centre of the first pixel is at (0.5, 0.5).
        second_px: (N, 2) the same points in the second image.
    """

    camera: str
    first: int
    second: int
    first_px: Float64
    second_px: Float64

    def __len__(self) -> int:
        return len(self.first_px)


@dataclass(frozen=True, eq=False)
class RigTracks:
    """Tracks in the images of a rig.

    Attributes:
        pairs: the pairs with enough tracks.
        attempts: all pairs of neighbouring images, in which tracks were looked for.
        corners: mean number of corners per image by camera name.
    """

    pairs: list[PairTracks]
    attempts: list[PairAttempt]
    corners: dict[str, float]


@dataclass(frozen=True, eq=False)
class TrackedImage:
    """An image prepared for tracking.

    Attributes:
        grey: (H, W) pixels.
        is_static: (H, W) pixels that show neither the recording vehicle nor a moving road user.
    """

    grey: UInt8
    is_static: Bool

    @cached_property
    def smooth(self) -> Float32:
        """(H, W) pixels smoothed by a Gaussian of 0.8 px, so that bilinear interpolation has less bias."""
        import cv2

        return np.asarray(cv2.GaussianBlur(self.grey.astype(np.float32), (0, 0), 0.8), np.float32)

    @classmethod
    def from_grey(cls, grey: UInt8, is_static: Bool | None = None) -> TrackedImage:
        """Make a tracked image from a grey image; without a mask all pixels are static."""
        return cls(grey, np.ones(grey.shape, np.bool_) if is_static is None else is_static)


def find_corners(image: TrackedImage, options: TrackingOptions) -> Float32:
    """Return the corners (N, 2) of the static part of an image, in OpenCV's coordinates."""
    import cv2

    spacing = options.spacing_px * image.grey.shape[1] / 960.0
    found = cv2.goodFeaturesToTrack(
        image.grey, options.points, options.quality, spacing, mask=_erode(image.is_static).astype(np.uint8), blockSize=5
    )
    if found is None:
        return np.empty((0, 2), np.float32)
    return found.reshape(-1, 2).astype(np.float32)


def track_pair(
    first: TrackedImage,
    second: TrackedImage,
    corners: Float32,
    camera: Camera,
    second_SE3_first: Poses,
    options: TrackingOptions,
) -> tuple[Float64, Float64]:
    """Track corners from one image to another.

    Args:
        first: the first image.
        second: the second image.
        corners: (N, 2) points of the first image, OpenCV's coordinates.
        camera: lens of both.
        second_SE3_first: recorded relative pose of the camera, one; it only predicts where the search begins.
        options: settings.

    Returns:
        The points (M, 2) in both images, with the centre of the first pixel at (0.5, 0.5).
    """
    if not len(corners):
        return np.empty((0, 2)), np.empty((0, 2))
    begin = _predict(corners, camera, second_SE3_first)
    there, ok = _flow(first, second, corners, begin)
    back, ok_back = _flow(second, first, there, corners.copy())
    kept = ok & ok_back & (np.linalg.norm(back - corners, axis=1) < options.both_ways_px)
    kept &= _inside(second.is_static, there)
    one, two = corners[kept].astype(np.float64), there[kept].astype(np.float64)
    two, good = refine_tracks(first.smooth, second.smooth, one, two)
    again, good_back = refine_tracks(second.smooth, first.smooth, two, one)
    good &= good_back & (np.linalg.norm(again - one, axis=1) < options.both_ways_px)
    one, two = one[good] + OPENCV_OFFSET_PX, two[good] + OPENCV_OFFSET_PX
    fits = fit_one_pose(camera, one, two, options.epipolar_px)
    return one[fits], two[fits]


def track_rig(
    load: Callable[[int, str], TrackedImage | None],
    cameras: Mapping[str, Camera],
    world_SE3_camera: Mapping[str, Poses],
    frames: int,
    options: TrackingOptions | None = None,
    advance: Callable[[int], None] = lambda steps: None,
) -> RigTracks:
    """Track points between neighbouring images of every camera.

    Args:
        load: loads the image of a frame and a camera; None: there is no such image. Each is loaded once.
        cameras: lenses by camera name.
        world_SE3_camera: recorded poses of the images by camera name, one for each frame.
        frames: number of frames.
        options: settings; None: the defaults.
        advance: is called with 1 after each image.
    """
    settings = options or TrackingOptions()
    pairs, attempts, corners_of = [], [], {}
    for name, camera in cameras.items():
        previous, corners, found = None, np.empty((0, 2), np.float32), []
        for frame in range(frames):
            image = load(frame, name)
            if image is not None and previous is not None:
                poses = world_SE3_camera[name]
                moved = poses[frame : frame + 1].inverse() @ poses[frame - 1 : frame]
                first, second = track_pair(previous, image, corners, camera, moved, settings)
                attempts.append(PairAttempt(name, len(corners), len(first)))
                if len(first) >= settings.least:
                    pairs.append(PairTracks(name, frame - 1, frame, first, second))
            if image is not None and frame < frames - 1:
                corners = find_corners(image, settings)
                found.append(len(corners))
            previous = image
            advance(1)
        corners_of[name] = float(np.mean(found)) if found else 0.0
    return RigTracks(pairs, attempts, corners_of)


def fit_one_pose(
    camera: Camera, first_px: Float64, second_px: Float64, within_px: float, second: Camera | None = None
) -> Bool:
    """Mark which of N tracks fit one relative pose, by RANSAC with the five-point algorithm and a fixed seed.

    The test does not use the mounting of the camera, so an error of the mounting removes no track.

    Args:
        camera: lens of the first image.
        first_px: (N, 2) points in the first image.
        second_px: (N, 2) the same points in the second image.
        within_px: largest distance from the epipolar line, pixels of the first image's centre.
        second: lens of the second image; None: the same.
    """
    import cv2

    rays = [one.unproject(points) for one, points in ((camera, first_px), (second or camera, second_px))]
    usable = np.logical_and.reduce([ray.valid & (ray.direction[:, 2] > 0.2) for ray in rays])
    fits = np.zeros(len(first_px), np.bool_)
    if usable.sum() < 8:
        return fits
    planar = [ray.direction[usable, :2] / ray.direction[usable, 2:] for ray in rays]
    cv2.setRNGSeed(1)
    within = within_px * pixel_rad(camera)
    matrix, mask = cv2.findEssentialMat(
        planar[0], planar[1], np.eye(3), method=cv2.RANSAC, prob=0.9999, threshold=within, maxIters=2000
    )
    if matrix is None or mask is None:
        return fits
    fits[usable] = mask.ravel().astype(np.bool_)
    return fits


def pixel_rad(camera: Camera) -> float:
    """Return the angle of one pixel at the principal point."""
    ends = camera.unproject([[camera.cx_px - 0.5, camera.cy_px], [camera.cx_px + 0.5, camera.cy_px]]).direction
    return float(np.linalg.norm(ends[1] - ends[0]))


def _flow(first: TrackedImage, second: TrackedImage, points: Float32, begin: Float32) -> tuple[Float32, Bool]:
    """Track points: first in a large window over the pyramid, then in a small window on the full image."""
    import cv2

    until = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.003)
    there, ok, _ = cv2.calcOpticalFlowPyrLK(
        first.grey, second.grey, points, begin.copy(), winSize=(_COARSE_PX, _COARSE_PX), maxLevel=_LEVELS,
        criteria=until, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    there, ok_fine, _ = cv2.calcOpticalFlowPyrLK(
        first.grey, second.grey, points, there, winSize=(_FINE_PX, _FINE_PX), maxLevel=0, criteria=until,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    return np.asarray(there, np.float32), (ok.ravel() > 0) & (ok_fine.ravel() > 0)


def _predict(corners: Float32, camera: Camera, second_SE3_first: Poses) -> Float32:
    """Predict where corners are if they are at the assumed distance; where that is outside, they stay."""
    rays = camera.unproject(corners.astype(np.float64) + OPENCV_OFFSET_PX)
    points = second_SE3_first.transform(_ASSUMED_DISTANCE_M * rays.direction)[0]
    seen = camera.project(points)
    return np.where(seen.valid[:, None], seen.uv_px - OPENCV_OFFSET_PX, corners).astype(np.float32)


def _inside(mask: Bool, points: Float32) -> Bool:
    """Mark the points (N, 2) that lie on True pixels."""
    height, width = mask.shape
    column, row = np.round(points[:, 0]).astype(np.int64), np.round(points[:, 1]).astype(np.int64)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    inside[inside] = mask[row[inside], column[inside]]
    return inside


def _erode(mask: Bool) -> Bool:
    """The mask without a margin of half the fine window, so that no window covers a masked pixel."""
    import cv2

    kernel = np.ones((_FINE_PX, _FINE_PX), np.uint8)
    return np.asarray(cv2.erode(mask.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)) > 0
