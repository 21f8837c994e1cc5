"""Motion blur: the motion of each pixel while the shutter is open, and the mean along its path."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from mirror.arrays import Float32, Float64
from mirror.portable import arrays

BLOCK_PX: Final = 4
_LEAST_PX: Final = 1.0
# Samples are placed in pairs around the pixel: the first pair from a motion of one pixel, another every 2.6 pixels.
_PAIRS_PER_PX: Final = 0.38
_FIRST_PAIR: Final = 0.62
_MOST_PAIRS: Final = 6
_EDGE_PX: Final = 0.01


class ImageJacobian(NamedTuple):
    """The Jacobian from directions to pixels, on blocks of BLOCK_PX pixels.

    Attributes:
        rays: (h, w, 3) unit directions through the middles of the blocks, camera frame.
        pixels: (h, w, 2, 3) derivatives of the pixel position, right and down, by the unit direction.
    """

    rays: Float64
    pixels: Float64


def compute_image_jacobian(rays: Float64) -> ImageJacobian:
    """Compute the Jacobian of a lens from finite differences of its rays.

    Args:
        rays: (H, W, 3) unit directions through the pixel centres, camera frame; at least 2 x 2.
    """
    right, down = np.gradient(rays, axis=1), np.gradient(rays, axis=0)
    rows = np.minimum(np.arange(BLOCK_PX // 2, rays.shape[0] + BLOCK_PX // 2, BLOCK_PX), rays.shape[0] - 1)
    columns = np.minimum(np.arange(BLOCK_PX // 2, rays.shape[1] + BLOCK_PX // 2, BLOCK_PX), rays.shape[1] - 1)
    slopes = np.stack([right[np.ix_(rows, columns)], down[np.ix_(rows, columns)]], axis=-2)
    return ImageJacobian(
        np.ascontiguousarray(rays[np.ix_(rows, columns)]),
        arrays.solve(arrays.matmul(slopes, slopes.swapaxes(-1, -2)), slopes),
    )


def compute_image_motion(
    jacobian: ImageJacobian,
    distance_m: Float32,
    velocity_mps: npt.ArrayLike,
    turn_radps: npt.ArrayLike,
    exposure_s: float,
) -> Float32:
    """Compute the motion of the static world in an image during the exposure.

    Uses the image Jacobian (S. Hutchinson, G. Hager, P. Corke, A tutorial on visual servo control, 1996).

    Args:
        jacobian: Jacobian of the lens.
        distance_m: (H, W) distances along the rays; infinite for the sky.
        velocity_mps: (3,) velocity of the camera, camera frame.
        turn_radps: (3,) angular velocity of the camera, camera frame.
        exposure_s: exposure time.

    Returns:
        (H, W, 2) motion in pixels, right and down.
    """
    velocity = exposure_s * np.asarray(velocity_mps, np.float64)
    turn = exposure_s * np.asarray(turn_radps, np.float64)
    near = arrays.matmul(-jacobian.pixels, velocity)
    far = -np.einsum("hwij,hwj->hwi", jacobian.pixels, np.cross(turn, jacobian.rays))
    return _flow(near, far, distance_m)


@njit(cache=True, nogil=True, error_model="numpy")
def _flow(near: Float64, far: Float64, distance: Float32) -> Float32:
    height, width = distance.shape
    flow = np.empty((height, width, 2), np.float32)
    for row in range(height):
        i = row // BLOCK_PX
        for column in range(width):
            j = column // BLOCK_PX
            nearness = 1.0 / distance[row, column]
            flow[row, column, 0] = near[i, j, 0] * nearness + far[i, j, 0]
            flow[row, column, 1] = near[i, j, 1] * nearness + far[i, j, 1]
    return flow


@njit(cache=True, nogil=True, error_model="numpy")
def apply_motion_blur(image: Float32, flow: Float32) -> Float32:
    """Average each pixel along its path, which is centred on the pixel; paths below one pixel are not blurred.

    Args:
        image: (H, W, 3) radiance.
        flow: (H, W, 2) motion in pixels, right and down.
    """
    height, width = image.shape[:2]
    out = np.empty_like(image)
    half, edge = np.float32(0.5), np.float32(_EDGE_PX)
    right_end, lower_end = np.float32(width) - edge, np.float32(height) - edge
    for row in range(height):
        for column in range(width):
            right, down = flow[row, column, 0], flow[row, column, 1]
            square = right * right + down * down
            if square < np.float32(_LEAST_PX * _LEAST_PX):
                out[row, column, 0] = image[row, column, 0]
                out[row, column, 1] = image[row, column, 1]
                out[row, column, 2] = image[row, column, 2]
                continue
            pairs = min(int(np.float32(_PAIRS_PER_PX) * math.sqrt(square) + np.float32(_FIRST_PAIR)), _MOST_PAIRS)
            share = np.float32(1.0) / np.float32(2 * pairs + 1)
            dx, dy = right * share, down * share
            reach_x, reach_y = abs(dx) * np.float32(pairs), abs(dy) * np.float32(pairs)
            x, y = np.float32(column) + half, np.float32(row) + half
            red, green, blue = image[row, column, 0], image[row, column, 1], image[row, column, 2]
            clear = x - reach_x > edge and x + reach_x < right_end
            if clear and y - reach_y > edge and y + reach_y < lower_end:
                for step in range(1, pairs + 1):
                    aside, along = dx * np.float32(step), dy * np.float32(step)
                    i, j = np.uint32(y + along), np.uint32(x + aside)
                    k, m = np.uint32(y - along), np.uint32(x - aside)
                    red += image[i, j, 0] + image[k, m, 0]
                    green += image[i, j, 1] + image[k, m, 1]
                    blue += image[i, j, 2] + image[k, m, 2]
            else:
                for step in range(1, pairs + 1):
                    aside, along = dx * np.float32(step), dy * np.float32(step)
                    below, right_of = min(max(int(y + along), 0), height - 1), min(max(int(x + aside), 0), width - 1)
                    above, left_of = min(max(int(y - along), 0), height - 1), min(max(int(x - aside), 0), width - 1)
                    red += image[below, right_of, 0] + image[above, left_of, 0]
                    green += image[below, right_of, 1] + image[above, left_of, 1]
                    blue += image[below, right_of, 2] + image[above, left_of, 2]
            out[row, column, 0], out[row, column, 1], out[row, column, 2] = red * share, green * share, blue * share
    return out
