"""Resizing as the published definitions have it: they differ by several grey levels, and so does every FID and FVD."""

from __future__ import annotations

import math
from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

FidResize = Literal["clean", "tf1"]
VideoCrop = Literal["direct224", "centre-crop"]


def resize_clean(images: Tensor, size: int) -> Tensor:
    """Resize by bicubic interpolation with antialiasing, clamped.

    It is clean-fid's (Parmar et al., 2022), there by Pillow, channel by channel.

    Args:
        images: (n, 3, h, w), 0 to 255, float.
        size: of the result.
    """
    resized = functional.interpolate(images, (size, size), mode="bicubic", antialias=True, align_corners=False)
    return resized.clamp_(0.0, 255.0)


def resize_tf1(images: Tensor, size: int) -> Tensor:
    """Resize bilinearly without antialiasing, corner to corner and not centre to centre.

    It is TensorFlow 1's, as the first FID had.

    Args:
        images: (n, 3, h, w), float.
        size: of the result.
    """
    return _along(_along(images, 3, size), 2, size)


def _along(images: Tensor, axis: int, size: int) -> Tensor:
    length = images.shape[axis]
    at = torch.arange(size, dtype=torch.float32) * torch.tensor(length / size, dtype=torch.float32)
    low = at.long().clamp_max(length - 1)
    high = (low + 1).clamp_max(length - 1)
    share = (at - low).to(images.dtype).reshape([-1 if each == axis else 1 for each in range(4)])
    below = images.index_select(axis, low)
    return below + (images.index_select(axis, high) - below) * share


def resize_video(frames: Tensor, crop: VideoCrop, size: int = 224) -> Tensor:
    """Resize and crop frames to the input of I3D.

    Args:
        frames: (n, 3, h, w), float.
        crop: ``direct224`` squeezes the whole frame (TensorFlow's, cd-fvd); ``centre-crop`` makes the shorter side 224
            and cuts the middle out (VideoGPT, common_metrics): 44 % of a 16:9 frame are gone.
        size: of the result.
    """
    if crop == "direct224":
        return functional.interpolate(frames, (size, size), mode="bilinear", align_corners=False)
    height, width = frames.shape[2:]
    scale = size / min(height, width)
    # The longer side is rounded up, as VideoGPT has it, so that it never falls short of the crop.
    longer = math.ceil(max(height, width) * scale)
    target = (size, longer) if height < width else (longer, size)
    resized = functional.interpolate(frames, target, mode="bilinear", align_corners=False)
    top, left = (target[0] - size) // 2, (target[1] - size) // 2
    return resized[:, :, top : top + size, left : left + size]
