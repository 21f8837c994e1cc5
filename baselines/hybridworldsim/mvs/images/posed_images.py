"""The images of a split with their poses and rasters; an image is opened when it is needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from hybridworldsim.kept_items import KeptItems
from hybridworldsim.mvs.estimator import StereoImage
from hybridworldsim.stationary import STATIONARY_M, select_moving
from mirror.arrays import Bool
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image
from mirror.errors import DatasetError
from mirror.geometry.box_projection import project_boxes
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses
from mirror.methods.training_images import ImageKey
from mirror.metrics.boxes.raster import polygon_mask
from mirror.protocols.document import Pixels
from mirror.protocols.truth.raster import cached_raster

_MAX_CACHED: Final = 256


@dataclass(frozen=True, eq=False)
class PosedImage:
    """One image to be matched.

    Attributes:
        scene_id: scene of the image.
        traversal_id: traversal of the image.
        light: light of the traversal: day, dusk or night.
        frame: frame of the image.
        image: the recorded image.
        lens: the pinhole of the undistorted raster.
        world_SE3_camera: pose of the camera.
    """

    scene_id: str
    traversal_id: str
    light: str
    frame: Frame
    image: Image
    lens: Camera
    world_SE3_camera: Poses


def list_posed_images(
    dataset: Dataset, pixels: Pixels, withheld: Set[ImageKey] = frozenset(), stationary_m: float = STATIONARY_M
) -> list[PosedImage]:
    """List the images of a dataset view by traversal, camera and time, except images of a standing vehicle.

    Images from one position would confirm each other's errors.

    Args:
        dataset: the view.
        pixels: the raster in which images are matched.
        withheld: images that are left out.
        stationary_m: see `hybridworldsim.stationary.select_moving`.

    Raises:
        DatasetError: the view has no images, or poses or calibrations are missing.
    """
    light: Mapping[str, str] = dict(
        zip(*(column.to_pylist() for column in dataset.table("traversals", ["traversal_id", "light"]).columns))
    )
    images = [
        PosedImage(
            frame.scene_id,
            frame.traversal_id,
            light[frame.traversal_id],
            frame,
            image,
            cached_raster(image.camera_model, pixels).final,
            image.world_SE3_camera,
        )
        for frame in dataset.frames()
        for image in frame.images.values()
        if (frame.traversal_id, image.camera, image.timestamp_ns) not in withheld
    ]
    if not images:
        raise DatasetError(
            "there are no images to match", file=dataset.root, expected="training traversals with images"
        )
    images.sort(key=lambda posed: (posed.scene_id, posed.traversal_id, posed.image.camera, posed.image.timestamp_ns))
    positions = (((posed.traversal_id, posed.image.camera), posed.world_SE3_camera.translation[0]) for posed in images)
    return [images[row] for row in select_moving(positions, stationary_m)]


class StereoImageCache:
    """A cache that decodes images to `StereoImage` on access, and keeps the most recently used ones.

    Args:
        images: the images.
        pixels: the raster to decode to.
    """

    def __init__(self, images: Sequence[PosedImage], pixels: Pixels) -> None:
        self._images, self._pixels = images, pixels
        self._cache: KeptItems[int, StereoImage] = KeptItems(_MAX_CACHED)

    def __getitem__(self, index: int) -> StereoImage:
        """Decode one image.

        Raises:
            DatasetError: the image, or one of its masks, is missing or broken.
        """
        return self._cache.get(index, lambda: self._decode(self._images[index]), lambda image: 1)

    def _decode(self, posed: PosedImage) -> StereoImage:
        rgb = cached_raster(posed.image.camera_model, self._pixels).to_final(posed.image.decode())
        return StereoImage(
            rgb, posed.lens.intrinsic_matrix(), posed.world_SE3_camera, find_static_pixels(posed, self._pixels)
        )


def find_static_pixels(posed: PosedImage, pixels: Pixels) -> Bool:
    """Find the pixels (H, W) that show the static scene: inside the lens, without the own vehicle and road users.

    Redacted pixels, and those of masks of kind ``ego``, are left out. Road users come from masks of kind ``dynamic`` if
    the image has such masks, else from the boxes of its frame. An image with neither counts as static.
    """
    raster = cached_raster(posed.image.camera_model, pixels)
    excluded = raster.outside_lens.copy()
    vehicle = posed.image.static_mask()
    if vehicle is not None:
        excluded |= raster.exclude(vehicle > 0)
    masks = [mask for mask in posed.image.masks() if mask.kind in ("ego", "dynamic", "redaction")]
    for mask in masks:
        excluded |= raster.exclude(mask.decode() > 0)
    if not any(mask.kind == "dynamic" for mask in masks):
        excluded |= _rasterize_boxes(posed)
    return ~excluded


def _rasterize_boxes(posed: PosedImage) -> Bool:
    """Rasterize the hulls of the frame's boxes, with a margin of one pixel for the error of the boxes."""
    excluded = np.zeros((posed.lens.height_px, posed.lens.width_px), np.bool_)
    boxes = posed.frame.boxes("world")
    if not len(boxes):
        return excluded
    projected = project_boxes(posed.lens, posed.world_SE3_camera.inverse() @ boxes.pose, boxes.size_m)
    for row in np.flatnonzero(projected.visible).tolist():
        excluded |= polygon_mask(projected.hull(row), posed.lens.width_px, posed.lens.height_px)
    return np.asarray(cv2.dilate(excluded.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)
