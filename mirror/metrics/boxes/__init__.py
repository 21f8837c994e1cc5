"""Overlaps of boxes and masks: in the image, and in space."""

from __future__ import annotations

from mirror.metrics.boxes.iou_2d import HULL_VARIANTS, HullVariant, RegionIou, box_iou_2d, hull_iou, mask_iou
from mirror.metrics.boxes.iou_3d import box_iou_3d, box_iou_3d_matrix
from mirror.metrics.boxes.projected import clip_to_image, polygon_area, visible_share
from mirror.metrics.boxes.raster import polygon_mask

__all__ = [
    "HULL_VARIANTS",
    "HullVariant",
    "RegionIou",
    "box_iou_2d",
    "box_iou_3d",
    "box_iou_3d_matrix",
    "clip_to_image",
    "hull_iou",
    "mask_iou",
    "polygon_area",
    "polygon_mask",
    "visible_share",
]
