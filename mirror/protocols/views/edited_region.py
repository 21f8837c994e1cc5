"""The region of a view's edits: the hulls of edited vehicles before and after, and the pixels in and around them."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.geometry.box_projection import project_boxes
from mirror.metrics.boxes.raster import polygon_mask
from mirror.protocols.views.view import Edit, RenderView

GROWTH: Final = 0.2
"""Share by which the hulls of an edited region are grown about their middle."""


def recorded_hull(view: RenderView, edit: Edit) -> Float64:
    """Return the convex hull (K, 2) of the projected recorded box, in pixels."""
    camera_SE3_box = view.pose.inverse() @ edit.world_SE3_box
    return project_boxes(view.lens, camera_SE3_box, [edit.size_m]).hull(0)


def target_hull(view: RenderView, edit: Edit) -> Float64:
    """Return the convex hull (K, 2) of the projected target box, in pixels; empty if the edit has no target."""
    if edit.world_SE3_target is None:
        return np.empty((0, 2))
    return project_boxes(view.lens, view.pose.inverse() @ edit.world_SE3_target, [edit.size_m]).hull(0)


def grow_hull(hull: Float64, growth: float) -> Float64:
    """Scale a hull (K, 2) about the middle of its bounds by ``1 + growth``."""
    if not len(hull):
        return hull
    middle = 0.5 * (hull.min(axis=0) + hull.max(axis=0))
    return np.asarray(middle + (1.0 + growth) * (hull - middle))


def grown_hulls(view: RenderView) -> tuple[Bool, Bool]:
    """Return the masks (H, W) of the pixels in the grown recorded and target hulls of a view's edited vehicles."""
    old, new = (np.zeros((view.height_px, view.width_px), np.bool_) for _ in range(2))
    for edit in view.edits:
        for mask, hull in ((old, recorded_hull(view, edit)), (new, target_hull(view, edit))):
            mask |= polygon_mask(grow_hull(hull, GROWTH), view.width_px, view.height_px)
    return old, new
