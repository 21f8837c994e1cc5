"""The scored mask of a view: the ego vehicle, road users, redacted pixels and those outside the lens are excluded."""

from __future__ import annotations

import numpy as np

from mirror.arrays import Bool
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image
from mirror.dataset.redaction import REDACTION
from mirror.dataset.traversal import FrameBoxes
from mirror.errors import DatasetError
from mirror.geometry.box_projection import convex_hull, project_boxes
from mirror.metrics.boxes.raster import polygon_mask
from mirror.protocols.document import Masks, Protocol
from mirror.protocols.truth.raster import Raster, cached_raster
from mirror.protocols.views.plan import find_group
from mirror.protocols.views.rolling import rolling_hull_points
from mirror.protocols.views.view import RenderView


def compute_scored_mask(
    protocol: Protocol, view: RenderView, frame: Frame, image: Image, layers: tuple[str, ...]
) -> Bool:
    """Compute which pixels of a view are scored.

    Args:
        protocol: protocol with the mask settings.
        view: the view.
        frame: recorded frame of the view.
        image: recorded image of the view.
        layers: layers of the traversal, as in `Plan.layers`.

    Returns:
        (H, W) mask, True where pixels are scored.

    Raises:
        DatasetError: a mask is missing or damaged, or the traversal has neither masks nor boxes of road users.
    """
    raster = cached_raster(image.camera_model, protocol.pixels)
    excluded = raster.outside_lens.copy()
    masks = protocol.masks
    kinds = [kind for kind, is_masked in (("ego", masks.ego), ("sky", masks.sky)) if is_masked]
    if masks.ego:
        ego_mask = image.static_mask()
        if ego_mask is not None:
            excluded |= raster.exclude(ego_mask > 0)
    moved = find_group(protocol, view.group).ego_shift_m != 0.0
    if not moved:
        # What replaces a face or a number plate is no truth of the street.
        kinds.append(REDACTION)
    source = choose_dynamic_source(masks, layers, moved=moved, traversal_id=view.traversal_id)
    if source == "masks":
        kinds.append("dynamic")
    excluded |= _exclude_layers(raster, image, kinds)
    if source == "boxes":
        excluded |= _exclude_boxes(masks, view, frame)
    return ~excluded


def choose_dynamic_source(masks: Masks, layers: tuple[str, ...], *, moved: bool, traversal_id: str) -> str | None:
    """Choose the source of road users' pixels, ``masks`` or ``boxes``; None if road users are scored.

    Recorded masks do not fit moved cameras, so that moved views need boxes.

    Args:
        masks: mask settings of the protocol.
        layers: layers of the traversal.
        moved: whether the cameras are moved.
        traversal_id: traversal, for the error message.

    Raises:
        DatasetError: road users must be masked, but the traversal has no suitable layer.
    """
    kinds = {layer.partition("/")[0] for layer in layers}
    for source in masks.dynamic:
        if source in kinds and not (moved and source == "masks"):
            return source
    if not masks.dynamic:
        return None
    raise DatasetError(
        f"traversal {traversal_id} has no layer to mask road users with",
        expected="a layer of boxes" if moved else f"a layer of {' or '.join(masks.dynamic)}",
        remedy="annotate it, or give a --protocol with dynamic = [] under [masks]: `mirror protocols list`",
    )


def _exclude_layers(raster: Raster, image: Image, kinds: list[str]) -> Bool:
    excluded = np.zeros((raster.final.height_px, raster.final.width_px), np.bool_)
    for mask in image.masks() if kinds else ():
        if mask.kind in kinds:
            excluded |= raster.exclude(mask.decode() > 0)
    return excluded


def _exclude_boxes(masks: Masks, view: RenderView, frame: Frame) -> Bool:
    """(H, W) mask: True where a pixel's centre lies inside the hull of a projected box."""
    boxes = frame.boxes("world")
    lens = view.lens
    excluded = np.zeros((lens.height_px, lens.width_px), np.bool_)
    if not len(boxes):
        return excluded
    if view.shutter is not None:
        return _exclude_rolling_boxes(masks, view, boxes)
    projected = project_boxes(lens, view.pose.inverse() @ boxes.pose, boxes.size_m)
    for row in np.flatnonzero(projected.visible).tolist():
        if masks.categories is None or boxes.category[row] in masks.categories:
            excluded |= polygon_mask(projected.hull(row), lens.width_px, lens.height_px)
    return excluded


def _exclude_rolling_boxes(masks: Masks, view: RenderView, boxes: FrameBoxes) -> Bool:
    """(H, W) mask as `_exclude_boxes`, with each box where the rows see it."""
    excluded = np.zeros((view.height_px, view.width_px), np.bool_)
    for row in range(len(boxes)):
        if masks.categories is None or boxes.category[row] in masks.categories:
            points = rolling_hull_points(view, boxes.pose[row : row + 1], boxes.size_m[row], boxes.velocity_mps[row])
            excluded |= polygon_mask(convex_hull(points), view.width_px, view.height_px)
    return excluded
