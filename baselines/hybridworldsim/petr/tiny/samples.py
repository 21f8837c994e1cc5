"""From frames of a dataset to inputs and targets of the tiny network."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import torch

from hybridworldsim.petr.tiny.network import STRIDE, TinyRigInput
from hybridworldsim.petr.tiny.settings import CLASS_OF, CLASSES, NetworkSettings
from mirror.annotation.detections import AnnotationError
from mirror.arrays import Float32, Float64, Int64, UInt8
from mirror.dataset.frames import Frame
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import matrix_from_quaternion, rotate

_SPREAD: Final = 0.25
_SPREAD_RANGE: Final = (0.5, 2.0)


@dataclass(frozen=True, eq=False)
class CameraInput:
    """The images and rays of the N cameras of a frame.

    Attributes:
        images: (N, H, W, 3) RGB.
        directions: (N, H / 8, W / 8, 3) rays in the ego frame at the frame's time.
        origins: (N, 3).
    """

    images: UInt8
    directions: Float32
    origins: Float32


@dataclass(frozen=True, eq=False)
class TargetBoxes:
    """The K boxes of a frame, and the positions of their middles in the cameras' images.

    Attributes:
        label: (K,) number of the class.
        centre_m: (K, 3) in the ego frame.
        size_m: (K, 3) length, width, height.
        yaw_rad: (K,).
        cell: (K, N, 2) column and row of the middle, in tokens; NaN where a camera does not see it.
        spread: (K, N) standard deviation of the heat around it, in tokens.
    """

    label: Int64
    centre_m: Float32
    size_m: Float32
    yaw_rad: Float32
    cell: Float32
    spread: Float32


@dataclass(frozen=True, eq=False)
class Sample:
    """A frame with its boxes."""

    cameras: CameraInput
    boxes: TargetBoxes


def camera_input(frame: Frame, settings: NetworkSettings) -> CameraInput:
    """Read the images of a frame, and compute the rays of their tokens.

    Raises:
        AnnotationError: the frame has no image.
        DatasetError: an image, a pose or a calibration is missing or broken.
    """
    if not frame.images:
        raise AnnotationError("no image", place=f"frame {frame.frame_index}", expected="at least one camera")
    width, height = settings.width_px, settings.height_px
    u, v = np.meshgrid((np.arange(width // STRIDE) + 0.5) * STRIDE, (np.arange(height // STRIDE) + 0.5) * STRIDE)
    ego_SE3_world = frame.world_SE3_ego.inverse()
    images, directions, origins = [], [], []
    for image in frame.images.values():
        shrinks = image.width_px > width
        interpolation = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        images.append(cv2.resize(image.decode(), (width, height), interpolation=interpolation))
        ego_SE3_camera = ego_SE3_world @ image.world_SE3_camera
        rays = image.camera_model.resized(width, height).unproject(np.stack((u, v), -1))
        ahead = np.where(rays.valid[..., None], rays.direction, (0.0, 0.0, 1.0))
        turned = rotate(ego_SE3_camera.rotation, ahead.reshape(-1, 3)).reshape(ahead.shape)
        directions.append(turned / np.linalg.norm(turned, axis=-1, keepdims=True))
        origins.append(ego_SE3_camera.translation[0])
    return CameraInput(np.stack(images), np.array(directions, np.float32), np.array(origins, np.float32))


def read_sample(frame: Frame, settings: NetworkSettings, range_m: float) -> Sample:
    """Read a frame and the boxes of its chosen layer.

    Args:
        frame: the frame.
        settings: sizes of the network.
        range_m: boxes farther from the vehicle are left out.
    """
    cameras = camera_input(frame, settings)
    boxes = frame.boxes("ego")
    known = np.array([name in CLASS_OF for name in boxes.category], np.bool_)
    near = np.hypot(*boxes.pose.translation[:, :2].T) <= range_m if len(boxes) else known
    rows = np.flatnonzero(known & near)
    pose, size = boxes.pose[rows], boxes.size_m[rows]
    forward = matrix_from_quaternion(pose.rotation)[..., 0]
    cell, spread = _cells(frame, pose, size, settings)
    return Sample(
        cameras,
        TargetBoxes(
            np.array([CLASSES.index(CLASS_OF[boxes.category[row]]) for row in rows], np.int64),
            pose.translation.astype(np.float32),
            size.astype(np.float32),
            np.arctan2(forward[:, 1], forward[:, 0]).astype(np.float32),
            cell,
            spread,
        ),
    )


def _cells(frame: Frame, pose: Poses, size: Float64, settings: NetworkSettings) -> tuple[Float32, Float32]:
    count = len(pose)
    cell = np.full((count, len(frame.images), 2), np.nan, np.float32)
    spread = np.ones((count, len(frame.images)), np.float32)
    if not count:
        return cell, spread
    ego_SE3_world = frame.world_SE3_ego.inverse()
    for place, image in enumerate(frame.images.values()):
        camera = image.camera_model.resized(settings.width_px, settings.height_px)
        camera_SE3_ego = (ego_SE3_world @ image.world_SE3_camera).inverse()
        middle = (camera_SE3_ego @ pose).translation
        seen = camera.project(middle)
        column, row = seen.uv_px.T / STRIDE
        inside = seen.valid & (column >= 0.0) & (row >= 0.0)
        inside &= (column < settings.width_px // STRIDE) & (row < settings.height_px // STRIDE)
        cell[inside, place] = np.stack((column, row), -1)[inside]
        # The size in tokens is that of a small step across the line of sight.
        distance = np.linalg.norm(middle, axis=1)
        aside = camera.project(middle + np.array((0.01, 0.0, 0.0)) * distance[:, None]).uv_px
        tokens = np.linalg.norm(aside - seen.uv_px, axis=1) / STRIDE * 100.0 / distance
        extent = 0.5 * (size[:, 2] + 0.5 * (size[:, 0] + size[:, 1]))
        spread[inside, place] = np.clip(_SPREAD * extent * tokens, *_SPREAD_RANGE)[inside]
    return cell, spread


def read_samples(frames: Iterable[Frame], settings: NetworkSettings, range_m: float) -> list[Sample]:
    """Read frames with their boxes."""
    return [read_sample(frame, settings, range_m) for frame in frames]


def rig_input(cameras: Sequence[CameraInput], device: torch.device | str = "cpu") -> TinyRigInput:
    """Return the input of the network for frames with equally many cameras."""
    images = torch.from_numpy(np.stack([one.images for one in cameras])).to(device)
    directions = torch.from_numpy(np.stack([one.directions for one in cameras])).to(device)
    origins = torch.from_numpy(np.stack([one.origins for one in cameras])).to(device)
    return TinyRigInput(images.permute(0, 1, 4, 2, 3).float() / 127.5 - 1.0, directions, origins)
