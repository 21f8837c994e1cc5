"""Images of a textured facade below a sky, with exact depth."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from hybridworldsim.mvs.estimator import StereoImage
from mirror.arrays import Float32, Float64, UInt8
from mirror.geometry import Poses

_FACING: Final = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]])
_NORMAL: Final = np.array([0.25, 0.97, 0.0])
_AWAY_M, _HEIGHT_M = 12.0, 4.0
_PLACES_M: Final = (0.0, -1.0, 1.0, 0.5, -0.5)
_WAVES: Final = 24


def make_images(width: int, height: int) -> tuple[StereoImage, list[StereoImage]]:
    """Make an image of a facade, and four sources from places beside it."""
    K = np.array([[0.6 * width, 0.0, width / 2], [0.0, 0.6 * width, height / 2], [0.0, 0.0, 1.0]])
    images = []
    for x_m in _PLACES_M:
        pose = _FACING.copy()
        pose[0, 3] = x_m
        black = np.zeros((height, width, 3), np.uint8)
        image = StereoImage(black, K, Poses.from_matrix(pose), np.ones((height, width), np.bool_))
        images.append(replace(image, rgb=_shade(image)))
    return images[0], images[1:]


def true_depth(image: StereoImage) -> Float32:
    """Return the depth (H, W) along the camera's z axis, metres; NaN in the sky."""
    rays, origin = _rays(image), image.world_SE3_camera.translation[0]
    depth = (_AWAY_M - origin @ _NORMAL) / (rays @ _NORMAL)
    return np.where(origin[2] + depth * rays[..., 2] < _HEIGHT_M, depth, np.nan).astype(np.float32)


def _rays(image: StereoImage) -> Float64:
    """Rays (H, W, 3) in the world, of which the camera's z is 1."""
    height, width = image.valid.shape
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(image.K).T
    return np.asarray(rays @ image.world_SE3_camera.matrix()[0, :3, :3].T)


def _shade(image: StereoImage) -> UInt8:
    depth = true_depth(image).astype(np.float64)
    point = image.world_SE3_camera.translation[0] + depth[..., None] * _rays(image)
    rng = np.random.default_rng(0)
    waves, phase = rng.normal(size=(3, _WAVES)) * rng.uniform(0.5, 9.0, _WAVES), rng.uniform(0.0, 6.3, _WAVES)
    grey = 110.0 + 300.0 * np.sin(point @ waves + phase).mean(axis=-1)
    shown = np.where(np.isfinite(depth)[..., None], grey[..., None], np.array([190.0, 205.0, 230.0]))
    return np.clip(shown, 0.0, 255.0).astype(np.uint8)
