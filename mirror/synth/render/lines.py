"""Images whose rows or columns are exposed one after the other: each line is a view of its own instant and pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mirror.arrays import Float32, Float64, Int32, UInt8
from mirror.synth.render.lens import Lens, cut_line
from mirror.synth.render.surroundings import Surroundings
from mirror.synth.render.view import rasterize_view
from mirror.synth.render.wet import blend_reflections, reflection_mask, render_mirrored


class LineInstant(NamedTuple):
    """The world and the camera while one line is exposed.

    Attributes:
        surroundings: the world.
        rotation: (3, 3) world_R_camera.
        origin: (3,) camera position, world metres.
    """

    surroundings: Surroundings
    rotation: Float64
    origin: Float64


@dataclass(frozen=True, eq=False)
class LinesView:
    """The truth of an image, line by line; the fields of `RasterizedView` that do not depend on one pose.

    Attributes:
        distance_m: (H, W) distances along the rays, metres; infinite for the sky.
        normal: (H, W, 3) unit normals in the world frame; 0 for the sky.
        camera_normal: (H, W, 3) unit normals in the camera frame at the line's time; 0 for the sky.
        label: (H, W) semantic classes.
        object: (H, W) numbers of the visible road users; NO_OBJECT elsewhere.
    """

    distance_m: Float32
    normal: Float32
    camera_normal: Float32
    label: UInt8
    object: Int32


def render_lines(
    lens: Lens, count: int, line_at: Callable[[int], LineInstant], *, columns: bool, wet: bool
) -> tuple[Float32, LinesView]:
    """Render each line of an image at its own instant.

    Args:
        lens: rays of the camera.
        count: number of lines.
        line_at: returns the instant of a row, or of a column.
        columns: whether lines are columns.
        wet: whether the ground mirrors.

    Returns:
        Radiance (H, W, 4), and the truth.
    """
    height, width = lens.rays.shape[:2]
    radiance = np.zeros((height, width, 4), np.float32)
    view = LinesView(
        np.empty((height, width), np.float32),
        np.empty((height, width, 3), np.float32),
        np.empty((height, width, 3), np.float32),
        np.empty((height, width), np.uint8),
        np.empty((height, width), np.int32),
    )
    for number in range(count):
        line = line_at(number)
        window, place = cut_line(lens, number, column=columns)
        seen = rasterize_view(line.surroundings, window, line.rotation, line.origin)
        to, at = ((slice(None), number), (slice(None), place)) if columns else ((number,), (place,))
        radiance[to] = seen.radiance()[at]
        view.distance_m[to], view.camera_normal[to] = seen.distance_m[at], seen.camera_normal[at]
        view.normal[to] = seen.normal[at]
        view.label[to], view.object[to] = seen.label[at], seen.object[at]
    if wet:
        mask = reflection_mask(radiance)
        mirrored = np.zeros_like(radiance)
        for number in range(count):
            to = (slice(None), number) if columns else (number,)
            if not mask[to].any():
                continue
            line = line_at(number)
            window, place = cut_line(lens, number, column=columns)
            at = (slice(None), place) if columns else (place,)
            here = np.zeros(window.rays.shape[:2], np.float32)
            here[at] = mask[to]
            mirrored[to] = render_mirrored(line.surroundings, window, line.rotation, line.origin, here)[at]
        radiance = blend_reflections(radiance, mirrored)
    return radiance, view
