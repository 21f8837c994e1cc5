"""Composes agents into images of the empty street: hidden by what is nearer, with a contact shadow under them.

An agent is hidden where the street before it covers most of a pixel. The mean depth of a reconstruction does not tell
that: at the edges of things, and where a short training left mist in the air, it lies between near and far.
Nothing fixed stands on a road, so what seems to hide an agent from a place above the drivable area, or from just before
the camera, is ignored.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numba import njit

from hybridworldsim.simulator.renderers.agent_layer import AgentImage
from mirror.arrays import Bool, Float32, Float64, UInt8

TOLERANCE_M: Final = 0.4
TOLERANCE_SHARE: Final = 0.03
"""An agent is hidden by what is nearer than it by more than this distance and share of the depth."""
NEAREST_M: Final = 1.0
"""Nothing fixed has so small a camera z before a vehicle that drives on a road."""
HIDDEN: Final = 0.75
"""An agent is hidden where the street before it covers a larger share of a pixel: things do, most mist does not."""
CELL_M: Final = 0.25
_BEYOND_M: Final = 60.0
_SHIFT: Final = 4
SHADE: Final = 0.75
FADE_M: Final = 0.25
REACH_M: Final = 0.9
HEIGHT_M: Final = 0.45
FARTHEST_M: Final = 70.0
_NEAR_M: Final = 0.2


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """The drivable area as a grid: places where nothing fixed stands.

    Attributes:
        is_free: (rows, columns) cells along y and x.
        origin_m: (x, y) of the corner of the first cell.
    """

    is_free: Bool
    origin_m: Float64


def free_space(rings: Sequence[Float64], middle_m: tuple[float, float], radius_m: float) -> FreeSpace:
    """Rasterize the rings of a drivable area around a place."""
    reach = radius_m + _BEYOND_M
    side = int(2.0 * reach / CELL_M) + 1
    origin = np.array(middle_m) - reach
    image = np.zeros((side, side), np.uint8)
    scaled = [np.round((ring - origin) / CELL_M * (1 << _SHIFT)).astype(np.int32) for ring in rings]
    if scaled:
        cv2.fillPoly(image, scaled, 1, cv2.LINE_8, _SHIFT)
    return FreeSpace(image.astype(np.bool_), origin)


def hiding_depth(agents: AgentImage) -> Float32:
    """Return the camera z (H, W) in front of which the street hides the agents; 0 or less where it never does."""
    own = np.where(agents.alpha > 0.0, agents.depth_m, 0.0)
    return ((own - TOLERANCE_M) / (1.0 + TOLERANCE_SHARE)).astype(np.float32)


def compose(
    rgb: UInt8,
    depth_m: Float32,
    covered: Float32,
    agents: AgentImage,
    lens: Float64,
    rotation: Float64,
    origin: Float64,
    free: FreeSpace,
) -> tuple[UInt8, Bool]:
    """Put agents into an image.

    Args:
        rgb: (H, W, 3) image of the empty street, with its shadows.
        depth_m: (H, W) camera z of the empty street; 0 or less: nothing is there.
        covered: (H, W) share of each pixel that the street before `hiding_depth` covers.
        agents: the agents in the same camera.
        lens: fx, fy, cx, cy of the camera.
        rotation: (3, 3) world_R_camera.
        origin: (3,) position of the camera in the world.
        free: where nothing fixed stands.

    Returns:
        The image, and (H, W) where it shows an agent.
    """
    limit = hiding_depth(agents)
    return _compose(
        rgb, depth_m, covered, agents.rgb, agents.alpha, limit, lens, rotation, origin, free.is_free, free.origin_m
    )


@njit(cache=True, nogil=True)
def _compose(
    rgb: UInt8,
    depth_m: Float32,
    covered: Float32,
    agent_rgb: UInt8,
    alpha: Float32,
    limit_m: Float32,
    lens: Float64,
    rotation: Float64,
    origin: Float64,
    is_free: Bool,
    free_origin: Float64,
) -> tuple[UInt8, Bool]:
    height, width = alpha.shape
    out, shown = rgb.copy(), np.zeros((height, width), np.bool_)
    for row in range(height):
        for column in range(width):
            share = alpha[row, column]
            if share <= 0.0:
                continue
            far = depth_m[row, column]
            if covered[row, column] > HIDDEN and far > NEAREST_M:
                if far >= limit_m[row, column]:
                    # Most of the pixel is covered before the agent; the mean depth lies behind it.
                    continue
                a, b = (column + 0.5 - lens[2]) / lens[0] * far, (row + 0.5 - lens[3]) / lens[1] * far
                x = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * far + origin[0]
                y = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * far + origin[1]
                i, j = int((y - free_origin[1]) / CELL_M), int((x - free_origin[0]) / CELL_M)
                if not (0 <= i < is_free.shape[0] and 0 <= j < is_free.shape[1] and is_free[i, j]):
                    continue
            shown[row, column] = share >= 0.5
            for channel in range(3):
                mixed = share * agent_rgb[row, column, channel] + (1.0 - share) * rgb[row, column, channel]
                out[row, column, channel] = np.uint8(min(mixed + 0.5, 255.0))
    return out, shown


@njit(cache=True, nogil=True)
def add_contact_shadows(
    rgb: UInt8, depth_m: Float32, lens: Float64, rotation: Float64, origin: Float64, boxes: Float64
) -> None:
    """Darken the ground under and around agents, where their bodies block the light of the sky.

    Args:
        rgb: (H, W, 3) image; modified.
        depth_m: (H, W) camera z of the street.
        lens: fx, fy, cx, cy of the camera.
        rotation: (3, 3) world_R_camera.
        origin: (3,) position of the camera in the world.
        boxes: (N, 6) x, y, z of the ground, yaw, half length and half width of the agents.
    """
    height, width = depth_m.shape
    for number in range(len(boxes)):
        x, y, z, yaw, half_length, half_width = boxes[number]
        if math.hypot(x - origin[0], y - origin[1]) > FARTHEST_M:
            continue
        cos, sin = math.cos(yaw), math.sin(yaw)
        left, top, right, bottom = shadow_bounds(
            x, y, z, cos, sin, half_length + REACH_M, half_width + REACH_M, lens, rotation, origin, width, height
        )
        for row in range(top, bottom):
            for column in range(left, right):
                far = depth_m[row, column]
                if far <= 0.0:
                    continue
                a = (column + 0.5 - lens[2]) / lens[0] * far
                b = (row + 0.5 - lens[3]) / lens[1] * far
                dx = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * far + origin[0] - x
                dy = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * far + origin[1] - y
                dz = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * far + origin[2] - z
                along = max(abs(cos * dx + sin * dy) - half_length + 0.1, 0.0)
                aside = max(abs(cos * dy - sin * dx) - half_width + 0.1, 0.0)
                beyond = math.hypot(along, aside)
                if abs(dz) > HEIGHT_M or beyond > REACH_M:
                    continue
                light = 1.0 - SHADE * math.exp(-beyond / FADE_M) * (1.0 - abs(dz) / HEIGHT_M)
                for channel in range(3):
                    rgb[row, column, channel] = np.uint8(rgb[row, column, channel] * light)


@njit(cache=True, nogil=True)
def shadow_bounds(
    x: float,
    y: float,
    z: float,
    cos: float,
    sin: float,
    along: float,
    aside: float,
    lens: Float64,
    rotation: Float64,
    origin: Float64,
    width: int,
    height: int,
) -> tuple[int, int, int, int]:
    """Return the pixels (left, top, right, bottom) of a box over a rectangle on the ground.

    They are those of the part of it that is before the camera.

    Args:
        x: place of the rectangle in the world.
        y: the same.
        z: the same.
        cos: cosine of its yaw.
        sin: sine of its yaw.
        along: half its length.
        aside: half its width.
        lens: fx, fy, cx, cy of the camera.
        rotation: (3, 3) world_R_camera.
        origin: (3,) position of the camera in the world.
        width: width of the image.
        height: height of the image.
    """
    corners = np.empty((8, 3))
    for corner in range(8):
        u = along if corner & 1 else -along
        v = aside if corner & 2 else -aside
        dx, dy = x + cos * u - sin * v - origin[0], y + sin * u + cos * v - origin[1]
        dz = z + (HEIGHT_M if corner & 4 else -HEIGHT_M) - origin[2]
        for axis in range(3):
            corners[corner, axis] = rotation[0, axis] * dx + rotation[1, axis] * dy + rotation[2, axis] * dz
    left, top, right, bottom = math.inf, math.inf, -math.inf, -math.inf
    for corner in range(8):
        for bit in (0, 1, 2, 4):
            other = corner | bit
            a, b, depth = corners[corner, 0], corners[corner, 1], corners[corner, 2]
            far = corners[other, 2]
            if bit and (depth < _NEAR_M) != (far < _NEAR_M):
                # The edge ends at the near plane.
                share = (_NEAR_M - depth) / (far - depth)
                a, b = a + share * (corners[other, 0] - a), b + share * (corners[other, 1] - b)
                depth = _NEAR_M
            elif bit or depth < _NEAR_M:
                continue
            column, row = lens[0] * a / depth + lens[2], lens[1] * b / depth + lens[3]
            left, right = min(left, column), max(right, column)
            top, bottom = min(top, row), max(bottom, row)
    if left > right:
        return 0, 0, 0, 0
    # Far beyond the image a coordinate may not fit an integer.
    return (
        int(min(max(left, 0.0), width)),
        int(min(max(top, 0.0), height)),
        int(min(max(right + 2.0, 0.0), width)),
        int(min(max(bottom + 2.0, 0.0), height)),
    )
