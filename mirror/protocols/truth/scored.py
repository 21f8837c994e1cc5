"""Which pixels of a view are scored: not those of the vehicle itself, of road users, or outside the lens."""

from __future__ import annotations

import numpy as np

from mirror.arrays import Bool
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image
from mirror.errors import DatasetError
from mirror.geometry.box_projection import project_boxes
from mirror.metrics.boxes.raster import polygon_mask
from mirror.protocols.document import Masks, Protocol
from mirror.protocols.truth.raster import Raster, cached_raster
from mirror.protocols.views.plan import find_group
from mirror.protocols.views.view import RenderView


def compute_scored_mask(
    protocol: Protocol, view: RenderView, frame: Frame, image: Image, layers: tuple[str, ...]
) -> Bool:
    """The pixels that a protocol scores of a view.

    Args:
        protocol: says what is masked.
        view: the view.
        frame: its frame.
        image: its recorded picture.
        layers: of the traversal, as `Plan` has them.

    Returns:
        (H, W), True where pixels are scored.

    Raises:
        DatasetError: a mask is missing or broken, or there is nothing to mask road users by.
    """
    raster = cached_raster(image.camera_model, protocol.pixels)
    excluded = raster.outside_lens.copy()
    masks = protocol.masks
    kinds = [kind for kind, wanted in (("ego", masks.ego), ("sky", masks.sky)) if wanted]
    if masks.ego:
        own = image.static_mask()
        if own is not None:
            excluded |= raster.exclude(own > 0)
    moved = find_group(protocol, view.group).ego_shift_m != 0.0
    source = choose_dynamic_source(masks, layers, moved=moved, traversal_id=view.traversal_id)
    if source == "masks":
        kinds.append("dynamic")
    excluded |= _of_layers(raster, image, kinds)
    if source == "boxes":
        excluded |= _of_boxes(masks, view, frame)
    return ~excluded


def choose_dynamic_source(masks: Masks, layers: tuple[str, ...], *, moved: bool, traversal_id: str) -> str | None:
    """What a traversal's road users are masked by: ``masks``, ``boxes`` or nothing.

    Raises:
        DatasetError: they are to be masked, and there is nothing to do it by; masks do not fit moved cameras.
    """
    there = {layer.partition("/")[0] for layer in layers}
    for source in masks.dynamic:
        if source in there and not (moved and source == "masks"):
            return source
    if not masks.dynamic:
        return None
    raise DatasetError(
        f"traversal {traversal_id} has nothing to mask road users by",
        expected="a layer of boxes" if moved else f"a layer of {' or '.join(masks.dynamic)}",
        remedy="annotate it, or choose another protocol",
    )


def _of_layers(raster: Raster, image: Image, kinds: list[str]) -> Bool:
    excluded = np.zeros((raster.final.height_px, raster.final.width_px), np.bool_)
    for mask in image.masks() if kinds else ():
        if mask.kind in kinds:
            excluded |= raster.exclude(mask.decode() > 0)
    return excluded


def _of_boxes(masks: Masks, view: RenderView, frame: Frame) -> Bool:
    """Pixels whose centres the hulls of projected boxes hold."""
    boxes = frame.boxes("world")
    lens = view.lens
    excluded = np.zeros((lens.height_px, lens.width_px), np.bool_)
    if not len(boxes):
        return excluded
    projected = project_boxes(lens, view.pose.inverse() @ boxes.pose, boxes.size_m)
    for row in np.flatnonzero(projected.visible).tolist():
        if masks.categories is None or boxes.category[row] in masks.categories:
            excluded |= polygon_mask(projected.hull(row), lens.width_px, lens.height_px)
    return excluded
