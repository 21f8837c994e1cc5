"""Draws boxes of road users: edges in the colour of the class, marks of the front, and the depth of the solid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numba
import numpy as np

from hybridworldsim.generation.clips.clip import CATEGORIES
from hybridworldsim.generation.layout.lines import NEAR_M, draw_lines, require_pinhole
from mirror.arrays import Float32, Float64, Int64
from mirror.errors import UsageError
from mirror.geometry.boxes import CORNER_SIGNS, EDGES

_COLOURS: Final = {
    "car": (0, 0, 255),
    "van": (0, 0, 255),
    "truck": (255, 255, 0),
    "bus": (128, 0, 255),
    "motorcycle": (0, 255, 128),
    "cyclist": (128, 255, 0),
    "pedestrian": (255, 0, 0),
}
COLOURS: Final = np.array([_COLOURS[category] for category in CATEGORIES]) / 255.0
"""(C, 3) colours of the classes, those that OpenDWM's weights were trained with."""

_FRONT_CROSS: Final = ((0, 2), (1, 3))
_OPENDWM_MARKS: Final = ((3, 4), (3, 1))


@dataclass(frozen=True)
class BoxStyle:
    """The style in which boxes are drawn.

    Attributes:
        marks: lines besides the twelve edges, as pairs of corners in the order of `mirror.geometry.boxes.corners`.
        width_px: width of lines.
        depth: whether a fourth channel holds the inverse depth of the solid.
        depth_m: depth that is 1 in this channel; the value at depth z is ``min(depth_m / z, 1)``.
        dropped: value of the channels of what is not known or left out: of a map, and of a layout without guidance.
    """

    marks: tuple[tuple[int, int], ...]
    width_px: float
    depth: bool
    depth_m: float = 4.0
    dropped: float = 0.0

    @property
    def channels(self) -> int:
        """Number of channels of the images of boxes; a layout with a map has `MAP_CHANNELS` more."""
        return 4 if self.depth else 3


OWN_STYLE: Final = BoxStyle(_FRONT_CROSS, width_px=1.0, depth=True)
"""Both diagonals of the front face, and the depth: for networks that are trained here."""

OPENDWM_STYLE: Final = BoxStyle(_OPENDWM_MARKS, width_px=2.0, depth=False, dropped=0.1255)
"""One diagonal of the front face and one of the left face. OpenDWM draws lines 8 pixels wide in images of 1,600; its
configuration states the value of what is left out."""


def draw_boxes(
    camera_SE3_box: Float64,
    lwh_m: Float64,
    category: Int64,
    intrinsics: Float64,
    size_px: tuple[int, int],
    style: BoxStyle,
) -> Float32:
    """Draw boxes, nearer boxes over farther boxes, by the depth of their centres.

    Args:
        camera_SE3_box: (N, 4, 4) poses.
        lwh_m: (N, 3) length, width, height.
        category: (N,) numbers of classes in `CATEGORIES`.
        intrinsics: (3, 3) of the pinhole camera, pixels.
        size_px: height and width of the image.
        style: what is drawn.

    Returns:
        (channels, height, width) from 0 to 1.

    Raises:
        UsageError: a box is not finite or has no size; its row is named.
    """
    good = np.isfinite(camera_SE3_box).all(axis=(1, 2)) & np.isfinite(lwh_m).all(axis=1) & (lwh_m > 0.0).all(axis=1)
    if not good.all():
        raise UsageError(
            "a box that is not finite or has no size", place=f"box {int(np.argmin(good))}",
            expected="a finite pose, and sizes above 0 m",
        )  # fmt: skip
    order = np.argsort(-camera_SE3_box[:, 2, 3], kind="stable")
    poses, sizes, category = camera_SE3_box[order], lwh_m[order], category[order]
    corners = np.einsum("nij,nkj->nki", poses[:, :3, :3], 0.5 * sizes[:, None] * CORNER_SIGNS) + poses[:, None, :3, 3]
    lines = np.concatenate([EDGES, np.array(style.marks, np.int64).reshape(-1, 2)])
    segments = corners[:, lines].reshape(-1, 2, 3)
    colours = np.repeat(COLOURS[category], len(lines), axis=0)
    image = draw_lines(segments, colours, intrinsics, size_px, style.width_px)
    if not style.depth:
        return image
    return np.concatenate([image, draw_inverse_depth(poses, sizes, intrinsics, size_px, style.depth_m)[None]])


def draw_inverse_depth(
    camera_SE3_box: Float64,
    lwh_m: Float64,
    intrinsics: Float64,
    size_px: tuple[int, int],
    depth_m: float,
) -> Float32:
    """Return the inverse depth of the nearest solid box in each pixel.

    Args:
        camera_SE3_box: (N, 4, 4) poses.
        lwh_m: (N, 3) length, width, height.
        intrinsics: (3, 3) of the pinhole camera, pixels.
        size_px: height and width of the image.
        depth_m: depth that is 1 in the image.

    Returns:
        (height, width): ``min(depth_m / z, 1)``, where the ray of the pixel's centre enters a box at depth z, or the
        near plane within it; 0 where it meets none.
    """
    require_pinhole(intrinsics)
    nearest = np.full(size_px, np.inf)
    lens = np.array([intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2]])
    _enter(nearest, np.ascontiguousarray(camera_SE3_box), 0.5 * np.ascontiguousarray(lwh_m), lens)
    return np.minimum(depth_m / nearest, 1.0).astype(np.float32)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _enter(nearest: Float64, poses: Float64, half: Float64, lens: Float64) -> None:
    height, width = nearest.shape
    fx, fy, cx, cy = lens
    origin, along = np.empty(3), np.empty(3)
    for box in range(len(poses)):
        turn, place = poses[box, :3, :3], poses[box, :3, 3]
        radius = np.sqrt(half[box, 0] ** 2 + half[box, 1] ** 2 + half[box, 2] ** 2)
        if place[2] + radius < NEAR_M:
            continue
        for axis in range(3):
            origin[axis] = -(turn[0, axis] * place[0] + turn[1, axis] * place[1] + turn[2, axis] * place[2])
        top, bottom, left, right = 0, height, 0, width
        if place[2] - radius > NEAR_M:
            # The sphere around the box lies in front: its shadow in the image is within these bounds.
            near = place[2] - radius
            far = place[2] + radius
            low, high = place[0] - radius, place[0] + radius
            left = max(int(fx * low / (near if low < 0.0 else far) + cx) - 1, 0)
            right = min(int(fx * high / (near if high > 0.0 else far) + cx) + 2, width)
            low, high = place[1] - radius, place[1] + radius
            top = max(int(fy * low / (near if low < 0.0 else far) + cy) - 1, 0)
            bottom = min(int(fy * high / (near if high > 0.0 else far) + cy) + 2, height)
        for row in range(top, bottom):
            for column in range(left, right):
                x, y = (column + 0.5 - cx) / fx, (row + 0.5 - cy) / fy
                for axis in range(3):
                    along[axis] = turn[0, axis] * x + turn[1, axis] * y + turn[2, axis]
                enter, leave = NEAR_M, np.inf
                for axis in range(3):
                    if along[axis] == 0.0:
                        if abs(origin[axis]) > half[box, axis]:
                            leave = -np.inf
                        continue
                    first = (-half[box, axis] - origin[axis]) / along[axis]
                    second = (half[box, axis] - origin[axis]) / along[axis]
                    enter, leave = max(enter, min(first, second)), min(leave, max(first, second))
                if enter <= leave and enter < nearest[row, column]:
                    nearest[row, column] = enter
