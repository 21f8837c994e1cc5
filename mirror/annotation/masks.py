"""Masks of road users, as a layer for reconstruction and scoring: instance masks where given, else hulls of boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mirror.annotation.box_layer import choose_box_layer
from mirror.annotation.tracking.options import group_of
from mirror.arrays import Bool, Float64, UInt8
from mirror.dataset.dataset import Dataset
from mirror.dataset.derived_layer import DerivedLayer, find_missing
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image, Mask
from mirror.dataset.layer_writer import require_layer_name
from mirror.dataset.layout import Layout, manifest_sha256, read_manifest
from mirror.dataset.traversal import FrameBoxes
from mirror.dataset.writing import writing_layers
from mirror.errors import DatasetError, UsageError
from mirror.geometry.box_projection import convex_hull, project_boxes
from mirror.geometry.boxes import edge_points
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.hashing import hash_document
from mirror.schema.tables import BOXES, MASKS

_SHIFT = 4
_FARTHEST_PX = 30_000.0
_DESCRIBED = "the same boxes, options, poses, calibrations and recorded images"


@dataclass(frozen=True)
class MaskOptions:
    """Settings of the masks that are made of boxes.

    Attributes:
        margin: growth of each box's length, width and height, as a share, for boxes that are not exact.
        min_score: boxes with a lower score are left out; labels without a score count.

    Raises:
        UsageError: a number is out of range.
    """

    margin: float = 0.1
    min_score: float = 0.3

    def __post_init__(self) -> None:
        if not 0.0 <= self.margin <= 2.0:
            raise UsageError(f"{self.margin}", place="margin", expected="a share from 0 to 2")
        if not 0.0 <= self.min_score <= 1.0:
            raise UsageError(f"{self.min_score}", place="min_score", expected="a number from 0 to 1")


@dataclass(frozen=True)
class MaskReport:
    """The counts of written masks.

    Attributes:
        layer: ``source@version`` of the masks.
        written: traversals whose layer was written.
        kept: traversals that had the layer already.
        images: masks written, one for each image.
        share: share of all their pixels that show a road user.
    """

    layer: str
    written: tuple[str, ...]
    kept: tuple[str, ...]
    images: int
    share: float


def draw_hulls(camera: Camera, camera_SE3_box: Poses, size_m: Float64) -> UInt8:
    """Draw the hulls of N boxes.

    Args:
        camera: the camera of the image.
        camera_SE3_box: N poses of boxes in the camera frame.
        size_m: (N, 3) length, width, height.

    Returns:
        (H, W): 255 where a box is, else 0.
    """
    mask = np.zeros((camera.height_px, camera.width_px), np.uint8)
    projected = project_boxes(camera, camera_SE3_box, size_m)
    for row in np.flatnonzero(projected.visible):
        _fill(mask, projected.hull(int(row)))
    return mask


def draw_rolling_hulls(image: Image, world_SE3_box: Poses, size_m: Float64, velocity_mps: Float64) -> UInt8:
    """Draw the hulls of N moving boxes where the rows of an image of a rolling shutter see them.

    Args:
        image: the image.
        world_SE3_box: N poses of boxes at mid-exposure.
        size_m: (N, 3) length, width, height.
        velocity_mps: (N, 3) velocities in the world frame; NaN counts as 0.

    Returns:
        (H, W): 255 where a box is, else 0.
    """
    camera = image.camera_model
    mask = np.zeros((camera.height_px, camera.width_px), np.uint8)
    for points, velocity in zip(edge_points(world_SE3_box, size_m), velocity_mps):
        _fill(mask, convex_hull(image.project_moving(points, velocity)))
    return mask


def _fill(mask: UInt8, hull: Float64) -> None:
    """Fill a hull (K, 2) in a mask; one of fewer than three corners has no area."""
    if len(hull) < 3:
        return
    # OpenCV has the centre of the first pixel at 0, and takes whole numbers of sixteenths.
    corners = np.clip(hull - 0.5, -_FARTHEST_PX, _FARTHEST_PX) * (1 << _SHIFT)
    cv2.fillConvexPoly(mask, np.round(corners).astype(np.int32), 255, cv2.LINE_8, _SHIFT)


def mask_layer(
    dataset: Dataset,
    layer: str | None = None,
    options: MaskOptions | None = None,
    *,
    version: str | None = None,
    progress: ProgressReporter | None = None,
) -> MaskReport:
    """Write masks of kind ``dynamic`` for all images, which mark the boxes of road users.

    An image with a mask of kind ``instance`` gets its non-zero pixels in place of hulls.

    Boxes with a velocity are moved to the time of each image. Parked vehicles are masked too, as other vehicles stand
    there in other traversals; barriers and cones are not. The layer is ``<source>-hulls@<version>``.

    Args:
        dataset: a local dataset, or a view of whole traversals of it.
        layer: layer of boxes, ``source@version``; None: the only one.
        options: see `MaskOptions`.
        version: version of the masks; None: that of the boxes.
        progress: receives the number of frames.

    Raises:
        UsageError: there is no such layer of boxes, or there are several and none is named.
        DatasetError: masks of this name were made with other options, of other boxes or of other recorded images.
    """
    options, progress = options or MaskOptions(), progress or NullProgress()
    layer = choose_box_layer(dataset, layer)
    source, _, own_version = layer.partition("@")
    new_source, version = f"{source}-hulls", version or own_version
    require_layer_name(new_source, version)
    chosen = dataset.layers
    digest = hash_document(["instances", options.margin, options.min_score, chosen.poses, chosen.calibrations])
    layout = dataset.layout
    written = []
    images, share = 0, 0.0
    with writing_layers(layout):
        view = dataset.with_layers(boxes=layer)
        having = [name for name in view.traversals() if _boxes_manifest(layout, name, layer)]
        inputs = {
            name: {"hulls": digest, layer: manifest_sha256(layout.layer(name, BOXES.name, source, own_version))}
            for name in having
        }
        layers = {
            name: DerivedLayer(layout, name, MASKS.name, new_source, version, inputs[name], _DESCRIBED)
            for name in having
        }
        pending, kept = find_missing(layers.values())
        progress.start("masks, frames", sum(len(view.where(traversal=name).frames()) for name in pending))
        for name in pending:
            writer = layers[name].open()
            rows = []
            for frame in view.where(traversal=name).frames():
                for camera, mask in frame_masks(frame, options).items():
                    stamp = frame.images[camera].timestamp_ns
                    encoded = cv2.imencode(".png", mask)[1].tobytes()
                    file = writer.file(f"{camera}/{stamp}.png", encoded)
                    rows.append({"camera": camera, "timestamp_ns": stamp, "kind": "dynamic", **file})
                    images += 1
                    share += float((mask > 0).mean())
                progress.advance(1)
            rows.sort(key=lambda row: tuple(row[key] for key in MASKS.sorted_by))
            writer.finish(MASKS, rows)
            written.append(name)
    return MaskReport(f"{new_source}@{version}", tuple(written), tuple(kept), images, share / images if images else 0.0)


def frame_masks(frame: Frame, options: MaskOptions) -> dict[str, UInt8]:
    """Return the masks (H, W) of a frame's images, by camera; images without boxes have a mask too.

    Raises:
        DatasetError: an instance mask is missing, broken, or of another size than its image.
    """
    boxes = frame.boxes("world")
    chosen = _road_users(boxes, options)
    masks = {}
    for camera, image in frame.images.items():
        instances = [mask for mask in image.masks() if mask.kind == "instance"]
        if instances:
            masks[camera] = _join_instances(instances, image)
            continue
        seconds = (image.timestamp_ns - boxes.timestamp_ns) * 1e-9
        centre = boxes.pose.translation[chosen] + seconds * np.nan_to_num(boxes.velocity_mps[chosen])
        pose = Poses.unchecked(boxes.pose.rotation[chosen], centre)
        size = boxes.size_m[chosen] * (1.0 + options.margin)
        if len(pose) and image.shutter.is_rolling:
            masks[camera] = draw_rolling_hulls(image, pose, size, boxes.velocity_mps[chosen])
            continue
        camera_SE3_box = image.world_SE3_camera.inverse() @ pose if len(pose) else pose
        masks[camera] = draw_hulls(image.camera_model, camera_SE3_box, size)
    return masks


def _join_instances(instances: Sequence[Mask], image: Image) -> UInt8:
    joined = np.zeros((image.height_px, image.width_px), np.uint8)
    for mask in instances:
        pixels = mask.decode()
        if pixels.shape != joined.shape:
            raise DatasetError(
                f"an instance mask of {pixels.shape[1]} x {pixels.shape[0]} px", file=mask.uri,
                expected=f"{image.width_px} x {image.height_px} px, as its image",
            )  # fmt: skip
        joined[pixels > 0] = 255
    return joined


def _road_users(boxes: FrameBoxes, options: MaskOptions) -> Bool:
    moving = np.array([group_of(name) != "static" for name in boxes.category], np.bool_)
    return np.asarray(moving & (np.isnan(boxes.score) | (boxes.score >= options.min_score)))


def _boxes_manifest(layout: Layout, traversal_id: str, layer: str) -> bool:
    source, _, version = layer.partition("@")
    return read_manifest(layout.layer(traversal_id, BOXES.name, source, version)) is not None
