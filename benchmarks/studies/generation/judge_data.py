"""What the judges are trained and checked on: masks of road users, and crops of their boxes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from hybridworldsim.generation.clips.clip import ABSENT, Clip
from mirror.arrays import Bool, Float64, Int64, UInt8
from mirror.geometry import Poses, project_boxes
from mirror.geometry.cameras import Camera

LEAST_PX: Final = 60
"""Least visible pixels of a road user that is judged, and least pixels of a mask."""
CROP_PX: Final = 32
_MARGIN: Final = 1.2
_LEAST_INSIDE: Final = 0.6
_LEAST_SHARE: Final = 0.35


@dataclass(frozen=True, eq=False)
class JudgedBox:
    """A box of which a view shows enough to judge it.

    Attributes:
        frame: number of the frame.
        view: number of the view.
        track: number of the road user.
        category: number of its class.
        square_px: (4,) left, top, right, bottom of the square that is cropped; it may leave the image.
    """

    frame: int
    view: int
    track: int
    category: int
    square_px: Float64


def pinhole(clip: Clip, view: int) -> Camera:
    """Return the camera of a view."""
    height, width = clip.size_px
    lens = clip.intrinsics[view]
    return Camera(
        "pinhole", width, height, fx_px=lens[0, 0], fy_px=lens[1, 1], cx_px=lens[0, 2], cy_px=lens[1, 2]
    )  # fmt: skip


def judged_boxes(clip: Clip) -> Iterator[JudgedBox]:
    """Yield the boxes of which enough is shown.

    At least `LEAST_PX` pixels are visible, which are not a small part of the box, and most of the box's rectangle lies
    in the image.
    """
    if clip.tracks is None:
        return
    height, width = clip.size_px
    for frame in range(len(clip)):
        boxes = clip.boxes.at(frame)
        for view in range(len(clip.views)):
            camera_SE3_box = Poses.from_matrix(np.linalg.inv(clip.ego_SE3_camera[view]) @ boxes.ego_SE3_box)
            projected = project_boxes(pinhole(clip, view), camera_SE3_box, boxes.lwh_m)
            for row in np.flatnonzero(projected.visible & (camera_SE3_box.translation[:, 2] > 0.0)):
                hull = projected.hull(int(row))
                low, high = hull.min(axis=0), hull.max(axis=0)
                inside = np.minimum(high, (width, height)) - np.maximum(low, 0.0)
                pixels = int((clip.tracks[frame, view] == boxes.track[row]).sum())
                if pixels < LEAST_PX or inside.prod() < _LEAST_INSIDE * (high - low).prod():
                    continue
                if pixels < _LEAST_SHARE * inside.prod():
                    continue
                half, middle = 0.5 * _MARGIN * (high - low).max(), 0.5 * (low + high)
                square = np.concatenate([middle - half, middle + half])
                yield JudgedBox(frame, view, int(boxes.track[row]), int(boxes.category[row]), square)


def crop(image: UInt8, square_px: Float64) -> UInt8:
    """Resample a square of an image (H, W, 3) to `CROP_PX`; its border is repeated outside."""
    left, top, right, _ = square_px
    scale = (right - left) / CROP_PX
    # Pixel centres: 0.5 of the crop is 0.5 pixels of its own size behind the square's border.
    matrix = np.array([[scale, 0.0, left + 0.5 * scale - 0.5], [0.0, scale, top + 0.5 * scale - 0.5]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(image, matrix, (CROP_PX, CROP_PX), flags=flags, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )


def collect_crops(clips: Sequence[Clip]) -> tuple[UInt8, Int64]:
    """Return the true crops (N, CROP_PX, CROP_PX, 3) and their classes (N,)."""
    crops, classes = [np.zeros((0, CROP_PX, CROP_PX, 3), np.uint8)], [0][:0]
    for clip in clips:
        for box in judged_boxes(clip):
            crops.append(crop(clip.images[box.frame, box.view], box.square_px)[None])
            classes.append(box.category)
    return np.concatenate(crops), np.array(classes, np.int64)


def collect_masks(clips: Sequence[Clip], every: int) -> tuple[UInt8, UInt8, Bool]:
    """Return the images and backgrounds (N, H, W, 3) and masks (N, H, W) of road users, of every so many frames."""
    images, backgrounds, masks = [], [], []
    for clip in clips:
        if clip.tracks is None:
            continue
        images.append(clip.images[::every].reshape(-1, *clip.images.shape[2:]))
        backgrounds.append(clip.background[::every].reshape(-1, *clip.images.shape[2:]))
        masks.append((clip.tracks[::every] != ABSENT).reshape(-1, *clip.size_px))
    return np.concatenate(images), np.concatenate(backgrounds), np.concatenate(masks)
