"""Views at the mountings of another layer of calibrations, in the raster that the protocol requests.

A submission is compared with images in the raster that the recorded lenses give. A method that was trained with refined
calibrations renders each view from where the refined calibration has the camera, and through the lens that the refined
calibration gives to the pixels of that raster.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from mirror.dataset.dataset import Dataset
from mirror.dataset.traversal import CameraCalibration
from mirror.geometry.cameras import Camera
from mirror.protocols.views.view import RenderView

_GRID: Final = (24, 14)


def recalibrate_views(dataset: Dataset, views: Sequence[RenderView], layer: str) -> tuple[RenderView, ...]:
    """Move views to the mountings and lenses of a layer of calibrations.

    Args:
        dataset: the dataset with the calibrations that the views were planned with.
        views: views of recorded images.
        layer: ``recorded`` or ``source@version``. Views of traversals without this layer stay as they are.

    Returns:
        The views in their order, with the same paths and rasters.

    Raises:
        UsageError: no traversal of the dataset has the layer.
        DatasetError: a calibration of an image is missing.
    """
    if layer == dataset.layers.calibrations:
        return tuple(views)
    other = dataset.with_layers(calibrations=layer)
    table = dataset.table("traversals", ["traversal_id", "layers"]).to_pylist()
    has_layer = {
        row["traversal_id"] for row in table if layer == "recorded" or f"calibrations/{layer}" in row["layers"]
    }
    planned = _calibrations(dataset, views, has_layer)
    wanted = _calibrations(other, views, has_layer)
    return tuple(_move(view, planned[view.path], wanted[view.path]) if view.path in wanted else view for view in views)


def lens_in_raster(final: Camera, planned: Camera, wanted: Camera) -> Camera:
    """Return the lens of a raster's pixels under another calibration of the camera.

    Args:
        final: lens of the raster, made from ``planned``: that camera, scaled, or an undistorted pinhole.
        planned: the camera as calibrated.
        wanted: the same camera as calibrated otherwise, with pixels of the same recorded images.

    Returns:
        A lens of the raster of ``final``. For a scaled camera it is exact. For an undistorted one it is the pinhole
        with the least squared distances in pixels, which leaves a small change of the distortion.
    """
    if (final.model, final.distortion) == (planned.model, planned.distortion):
        return wanted.resized(final.width_px, final.height_px)
    across, down = ((np.arange(count) + 0.5) / count for count in _GRID)
    u, v = np.meshgrid(across * final.width_px, down * final.height_px)
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    recorded = planned.project(final.unproject(pixels).direction)
    rays = wanted.unproject(recorded.uv_px[recorded.valid]).direction
    seen = pixels[recorded.valid]
    (fx, cx), (fy, cy) = (np.polyfit(rays[:, axis] / rays[:, 2], seen[:, axis], 1).tolist() for axis in (0, 1))
    return Camera("pinhole", final.width_px, final.height_px, fx, fy, cx, cy)


def _calibrations(dataset: Dataset, views: Sequence[RenderView], traversals: set[str]) -> dict[str, CameraCalibration]:
    """The calibration of each view of some traversals, by path."""
    found = {}
    for traversal in sorted({view.traversal_id for view in views} & traversals):
        frames = {frame.frame_index: frame for frame in dataset.where(traversal=traversal).frames()}
        for view in views:
            if view.traversal_id == traversal:
                found[view.path] = frames[view.frame_index].images[view.camera].calibration
    return found


def _move(view: RenderView, planned: CameraCalibration, wanted: CameraCalibration) -> RenderView:
    lens = lens_in_raster(view.lens, planned.model, wanted.model)
    moved = planned.ego_SE3_camera.inverse() @ wanted.ego_SE3_camera
    shutter = view.shutter
    if shutter is not None:
        ends = {name: getattr(shutter, name) @ moved for name in ("world_SE3_first", "world_SE3_last")}
        shutter = shutter.model_copy(update=ends)
    return view.model_copy(
        update={
            "world_SE3_camera": view.pose @ moved,
            "shutter": shutter,
            **{name: getattr(lens, name) for name in ("model", "distortion", "fx_px", "fy_px", "cx_px", "cy_px")},
        }
    )
