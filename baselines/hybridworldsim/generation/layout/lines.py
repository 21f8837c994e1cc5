"""Draws lines of space into the image of a pinhole camera, with smooth borders."""

from __future__ import annotations

import numba
import numpy as np

from mirror.arrays import Bool, Float32, Float64
from mirror.errors import UsageError

NEAR_M = 0.05
"""Distance of the plane at which lines are cut, along the camera's axis."""


def clip_at_near(segments_m: Float64, near_m: float = NEAR_M) -> tuple[Float64, Bool]:
    """Cut segments at the near plane.

    Args:
        segments_m: (S, 2, 3) ends in the camera frame.
        near_m: distance of the plane.

    Returns:
        Segments (S, 2, 3), and which of them (S,) have a part in front of the plane.
    """
    z = segments_m[..., 2]
    in_front = z >= near_m
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (near_m - z[:, 0]) / (z[:, 1] - z[:, 0])
        crossing = segments_m[:, 0] + share[:, None] * (segments_m[:, 1] - segments_m[:, 0])
    crossing[:, 2] = near_m
    return np.where(in_front[..., None], segments_m, crossing[:, None]), np.asarray(in_front.any(axis=1))


def draw_lines(
    segments_m: Float64, colours: Float64, intrinsics: Float64, size_px: tuple[int, int], width_px: float
) -> Float32:
    """Draw segments in order, each over the earlier ones.

    A pixel takes the share ``clip(width / 2 + 1 / 2 - distance, 0, 1)`` of a line's colour, where the distance is that
    of its centre from the projected segment, in pixels.

    Args:
        segments_m: (S, 2, 3) ends in the camera frame.
        colours: (S, 3) from 0 to 1.
        intrinsics: (3, 3) of the pinhole camera, pixels; the centre of the first pixel is at (0.5, 0.5).
        size_px: height and width of the image.
        width_px: width of the lines.

    Returns:
        (3, height, width) from 0 to 1; 0 where no line is.

    Raises:
        UsageError: a segment is not finite, or the camera has skew.
    """
    require_pinhole(intrinsics)
    if not np.isfinite(segments_m).all():
        row = int(np.argmin(np.isfinite(segments_m).all(axis=(1, 2))))
        raise UsageError("a line that is not finite", place=f"segment {row}", expected="finite ends, in metres")
    cut, shown = clip_at_near(segments_m)
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = cut[..., :2] / cut[..., 2:] * intrinsics[[0, 1], [0, 1]] + intrinsics[:2, 2]
    image = np.zeros((3, *size_px), np.float32)
    _draw(image, np.ascontiguousarray(ends[shown]), np.ascontiguousarray(colours[shown]), 0.5 * width_px + 0.5)
    return image


def require_pinhole(intrinsics: Float64) -> None:
    """Check a matrix of intrinsics.

    Raises:
        UsageError: it is not that of a pinhole camera without skew.
    """
    plain = np.array([[intrinsics[0, 0], 0.0, intrinsics[0, 2]], [0.0, intrinsics[1, 1], intrinsics[1, 2]], [0, 0, 1]])
    if not np.array_equal(plain, intrinsics) or not (intrinsics[[0, 1], [0, 1]] > 0.0).all():
        raise UsageError(f"intrinsics {intrinsics.tolist()}", expected="a pinhole camera without skew")


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _draw(image: Float32, ends: Float64, colours: Float64, reach: float) -> None:
    _, height, width = image.shape
    for index in range(len(ends)):
        x, y = ends[index, 0]
        dx, dy = ends[index, 1, 0] - x, ends[index, 1, 1] - y
        length = dx * dx + dy * dy
        # The first pixel whose centre is at least at the edge of the line's rectangle; the last one after it.
        left = max(min(x, x + dx) - reach - 0.5, -1.0)
        right = min(max(x, x + dx) + reach - 0.5, width + 0.0)
        top = max(min(y, y + dy) - reach - 0.5, -1.0)
        bottom = min(max(y, y + dy) + reach - 0.5, height + 0.0)
        for row in range(max(int(np.floor(top)), 0), min(int(np.ceil(bottom)) + 1, height)):
            for column in range(max(int(np.floor(left)), 0), min(int(np.ceil(right)) + 1, width)):
                px, py = column + 0.5 - x, row + 0.5 - y
                along = (px * dx + py * dy) / length if length > 0.0 else 0.0
                along = min(max(along, 0.0), 1.0)
                distance = np.hypot(px - along * dx, py - along * dy)
                share = min(max(reach - distance, 0.0), 1.0)
                if share > 0.0:
                    for channel in range(3):
                        image[channel, row, column] += share * (colours[index, channel] - image[channel, row, column])
