"""Boxes around the vehicle from above, frame by frame."""

from __future__ import annotations

import colorsys
from collections.abc import Iterator
from typing import Final

import cv2
import numpy as np

from mirror.arrays import Float64, UInt8
from mirror.dataset.dataset import Dataset
from mirror.dataset.traversal import FrameBoxes
from mirror.geometry.quaternions import matrix_from_quaternion
from mirror.view.images import CATEGORY_HUES

_BACKGROUND: Final = (250, 250, 248)
_RING: Final = (214, 214, 210)
_OTHER: Final = (150, 150, 150)
_EGO: Final = (40, 40, 40)
_EGO_M: Final = ((-1.0, -0.95), (3.8, 0.95))
_RINGS_M: Final = (10, 20, 30, 40, 50)
_SUBPIXEL: Final = 4
_GOLDEN: Final = 0.381966


def draw_from_above(
    dataset: Dataset, traversal_id: str, against: str | None = None, *, range_m: float = 40.0, size_px: int = 640
) -> Iterator[UInt8]:
    """Draw the boxes of each frame of a traversal, with the vehicle in the middle and its heading upwards.

    Args:
        dataset: a view with one chosen layer of boxes, which is drawn in the colours of the categories.
        traversal_id: the traversal.
        against: a second layer, ``source@version``, drawn in grey below the first; None: none.
        range_m: distance from the vehicle to the edge.
        size_px: width and height of an image.

    Yields:
        (size_px, size_px, 3) RGB.
    """
    view = dataset.where(traversal=traversal_id)
    others = view.with_layers(boxes=against).frames() if against is not None else [None] * len(view.frames())
    for frame, other in zip(view.frames(), others):
        canvas = np.empty((size_px, size_px, 3), np.uint8)
        canvas[:] = _BACKGROUND
        scale = 0.5 * size_px / range_m
        middle = size_px // 2
        for ring in _RINGS_M:
            cv2.circle(canvas, (middle, middle), round(ring * scale), _RING, 1, cv2.LINE_AA)
            if ring < range_m:
                place = (middle + 4, middle - round(ring * scale) - 3)
                cv2.putText(canvas, f"{ring} m", place, cv2.FONT_HERSHEY_SIMPLEX, 0.36, _OTHER, 1, cv2.LINE_AA)
        (rear, right), (front, left) = _EGO_M
        _polygon(
            canvas, np.array([(front, left), (front, right), (rear, right), (rear, left)]), scale, _EGO, filled=True
        )
        if other is not None:
            _draw(canvas, other.boxes(), scale, grey=True)
        boxes = frame.boxes()
        _draw(canvas, boxes, scale, grey=False)
        text = f"{traversal_id}  frame {frame.frame_index}  {len(boxes)} boxes"
        cv2.putText(canvas, text, (8, size_px - 10), cv2.FONT_HERSHEY_SIMPLEX, 0.42, _EGO, 1, cv2.LINE_AA)
        yield canvas


def _draw(canvas: UInt8, boxes: FrameBoxes, scale: float, *, grey: bool) -> None:
    turn = matrix_from_quaternion(boxes.pose.rotation)[:, :2, :2]
    for row in range(len(boxes)):
        half = 0.5 * boxes.size_m[row, :2]
        corners = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)]) * half
        centre = boxes.pose.translation[row, :2]
        colour = _OTHER if grey else _colour(boxes.category[row])
        _polygon(canvas, centre + corners @ turn[row].T, scale, colour)
        # A line from the middle to the front shows the heading.
        _polygon(canvas, np.stack((centre, centre + turn[row] @ (half[0], 0.0))), scale, colour)


def _polygon(
    canvas: UInt8, points_m: Float64, scale: float, colour: tuple[int, int, int], *, filled: bool = False
) -> None:
    """Draw a closed polygon (N, 2) of the ego frame: x is up, y to the left."""
    middle = 0.5 * canvas.shape[0]
    pixels = np.stack((middle - points_m[:, 1] * scale, middle - points_m[:, 0] * scale), axis=1)
    fixed = np.round(np.clip(pixels, -4e3, 4e3) * 2**_SUBPIXEL).astype(np.int32)[None]
    if filled:
        cv2.fillPoly(canvas, fixed, colour, cv2.LINE_AA, _SUBPIXEL)
    else:
        cv2.polylines(canvas, fixed, True, colour, 1, cv2.LINE_AA, _SUBPIXEL)


def _colour(category: str) -> tuple[int, int, int]:
    """One colour for each category, a golden angle of hue apart."""
    place = CATEGORY_HUES.index(category) if category in CATEGORY_HUES else len(CATEGORY_HUES) + len(category)
    red, green, blue = colorsys.hls_to_rgb(0.58 + _GOLDEN * place % 1.0, 0.40, 0.75)
    return round(255 * red), round(255 * green), round(255 * blue)
