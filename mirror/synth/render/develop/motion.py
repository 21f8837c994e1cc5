"""Motion blur: how far each pixel moves while the shutter is open, and the mean along that way."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from mirror.arrays import Float32, Float64

BLOCK_PX: Final = 4
_LEAST_PX: Final = 1.0
_MOST_TAPS: Final = 11
_TAPS_PER_PX: Final = 0.38
_EDGE_PX: Final = 0.01


class ImageJacobian(NamedTuple):
    """How directions become pixels, over blocks of BLOCK_PX pixels.

    Attributes:
        rays: (h, w, 3) unit directions through the middles of the blocks, camera frame.
        pixels: (h, w, 2, 3) pixels right and down per change of a unit direction.
    """

    rays: Float64
    pixels: Float64


def image_jacobian(rays: Float64) -> ImageJacobian:
    """The Jacobian of any lens, from the differences of its rays.

    Args:
        rays: (H, W, 3) unit directions through the pixel centres, camera frame; at least 2 x 2.
    """
    right, down = np.gradient(rays, axis=1), np.gradient(rays, axis=0)
    rows = np.minimum(np.arange(BLOCK_PX // 2, rays.shape[0] + BLOCK_PX // 2, BLOCK_PX), rays.shape[0] - 1)
    columns = np.minimum(np.arange(BLOCK_PX // 2, rays.shape[1] + BLOCK_PX // 2, BLOCK_PX), rays.shape[1] - 1)
    slopes = np.stack([right[np.ix_(rows, columns)], down[np.ix_(rows, columns)]], axis=-2)
    return ImageJacobian(
        np.ascontiguousarray(rays[np.ix_(rows, columns)]), np.linalg.solve(slopes @ slopes.swapaxes(-1, -2), slopes)
    )


def image_motion(
    jacobian: ImageJacobian,
    distance_m: Float32,
    velocity_mps: npt.ArrayLike,
    turn_radps: npt.ArrayLike,
    exposure_s: float,
) -> Float32:
    """How far what stands still moves in a picture during its exposure.

    By the image Jacobian (S. Hutchinson, G. Hager, P. Corke, A tutorial on visual servo control, 1996).

    Args:
        jacobian: of the lens.
        distance_m: (H, W) along the rays; infinite for the sky.
        velocity_mps: (3,) of the camera, in its own frame.
        turn_radps: (3,) rate of its turning, in its own frame.
        exposure_s: length of the exposure.

    Returns:
        (H, W, 2) pixels right and down.
    """
    velocity = exposure_s * np.asarray(velocity_mps, np.float64)
    turn = exposure_s * np.asarray(turn_radps, np.float64)
    near = -jacobian.pixels @ velocity
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
def blurred(picture: Float32, flow: Float32) -> Float32:
    """Means along each pixel's way, half of it before and half behind; ways below a pixel are left.

    Args:
        picture: (H, W, 3) radiance.
        flow: (H, W, 2) pixels.
    """
    height, width = picture.shape[:2]
    out = np.empty_like(picture)
    for row in range(height):
        for column in range(width):
            right, down = flow[row, column, 0], flow[row, column, 1]
            square = right * right + down * down
            if square < _LEAST_PX * _LEAST_PX:
                out[row, column, 0] = picture[row, column, 0]
                out[row, column, 1] = picture[row, column, 1]
                out[row, column, 2] = picture[row, column, 2]
                continue
            taps = min(2 * int(_TAPS_PER_PX * math.sqrt(square) + 0.62) + 1, _MOST_TAPS)
            dx, dy = right / taps, down / taps
            reach = 0.5 * (taps - 1)
            x, y = column + 0.5 - reach * dx, row + 0.5 - reach * dy
            red, green, blue = 0.0, 0.0, 0.0
            inside = min(x, x + 2.0 * reach * dx) >= _EDGE_PX and min(y, y + 2.0 * reach * dy) >= _EDGE_PX
            inside = inside and max(x, x + 2.0 * reach * dx) < width - _EDGE_PX
            if inside and max(y, y + 2.0 * reach * dy) < height - _EDGE_PX:
                for _ in range(taps):
                    i, j = np.uint32(y), np.uint32(x)
                    red, green, blue = red + picture[i, j, 0], green + picture[i, j, 1], blue + picture[i, j, 2]
                    x, y = x + dx, y + dy
            else:
                for _ in range(taps):
                    i, j = min(max(int(y), 0), height - 1), min(max(int(x), 0), width - 1)
                    red, green, blue = red + picture[i, j, 0], green + picture[i, j, 1], blue + picture[i, j, 2]
                    x, y = x + dx, y + dy
            share = 1.0 / taps
            out[row, column, 0], out[row, column, 1] = red * share, green * share
            out[row, column, 2] = blue * share
    return out
