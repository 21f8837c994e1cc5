"""A textured corridor, and a camera whose images show its mounting exactly."""

from __future__ import annotations

import struct
import zlib
from functools import cache

import cv2
import numpy as np

from mirror.geometry import Poses
from mirror.geometry.cameras import Camera

LENS = Camera("pinhole", 400, 300, 320.0, 320.0, 201.0, 149.0)
NOMINAL = Poses(np.array([[0.5, -0.5, 0.5, -0.5]]), np.array([[1.5, 0.0, 1.6]]))


@cache
def _texture() -> np.ndarray:
    noise = cv2.GaussianBlur(np.random.default_rng(1).normal(size=(512, 512)).astype(np.float32), (0, 0), 2.0)
    return np.clip(128.0 + 45.0 * noise / noise.std(), 0, 255)


def corridor(camera_pose: Poses) -> np.ndarray:
    """A PNG of what the camera sees between two walls, a floor and a ceiling, all textured."""
    rays = LENS.rays().direction.reshape(-1, 3)
    origin = camera_pose.translation[0]
    way = camera_pose.transform(rays)[0] - origin
    with np.errstate(divide="ignore"):
        to_walls = np.where(way[:, 1] > 0, 6.0 - origin[1], -6.0 - origin[1]) / way[:, 1]
        to_floor = np.where(way[:, 2] > 0, 8.0 - origin[2], -origin[2]) / way[:, 2]
    hit = origin + np.minimum(to_walls, to_floor)[:, None] * way
    across = np.where(to_walls < to_floor, hit[:, 2] + 40.0 * np.sign(way[:, 1]), hit[:, 1])
    maps = [(25.0 * value % 511.0).reshape(300, 400).astype(np.float32) for value in (hit[:, 0], across)]
    # Far away the texture is finer than a pixel: it fades out.
    far = np.clip(1.5 - np.linalg.norm(hit - origin, axis=1) / 40.0, 0.0, 1.0).reshape(300, 400)
    grey = 128.0 + far * (cv2.remap(_texture(), *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP) - 128.0)
    return cv2.imencode(".png", np.repeat(grey[..., None], 3, axis=2).astype(np.uint8))[1].tobytes()


def padded(png: bytes, length: int) -> bytes:
    """A PNG with a text chunk, so that it has the length that the rows state."""
    text = b"tEXt" + b"pad\0" + b" " * (length - len(png) - 16)
    return png[:-12] + struct.pack(">I", len(text) - 4) + text + struct.pack(">I", zlib.crc32(text)) + png[-12:]
