"""From a frame of any rig to the input of a published checkpoint: six pinhole images and their projections.

The checkpoints were trained on nuScenes: six cameras in a fixed order, images of 1600 x 900 pixels, boxes in the frame
of the roof lidar (x right, y forward, z up). The encoding of the camera's number ties them to that order
(https://github.com/megvii-research/PETR/issues/127), so each position is filled by the rig's camera of that direction,
and further cameras are left out. Each image is resampled to a pinhole of the angle that the checkpoint knows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from mirror.annotation.detections import AnnotationError
from mirror.arrays import Float32, Float64
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import quaternion_from_matrix

ORDER: Final = ("front_wide", "front_right", "front_left", "rear", "rear_left", "rear_right")
"""Cameras in the order of nuScenes: front, front right, front left, back, back left, back right."""

_FOCAL_SHARE: Final = {"rear": 0.505}
_FRONT_FOCAL_SHARE: Final = 0.79
_BOTTOM_SHARE: Final = 9.0 / 16.0
_BGR_MEAN: Final = np.array((103.53, 116.28, 123.675), np.float32)
_BGR_STD: Final = {"vovnet99": (57.375, 57.12, 58.395), "resnet50": (1.0, 1.0, 1.0)}

# The roof lidar of nuScenes: 0.94 m before the rear axle, 1.84 m above the ground.
EGO_SE3_LIDAR: Final = Poses(
    quaternion_from_matrix(np.array([[[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]])),
    np.array([[0.943713, 0.0, 1.84023]]),
)


@dataclass(frozen=True)
class InputRaster:
    """The raster of the network's images: the lower rows of images with aspect 16:9."""

    width_px: int = 800
    height_px: int = 320

    def pinhole(self, camera: str) -> Camera:
        """Return the camera of the network's image in one of the positions of `ORDER`."""
        focal = self.width_px * _FOCAL_SHARE.get(camera, _FRONT_FOCAL_SHARE)
        whole = self.width_px * _BOTTOM_SHARE
        top = whole - self.height_px
        return Camera(
            "pinhole", self.width_px, self.height_px, focal, focal, 0.5 * self.width_px, 0.5 * whole - top
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class RigInput:
    """Input of the network for one frame.

    Attributes:
        images: (N, 3, H, W) normalised, BGR.
        image_from_lidar: (N, 4, 4) projections onto pixels.
    """

    images: Float32
    image_from_lidar: Float64


def choose_cameras(frame: Frame, names: Mapping[str, str]) -> list[Image]:
    """Return the images of a frame in the order of `ORDER`.

    Args:
        frame: the frame.
        names: the rig's own names of the cameras, by position; a position that is not named has its canonical name.

    Raises:
        AnnotationError: a position has no image in this frame.
    """
    wanted = {position: names.get(position, position) for position in ORDER}
    missing = [f"{position} ({name})" for position, name in wanted.items() if name not in frame.images]
    if missing:
        raise AnnotationError(
            f"no image of {', '.join(missing)}",
            place=f"frame {frame.frame_index}",
            expected="images of all six directions",
            remedy="name the rig's cameras: --set cameras=front_wide:NAME,...",
        )
    return [frame.images[name] for name in wanted.values()]


def prepare(frame: Frame, images: list[Image], raster: InputRaster, backbone: str) -> RigInput:
    """Resample and normalise the images, and compose their projections.

    The poses of the cameras are those at their own exposures, relative to the vehicle at the frame's time.
    """
    planes, projections = [], []
    std = np.array(_BGR_STD[backbone], np.float32)
    for position, image in zip(ORDER, images):
        target = raster.pinhole(position)
        maps = image.camera_model.undistort_maps(target)
        pixels = cv2.remap(image.decode(), *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        planes.append(((pixels[..., ::-1].astype(np.float32) - _BGR_MEAN) / std).transpose(2, 0, 1))
        ego_SE3_camera = frame.world_SE3_ego.inverse() @ image.world_SE3_camera
        projections.append(projection_matrix(target, ego_SE3_camera.inverse() @ EGO_SE3_LIDAR))
    return RigInput(np.stack(planes), np.stack(projections))


def projection_matrix(camera: Camera, camera_SE3_frame: Poses) -> Float64:
    """Return the matrix (4, 4) from homogeneous points to ``(u d, v d, d, 1)``, with OpenCV's pixel coordinates."""
    lens = np.eye(4)
    lens[:3, :3] = camera.intrinsic_matrix(first_pixel_centre=0.0)
    return np.asarray(lens @ camera_SE3_frame.matrix()[0])
