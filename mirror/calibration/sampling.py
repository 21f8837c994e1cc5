"""Reads from a dataset what an estimate needs: a stretch of frames, their static pixels, poses and mountings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64, UInt8
from mirror.calibration.estimate import ObservingConditions
from mirror.calibration.frame_choice import FrameChoice, choose_stretch
from mirror.calibration.rig import TrackedRig
from mirror.calibration.spacing import ImageSpacing, untracked_error
from mirror.calibration.tracking import TrackedImage, TrackingOptions, track_rig
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image
from mirror.dataset.traversal import CameraCalibration
from mirror.errors import DatasetError, UsageError
from mirror.geometry import Poses, matrix_from_quaternion, project_boxes
from mirror.geometry.rolling_shutter import RollingShutter

MOVING_MPS: Final = 0.3
"""A road user that is faster is masked; one of unknown speed too."""
_FEWEST_FRAMES: Final = 3
_TWIST_NS: Final = 100_000_000
"""Velocities are those between poses this long before and after an exposure: recorded poses are noisy."""


@dataclass(frozen=True, eq=False)
class TraversalTracks:
    """The tracks of one traversal.

    Attributes:
        rig: the rig with its tracks.
        calibrations: the calibration of each camera that was taken as given.
        conditions: what the images and the motion are like.
        frames: number of frames.
    """

    rig: TrackedRig
    calibrations: dict[str, CameraCalibration]
    conditions: ObservingConditions
    frames: int


def choose_frames(dataset: Dataset, choice: FrameChoice) -> list[Frame]:
    """Return the frames of one traversal to estimate from, in order of time.

    Args:
        dataset: a view of one traversal.
        choice: how many frames, and how far apart.

    Raises:
        UsageError: fewer than three frames are far enough apart.
        DatasetError: the poses do not cover a frame.
    """
    frames = dataset.frames()
    if len(frames):
        poses = stack_poses([frame.world_SE3_ego for frame in frames])
        index = choose_stretch(poses, choice)
        chosen = [frames[int(at)] for at in np.unique(np.round(index).astype(np.int64))]
    else:
        chosen = []
    if len(chosen) < _FEWEST_FRAMES:
        way = f"; all are on a way of {driven_m(poses):.1f} m" if len(frames) else ""
        raise UsageError(
            f"{len(chosen)} of {len(frames)} frames are {choice.step_m:g} m or {choice.step_deg:g} degrees apart{way}",
            expected=f"at least {_FEWEST_FRAMES}: a vehicle that moves, with images",
            remedy="leave the traversal out, or choose smaller steps",
        )
    return chosen


def track_traversal(
    dataset: Dataset,
    frames: list[Frame],
    unread: list[str],
    options: TrackingOptions | None = None,
    advance: Callable[[int], None] = lambda steps: None,
) -> TraversalTracks:
    """Track points between the images of some frames of one traversal.

    Args:
        dataset: a view of the traversal; its layers give poses, calibrations and boxes.
        frames: the frames.
        unread: gets the message of each image that cannot be read; such an image is left out.
        options: settings of the tracker.
        advance: is called with 1 after each image.

    Raises:
        DatasetError: poses or calibrations are missing.
        UsageError: no two images have enough tracks; the error states what was measured, and what is needed.
    """
    names = [name for name in dataset.cameras() if any(name in frame.images for frame in frames)]
    calibrations, ego = {}, {}
    for name in names:
        own = [frame.images[name] for frame in frames if name in frame.images]
        calibrations[name] = own[len(own) // 2].calibration
        ego[name] = stack_poses([_ego_pose(frame, name) for frame in frames])
    brightness: dict[str, list[float]] = {name: [] for name in names}

    def load(number: int, name: str) -> TrackedImage | None:
        image = frames[number].images.get(name)
        if image is None:
            return None
        try:
            pixels = image.decode()
        except DatasetError as error:
            unread.append(str(error))
            return None
        still = static_pixels(frames[number], image)
        grey = _grey(pixels)
        if still.any():
            brightness[name].append(float(np.median(grey[still])))
        return TrackedImage.from_grey(grey, still)

    cameras = {name: calibrations[name].model for name in names}
    mountings = {name: calibrations[name].ego_SE3_camera for name in names}
    poses = {name: ego[name] @ mountings[name] for name in names}
    settings = options or TrackingOptions()
    found = track_rig(load, cameras, poses, len(frames), settings, advance)
    spacing = measure_spacing(frames)
    if not found.pairs:
        raise untracked_error(found.attempts, settings.least, spacing, measure_spacing(dataset.frames()))
    stamps = np.array([frame.timestamp_ns for frame in frames])
    rig = TrackedRig(
        cameras, mountings, (stamps - stamps[0]) * 1e-9, ego, found.pairs,
        {name: np.stack([ego_twist(frame, name) for frame in frames]) for name in names},
        {name: declared_shutter(calibrations[name]) for name in names},
    )  # fmt: skip
    track = stack_poses([frame.world_SE3_ego for frame in frames])
    conditions = ObservingConditions(
        turned_deg=turned_deg(track),
        driven_m=driven_m(track),
        brightness={name: float(np.median(values)) if values else 0.0 for name, values in brightness.items()},
        corners=found.corners,
        spacing=spacing,
    )
    return TraversalTracks(rig, calibrations, conditions, len(frames))


def measure_spacing(frames: Sequence[Frame]) -> ImageSpacing:
    """Measure the spacing of two or more frames of a traversal."""
    return ImageSpacing.of(stack_poses([frame.world_SE3_ego for frame in frames]), [one.timestamp_ns for one in frames])


def static_pixels(frame: Frame, image: Image) -> Bool:
    """Mark the pixels (H, W) that show neither the recording vehicle, nor a moving road user, nor the sky.

    Clouds move.

    Masks of the kinds ``dynamic``, ``ego`` and ``sky`` count, and the rectangles of boxes that move or have an unknown
    speed.

    Raises:
        UsageError: the traversal has several box layers and none was chosen.
    """
    still = np.ones((image.height_px, image.width_px), np.bool_)
    own = image.static_mask()
    if own is not None and own.shape == still.shape:
        still &= own == 0
    for mask in image.masks():
        if mask.kind in ("dynamic", "ego", "sky"):
            still &= mask.decode() == 0
    boxes = frame.boxes(f"camera:{image.camera}")
    if len(boxes):
        moving = ~(np.linalg.norm(boxes.velocity_mps, axis=1) < MOVING_MPS)
        bounds = project_boxes(image.camera_model, boxes.pose[moving], boxes.size_m[moving]).bounds_px
        for left, top, right, bottom in bounds[np.isfinite(bounds).all(axis=1)]:
            still[int(top) : int(np.ceil(bottom)) + 1, int(left) : int(np.ceil(right)) + 1] = False
    return still


def driven_m(poses: Poses) -> float:
    """Return the driven length of a track."""
    return float(np.linalg.norm(np.diff(poses.translation, axis=0), axis=1).sum())


def turned_deg(poses: Poses) -> float:
    """Return the largest difference of the course over a track, degrees."""
    turns = matrix_from_quaternion(poses.rotation)
    return float(np.ptp(np.degrees(np.unwrap(np.arctan2(turns[:, 1, 0], turns[:, 0, 0])))))


def _ego_pose(frame: Frame, camera: str) -> Poses:
    """The vehicle's pose at the exposure of a camera; where that has no image, at the frame's time."""
    image = frame.images.get(camera)
    if image is None:
        return frame.world_SE3_ego
    return image.world_SE3_camera @ image.calibration.ego_SE3_camera.inverse()


def ego_twist(frame: Frame, camera: str) -> Float64:
    """Compute the vehicle's velocities (6,) at the exposure of a camera, rad/s and m/s in its own frame.

    They are 0 where the camera has no image, which has no tracks, and where the poses do not reach around it.
    """
    image, (stamps, _) = frame.images.get(camera), frame.track
    if image is None:
        return np.zeros(6)
    at = np.clip(image.timestamp_ns + np.array([-_TWIST_NS, _TWIST_NS]), stamps[0], stamps[-1])
    if at[0] == at[1]:
        return np.zeros(6)
    mounting = image.calibration.ego_SE3_camera
    ends = image.world_SE3_camera_at(at - image.timestamp_ns) @ mounting.inverse()
    return np.asarray((ends[:1].inverse() @ ends[1:]).log()[0] / (1e-9 * float(at[1] - at[0])))


def declared_shutter(calibration: CameraCalibration) -> RollingShutter:
    """Return the shutter that a calibration states."""
    row, camera = calibration.row, calibration.model
    return RollingShutter(row["shutter_direction"], row["readout_ns"], camera.width_px, camera.height_px)


def _grey(rgb: UInt8) -> UInt8:
    import cv2

    return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8)


def stack_poses(poses: Sequence[Poses]) -> Poses:
    """Join poses to one batch."""
    rotation: Float64 = np.concatenate([one.rotation for one in poses])
    return Poses(rotation, np.concatenate([one.translation for one in poses]))
