"""Encodings of positions: depths, points of camera rays, sines of positions in the images and of queries in space."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def lid_depths(count: int, start_m: float, end_m: float, *, dtype: torch.dtype = torch.float32) -> Tensor:
    """Return depths (count,) with linearly increasing steps.

    d_i = start + (end - start) i (i + 1) / (count (count + 1)).
    """
    index = torch.arange(count, dtype=dtype)
    return start_m + (end_m - start_m) / (count * (1 + count)) * index * (index + 1)


def matrix_points(
    image_from_frame: Tensor, height: int, width: int, image_size: tuple[int, int], depths: Tensor
) -> Tensor:
    """Return the points of pinhole cameras at pixels at multiples of the stride, without the half pixel, as published.

    Args:
        image_from_frame: (N, 4, 4) projection of each camera, onto pixels of the resized image.
        height: rows of the feature map.
        width: columns of the feature map.
        image_size: height and width of the padded image.
        depths: (D,) depths along the optical axis.

    Returns:
        (N, H, W, D, 3) in the frame.
    """
    dtype = image_from_frame.dtype
    v = torch.arange(height, dtype=dtype) * image_size[0] / height
    u = torch.arange(width, dtype=dtype) * image_size[1] / width
    d = depths.to(dtype)
    shape = (height, width, len(d))
    grid = torch.stack(
        (u[None, :, None].expand(shape), v[:, None, None].expand(shape), d[None, None].expand(shape)), -1
    )
    scaled = torch.cat(
        (grid[..., :2] * grid[..., 2:].clamp(min=1e-5), grid[..., 2:], torch.ones_like(grid[..., :1])), -1
    )
    points = torch.einsum("nij,hwdj->nhwdi", torch.linalg.inv(image_from_frame), scaled)
    return points[..., :3]


def inverse_sigmoid(x: Tensor, eps: float = 1e-5) -> Tensor:
    """Return the logarithm of the odds, with the odds limited to 1e5."""
    x = x.clamp(0.0, 1.0)
    return torch.log(x.clamp(min=eps) / (1.0 - x).clamp(min=eps))


def encode_points(points: Tensor, position_range: Tensor) -> Tensor:
    """Return the input (N, 3 D, H, W) of the position encoder: channel 3 d + k is coordinate k at depth d.

    Args:
        points: (N, H, W, D, 3).
        position_range: (6,) least, then greatest x, y, z; points beyond are clamped.
    """
    low, high = position_range[:3], position_range[3:]
    return inverse_sigmoid((points - low) / (high - low)).flatten(3).permute(0, 3, 1, 2)


def multiview_sine(cameras: int, height: int, width: int, features: int, *, dtype: torch.dtype) -> Tensor:
    """Return the sine encoding (N, 3 features, H, W) of camera number, row and column.

    In each part all sines come first.

    The camera's number makes this encoding specific to a rig of a fixed number and order of cameras.
    """
    two_pi, eps = 2.0 * math.pi, 1e-6
    frequency = _frequencies(features, dtype)
    parts = []
    for axis, count in enumerate((cameras, height, width)):
        place = torch.arange(1, count + 1, dtype=dtype) / (count + eps) * two_pi
        angle = place[:, None] / frequency
        code = torch.cat((angle[:, 0::2].sin(), angle[:, 1::2].cos()), 1)
        shape = [1, 1, 1, features]
        shape[axis] = count
        parts.append(code.view(shape).expand(cameras, height, width, features))
    return torch.cat(parts, -1).permute(0, 3, 1, 2)


def query_sine(reference: Tensor, features: int) -> Tensor:
    """Return the sine encoding (Q, 3 features) of reference points (Q, 3) in 0..1.

    The order is y, x, z, with sines and cosines alternating.
    """
    frequency = _frequencies(features, reference.dtype).to(reference.device)
    angle = (reference * 2.0 * math.pi)[..., None] / frequency
    code = torch.stack((angle[..., 0::2].sin(), angle[..., 1::2].cos()), -1).flatten(-2)
    return torch.cat((code[..., 1, :], code[..., 0, :], code[..., 2, :]), -1)


def _frequencies(features: int, dtype: torch.dtype) -> Tensor:
    index = torch.arange(features, dtype=dtype)
    return torch.pow(torch.tensor(10000.0, dtype=dtype), 2.0 * torch.floor(index / 2.0) / features)
