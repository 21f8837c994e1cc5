"""Pastes panels with plates into images in perspective, with the exact corners of the plates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from benchmarks.plates.drawing import Panel
from mirror.arrays import Float32, Float64, UInt8

FOCAL: Final = 0.714
"""Focal length as a share of the width of an image of 1280 pixels: a view of 70 degrees."""


@dataclass(frozen=True)
class Stance:
    """Pose of a plate before the camera.

    Attributes:
        width_px: extent of the plate along the rows of the image.
        centre_px: its middle.
        yaw_deg: turn about the vertical.
        pitch_deg: turn about the horizontal.
        roll_deg: turn in the image.
    """

    width_px: float
    centre_px: tuple[float, float]
    yaw_deg: float
    pitch_deg: float
    roll_deg: float


def place_corners(stance: Stance, aspect: float, focal_px: float, reach: float) -> Float64:
    """Return the corners (4, 2) of a plate in the image, from the upper left one clockwise.

    Args:
        stance: how the plate stands.
        aspect: width of the plate over its height.
        focal_px: focal length.
        reach: how far the panel reaches from the middle, in widths of the plate; it must stay before the camera.
    """
    half = 0.5 / aspect
    flat = np.array([[-0.5, -half, 0.0], [0.5, -half, 0.0], [0.5, half, 0.0], [-0.5, half, 0.0]])
    yaw, pitch, roll = np.radians([stance.yaw_deg, stance.pitch_deg, stance.roll_deg])
    about_y = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    about_z = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    points = flat @ (about_z @ about_x @ about_y).T
    depth = max(focal_px / stance.width_px, 2.0 * reach)
    seen = points[:, :2] * depth / (depth + points[:, 2:])
    seen *= stance.width_px / np.ptp(seen[:, 0])
    return np.asarray(seen + np.array(stance.centre_px), np.float64)


def paste(image: UInt8, panel: Panel, corners: Float64, gain: Float32, lit_gain: float) -> tuple[int, int, int, int]:
    """Paste a panel so that its plate lies at corners; the image is changed.

    Args:
        image: (H, W, 3).
        panel: the panel.
        corners: (4, 2).
        gain: (3,) gain of the panel's colours.
        lit_gain: gain of the plate in addition.

    Returns:
        Left, top, right and bottom of the pixels that may have changed.
    """
    panel = _shrunk(panel, float(np.ptp(corners[:, 0])))
    left, top, right, bottom = panel.box_px
    source = np.array([[left, top], [right, top], [right, bottom], [left, bottom]], np.float32)
    matrix = cv2.getPerspectiveTransform(source, corners.astype(np.float32))
    height, width = panel.alpha.shape
    rim = np.array([[[0, 0], [width, 0], [width, height], [0, height]]], np.float32)
    seen = cv2.perspectiveTransform(rim, matrix)[0]
    x0, y0 = (max(int(np.floor(one)), 0) for one in seen.min(axis=0))
    x1, y1 = (min(int(np.ceil(one)), limit) for one, limit in zip(seen.max(axis=0), image.shape[1::-1]))
    if x1 <= x0 or y1 <= y0:
        return 0, 0, 0, 0
    # Centres of pixels lie at half numbers, which OpenCV counts as whole ones.
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    moved = np.array([[1, 0, -x0], [0, 1, -y0], [0, 0, 1]], np.float64)
    inner = np.linalg.inv(half) @ moved @ matrix @ half
    size = (x1 - x0, y1 - y0)
    shaded = _scaled(panel.image, gain)
    plate = shaded[round(top) : round(bottom), round(left) : round(right)]
    plate[:] = _scaled(plate, np.full(3, lit_gain, np.float32))
    colour = cv2.warpPerspective(shaded, inner, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    cover = cv2.warpPerspective(panel.alpha, inner, size, flags=cv2.INTER_LINEAR).astype(np.float32) / 255.0
    part = image[y0:y1, x0:x1]
    part[:] = cv2.blendLinear(np.ascontiguousarray(part), colour, 1.0 - cover, cover)
    return x0, y0, x1, y1


def _shrunk(panel: Panel, width_px: float) -> Panel:
    """A panel at about the scale of the image: a smaller one stays smooth, as a camera's lens makes it."""
    left, top, right, bottom = panel.box_px
    share = 1.2 * width_px / (right - left)
    if share > 0.8:
        return panel
    high, wide = panel.alpha.shape
    size = (max(round(share * wide), 2), max(round(share * high), 2))
    image, alpha = (cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in (panel.image, panel.alpha))
    u, v = size[0] / wide, size[1] / high
    return Panel(np.asarray(image, np.uint8), np.asarray(alpha, np.uint8), (u * left, v * top, u * right, v * bottom))


def _scaled(image: UInt8, gain: Float32) -> UInt8:
    """An image (H, W, 3) whose colours are multiplied by gains (3,)."""
    return np.asarray(cv2.transform(image, np.diag(gain)), np.uint8)


def bounds(corners: Float64, width_px: int, height_px: int) -> tuple[Float64, float]:
    """Return the box (4,) of corners within an image, and the share of the whole box that lies in it."""
    whole = np.concatenate([corners.min(axis=0), corners.max(axis=0)])
    inside = np.clip(whole, 0.0, [width_px, height_px, width_px, height_px])
    area = float(np.prod(whole[2:] - whole[:2]))
    return inside, float(np.prod(inside[2:] - inside[:2])) / max(area, 1e-9)
