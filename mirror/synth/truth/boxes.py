"""The visibility of objects in an image: the visible share of each, and the bounds of its pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float64, Int32, Int64
from mirror.geometry import Poses, matrix_from_quaternion, project_boxes
from mirror.geometry.cameras import Camera
from mirror.portable import arrays
from mirror.synth.model import Model
from mirror.synth.truth.casting import NOTHING, cast_rays

_MOST_RAYS: Final = 6000


@dataclass(frozen=True, eq=False)
class PosedObject:
    """One object at an instant.

    Attributes:
        model: model of the object, in the world frame.
        world_SE3_box: one pose: that of the object's 3D box.
        size_m: length, width, height of the box, which encloses the model.
    """

    model: Model
    world_SE3_box: Poses
    size_m: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class ObjectVisibility:
    """The visibility of N objects in an image.

    Attributes:
        number: (N,) object numbers, ascending.
        pixels: (N,) number of pixels that show the object.
        visibility: (N,) number of visible pixels divided by the number without occluders; pixels outside the raster
            count in neither.
        bounds_px: (N, 4) ``u_min v_min u_max v_max`` of the visible pixels, in whole pixels; NaN without any.
    """

    number: Int64
    pixels: Int64
    visibility: Float64
    bounds_px: Float64

    def __len__(self) -> int:
        return len(self.number)


def measure_visibility(
    objects: Int32, camera: Camera, world_SE3_camera: Poses, posed_objects: Mapping[int, PosedObject]
) -> ObjectVisibility:
    """Measure the visibility of each object in an image.

    Args:
        objects: (H, W) number of the object at the centre of each pixel, below 0 where there is none.
        camera: camera of the image.
        world_SE3_camera: one pose of the camera.
        posed_objects: the objects, by number.

    Returns:
        The objects that would cover a pixel without occluders. The visibility of large objects is estimated on a
        regular grid of some thousands of pixels.
    """
    numbers = np.array(sorted(posed_objects), np.int64)
    counts, bounds = _extents(objects, numbers)
    if not len(numbers):
        return ObjectVisibility(numbers, counts, np.zeros(0), bounds)
    posed_list = [posed_objects[int(number)] for number in numbers]
    world_SE3_box = Poses(
        np.concatenate([posed.world_SE3_box.rotation for posed in posed_list]),
        np.concatenate([posed.world_SE3_box.translation for posed in posed_list]),
    )
    boxes = project_boxes(camera, world_SE3_camera.inverse() @ world_SE3_box, [posed.size_m for posed in posed_list])
    turn, origin = matrix_from_quaternion(world_SE3_camera.rotation)[0], world_SE3_camera.translation[0]
    shares = np.full(len(posed_list), np.nan)
    for row in np.flatnonzero(boxes.visible):
        columns, rows = _grid(boxes.bounds_px[row])
        u, v = np.meshgrid(columns, rows)
        rays = arrays.matmul(camera.unproject(np.stack([u, v], axis=-1) + 0.5).direction.reshape(-1, 3), turn.T)
        there = cast_rays(posed_list[row].model, origin, rays)[1] != NOTHING
        if there.any():
            shares[row] = (objects[v, u].ravel()[there] == numbers[row]).mean()
    # The renderer found a pixel of the object, but no ray of the grid hit it: the object counts as visible.
    shares = np.where(np.isnan(shares) & (counts > 0), 1.0, shares)
    known = ~np.isnan(shares)
    return ObjectVisibility(numbers[known], counts[known], shares[known], bounds[known])


def _grid(bounds_px: Float64) -> tuple[Int64, Int64]:
    """Columns and rows of pixels in a rectangle, thinned to a grid of at most about _MOST_RAYS pixels."""
    first, end = np.floor(bounds_px[:2]).astype(int), np.ceil(bounds_px[2:]).astype(int)
    step = max(int(np.ceil(np.sqrt((end - first).prod() / _MOST_RAYS))), 1)
    return np.arange(first[0], end[0], step), np.arange(first[1], end[1], step)


def _extents(objects: Int32, numbers: Int64) -> tuple[Int64, Float64]:
    """Counts (N,) and bounds (N, 4) of the pixels of each object number; the numbers (N,) are ascending."""
    counts, bounds = np.zeros(len(numbers), np.int64), np.full((len(numbers), 4), np.nan)
    rows, columns = np.nonzero(np.isin(objects, numbers))
    which = np.searchsorted(numbers, objects[rows, columns])
    order = np.argsort(which, kind="stable")
    which, rows, columns = which[order], rows[order], columns[order]
    indices, starts = np.unique(which, return_index=True)
    if len(indices):
        counts[indices] = np.diff([*starts, len(which)])
        ends = (np.minimum, columns), (np.minimum, rows), (np.maximum, columns), (np.maximum, rows)
        for place, (most, values) in enumerate(ends):
            bounds[indices, place] = most.reduceat(values, starts) + (place > 1)
    return counts, bounds
