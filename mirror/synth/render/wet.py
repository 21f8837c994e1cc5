"""Reflections on wet ground: the view of a camera that is mirrored at the ground plane."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Float32, Float64
from mirror.portable import arrays
from mirror.synth.render.lens import Lens
from mirror.synth.render.surroundings import GROUND_CELL_M, Surroundings
from mirror.synth.render.view import rasterize_view

_STRETCH_PX: Final = 12
_LEAST_SHARE: Final = 0.03
_REACH_M: Final = 24.0
_ONE_RAY: Final = np.zeros((1, 2), np.float32)
# Share of its diffuse light that a rough, wet surface loses where it mirrors.
_LOST_SHARE: Final = 0.5


def add_reflections(radiance: Float32, scene: Surroundings, lens: Lens, rotation: Float64, origin: Float64) -> Float32:
    """Add the reflections on wet ground to an image.

    The ground is approximated by a plane that is fitted around the camera.

    Args:
        radiance: (H, W, 4) from `RasterizedView.radiance`.
        scene: the scene.
        lens: rays of the camera.
        rotation: (3, 3) world_R_camera.
        origin: (3,) camera position, world metres.

    Returns:
        (H, W, 4) radiance.
    """
    mask = reflection_mask(radiance)
    if not mask.any():
        return radiance
    return blend_reflections(radiance, render_mirrored(scene, lens, rotation, origin, mask))


def render_mirrored(scene: Surroundings, lens: Lens, rotation: Float64, origin: Float64, mask: Float32) -> Float32:
    """Render the radiance (H, W, 4) that wet ground mirrors, where a mask (H, W) is set."""
    normal, offset = fit_ground_plane(scene, origin)
    flip = np.eye(3) - 2.0 * np.outer(normal, normal)
    below = origin - 2.0 * (arrays.matmul(normal, origin) - offset) * normal
    mirrored = rasterize_view(
        scene, lens, arrays.matmul(flip, rotation), below, offsets=_ONE_RAY, mask=mask, ground=False
    )
    return mirrored.radiance(2.0)


def blend_reflections(radiance: Float32, mirrored: Float32) -> Float32:
    """Add mirrored radiance (H, W, 4) to an image (H, W, 4), blurred as ripples and the road's roughness do."""
    return _blend_reflection(radiance, _stretch_vertically(mirrored))


def fit_ground_plane(scene: Surroundings, place: Float64) -> tuple[Float64, float]:
    """Fit a plane to the ground around a position (3,); returns its unit normal (3,) and offset."""
    ground, left, low = scene.ground, float(scene.maps["ground_origin_0"]), float(scene.maps["ground_origin_1"])
    column, row = round((place[0] - left) / GROUND_CELL_M), round((place[1] - low) / GROUND_CELL_M)
    reach = math.ceil(_REACH_M / GROUND_CELL_M)
    rows = np.arange(max(row - reach, 0), min(row + reach + 1, ground.shape[0]))
    columns = np.arange(max(column - reach, 0), min(column + reach + 1, ground.shape[1]))
    if len(rows) < 2 or len(columns) < 2:
        return np.array([0.0, 0.0, 1.0]), 0.0
    x, y = np.meshgrid(left + columns * GROUND_CELL_M - place[0], low + rows * GROUND_CELL_M - place[1])
    z = ground[np.ix_(rows, columns)].astype(np.float64)
    # The ground below the camera has the largest weight, because pavements and verges are higher.
    weight = arrays.exp(-(x * x + y * y) / (0.5 * _REACH_M) ** 2).ravel()
    terms = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1) * weight[:, None]
    # Least squares by the normal equations, which the weights leave well conditioned.
    slope_x, slope_y, height = arrays.solve(arrays.matmul(terms.T, terms), arrays.matmul(terms.T, z.ravel() * weight))
    normal = np.array([-slope_x, -slope_y, 1.0])
    normal /= arrays.norm(normal)
    return normal, float(arrays.matmul(normal, (place[0], place[1], height)))


def reflection_mask(radiance: Float32) -> Float32:
    """Mask (H, W) of pixels whose mirrored radiance is needed: those that mirror, and those blurred into them."""
    import cv2

    share = radiance[..., 3]
    rows = np.ones((2 * _STRETCH_PX + 1, 1), np.uint8)
    mask: Float32 = cv2.dilate((share > _LEAST_SHARE).astype(np.uint8), rows).astype(np.float32)
    return mask


def _stretch_vertically(mirrored: Float32) -> Float32:
    """Blur a reflection vertically, as ripples and the roughness of the road do."""
    import cv2

    # Two box filters approximate a Gaussian.
    stretched = cv2.blur(mirrored, (1, _STRETCH_PX + 1), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(cv2.blur(stretched, (1, _STRETCH_PX + 1), borderType=cv2.BORDER_REPLICATE), np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _blend_reflection(radiance: Float32, mirrored: Float32) -> Float32:
    height, width = radiance.shape[:2]
    out = radiance.copy()
    for row in range(height):
        for column in range(width):
            share = radiance[row, column, 3]
            if share > _LEAST_SHARE:
                for channel in range(3):
                    direct = radiance[row, column, channel] * (1.0 - _LOST_SHARE * share)
                    out[row, column, channel] = direct + share * mirrored[row, column, channel]
    return out
