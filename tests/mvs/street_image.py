"""An image of houses below a sky, with its truth."""

from __future__ import annotations

import numpy as np

from hybridworldsim.mvs.estimator import StereoImage
from mirror.geometry.poses import Poses

SIZE = (60, 80)

# A level camera that faces north; its y axis points down.
LEVEL = Poses.from_matrix(np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]]))

UNKNOWN_DEPTH = np.full(SIZE, np.nan, np.float32)


def make_street_image(sky: tuple[int, int, int], house: tuple[int, int, int]) -> tuple[StereoImage, np.ndarray]:
    rng = np.random.default_rng(0)
    rgb = np.full((*SIZE, 3), house, np.int64) + rng.integers(-40, 40, (*SIZE, 1))
    roof = (14 + 6 * np.sin(np.arange(SIZE[1]) / 9.0)).astype(int)
    truth = np.arange(SIZE[0])[:, None] < roof
    rgb[truth] = sky
    rgb += rng.integers(-1, 2, rgb.shape)
    K = np.array([[60.0, 0, 40], [0, 60.0, 35], [0, 0, 1]])
    image = StereoImage(np.clip(rgb, 0, 255).astype(np.uint8), K, LEVEL, np.ones(SIZE, np.bool_))
    return image, truth
