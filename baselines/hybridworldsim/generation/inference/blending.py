"""Generated pixels near road users, pixels of the empty street elsewhere: hulls of boxes, grown, with a soft edge."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from torch import Tensor

from hybridworldsim.generation.clips.clip import ClipBoxes
from hybridworldsim.generation.layout.boxes import draw_inverse_depth
from mirror.arrays import Bool, Float32, Float64, UInt8


def draw_hulls(boxes: ClipBoxes, intrinsics: Float64, ego_SE3_camera: Float64, size_px: tuple[int, int]) -> Bool:
    """Mark the pixels (V, H, W) that show the inside of at least one box.

    Args:
        boxes: boxes of one frame.
        intrinsics: (V, 3, 3), pixels.
        ego_SE3_camera: (V, 4, 4).
        size_px: height and width of the images.
    """
    return np.stack(
        [
            draw_inverse_depth(np.linalg.inv(mount) @ boxes.ego_SE3_box, boxes.lwh_m, lens, size_px, 1.0) > 0.0
            for mount, lens in zip(ego_SE3_camera, intrinsics)
        ]
    )


def hull_shares(hulls: Bool, grow_px: int) -> Float32:
    """Return the share (V, H, W) that the generated image has in each blended pixel.

    It is 1 in hulls grown by some pixels, falling to 0 behind them.

    Args:
        hulls: (V, H, W), from `draw_hulls`.
        grow_px: pixels; the share is 0 from three times as many on.
    """
    side = 2 * grow_px + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    shares = []
    for hull in hulls:
        grown = cv2.dilate(hull.astype(np.float32), kernel)
        shares.append(np.maximum(grown, cv2.blur(cv2.dilate(grown, kernel), (side, side))))
    return np.stack(shares)


def blend(images: UInt8, background: UInt8, shares: Float32) -> UInt8:
    """Blend images (..., H, W, 3) over a background by shares (..., H, W): 1 is the image, 0 the background."""
    share = shares[..., None]
    mixed: UInt8 = np.round(share * images + (1.0 - share) * background).astype(np.uint8)
    return mixed


def blend_tensors(images: Tensor, background: Tensor, shares: Tensor) -> Tensor:
    """Blend as `blend` does, on the device of the tensors."""
    share = shares[..., None]
    return (share * images + (1.0 - share) * background).round().to(torch.uint8)
