"""Images of textured planes with depth in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybridworldsim.mvs.estimator import StereoImage
from mirror.geometry.poses import Poses

SIZE = (72, 48)
FOCAL = 60.0


@dataclass(frozen=True)
class Wall:
    """The plane ``normal . X = offset_m`` in the world, with a smooth texture of many scales."""

    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    offset_m: float = 8.0
    seed: int = 0

    def grey(self, point: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(self.seed)
        waves = rng.normal(size=(24, 3)) * rng.uniform(0.5, 6.0, size=(24, 1))
        phase = rng.uniform(0.0, 2.0 * np.pi, 24)
        return np.sin(point @ waves.T + phase).mean(axis=-1)


def make_intrinsics() -> np.ndarray:
    width, height = SIZE
    return np.array([[FOCAL, 0.0, width / 2], [0.0, FOCAL, height / 2], [0.0, 0.0, 1.0]])


def make_rays() -> np.ndarray:
    width, height = SIZE
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(make_intrinsics()).T


def compute_depth(wall: Wall, x_m: float) -> np.ndarray:
    """Compute the depth map of a camera at (x, 0, 0) that looks along z."""
    normal = np.asarray(wall.normal)
    return (wall.offset_m - normal[0] * x_m) / (make_rays() @ normal)


def make_image(
    wall: Wall, x_m: float, *, gain: float = 1.0, shift: float = 0.0, valid: np.ndarray | None = None
) -> StereoImage:
    point = make_rays() * compute_depth(wall, x_m)[..., None] + np.array([x_m, 0.0, 0.0])
    grey = np.clip(128.0 + shift + gain * 320.0 * wall.grey(point), 0, 255)
    rgb = np.repeat(np.round(grey).astype(np.uint8)[..., None], 3, axis=2)
    pose = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[x_m, 0.0, 0.0]]))
    pixels = np.ones(rgb.shape[:2], np.bool_) if valid is None else valid
    return StereoImage(rgb, make_intrinsics(), pose, pixels)
