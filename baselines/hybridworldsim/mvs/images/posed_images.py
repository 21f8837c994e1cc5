"""The pictures of a split with their poses and rasters; none is opened before it is asked for."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

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
from mirror.methods.training_images import Picture
from mirror.metrics.boxes.raster import polygon_mask
from mirror.protocols.document import Pixels
from mirror.protocols.truth.raster import raster_of

_HELD: Final = 256


@dataclass(frozen=True, eq=False)
class PosedImage:
    """One picture to be matched.

    Attributes:
        scene_id: its scene.
        traversal_id: its traversal.
        light: of the traversal: day, dusk or night.
        frame: the frame it belongs to.
        image: the picture.
        lens: the pinhole of its undistorted raster.
        world_SE3_camera: its pose.
    """

    scene_id: str
    traversal_id: str
    light: str
    frame: Frame
    image: Image
    lens: Camera
    world_SE3_camera: Poses


def list_posed_images(
    dataset: Dataset, pixels: Pixels, withheld: Set[Picture] = frozenset(), stationary_m: float = STATIONARY_M
) -> list[PosedImage]:
    """The pictures of a view, in order of traversal, camera and time, but for those of a standing vehicle.

    What it sees again and again from one place would confirm its own errors.

    Args:
        dataset: the view.
        pixels: the raster in which they are matched.
        withheld: pictures that are left out.
        stationary_m: see `hybridworldsim.stationary.select_moving`.

    Raises:
        DatasetError: the view has none, or poses or calibrations are missing.
    """
    light: Mapping[str, str] = dict(
        zip(*(column.to_pylist() for column in dataset.table("traversals", ["traversal_id", "light"]).columns))
    )
    shots = [
        PosedImage(
            frame.scene_id,
            frame.traversal_id,
            light[frame.traversal_id],
            frame,
            image,
            raster_of(image.camera_model, pixels).final,
            image.world_SE3_camera,
        )
        for frame in dataset.frames()
        for image in frame.images.values()
        if (frame.traversal_id, image.camera, image.timestamp_ns) not in withheld
    ]
    if not shots:
        raise DatasetError(
            "there are no pictures to match", file=dataset.root, expected="training traversals with pictures"
        )
    shots.sort(key=lambda one: (one.scene_id, one.traversal_id, one.image.camera, one.image.timestamp_ns))
    taken = (((one.traversal_id, one.image.camera), one.world_SE3_camera.translation[0]) for one in shots)
    return [shots[position] for position in select_moving(taken, stationary_m)]


class StereoImageCache:
    """The shots as posed pictures, decoded when asked for; the last few are held.

    Args:
        shots: which.
        pixels: their raster.
    """

    def __init__(self, shots: Sequence[PosedImage], pixels: Pixels) -> None:
        self._shots, self._pixels = shots, pixels
        self._held: OrderedDict[int, StereoImage] = OrderedDict()

    def __getitem__(self, index: int) -> StereoImage:
        """One picture.

        Raises:
            DatasetError: it, or a mask of it, is missing or broken.
        """
        if index not in self._held:
            self._held[index] = self._posed(self._shots[index])
            if len(self._held) > _HELD:
                self._held.popitem(last=False)
        self._held.move_to_end(index)
        return self._held[index]

    def _posed(self, shot: PosedImage) -> StereoImage:
        rgb = raster_of(shot.image.camera_model, self._pixels).picture(shot.image.decode())
        return StereoImage(rgb, shot.lens.intrinsic_matrix(), shot.world_SE3_camera, static_pixels(shot, self._pixels))


def static_pixels(shot: PosedImage, pixels: Pixels) -> Bool:
    """(H, W) True where a picture shows the static scene: within the lens, and neither its vehicle nor a road user.

    Road users are taken from masks of kind ``dynamic`` where the picture has some, else from its frame's boxes; without
    either all that is seen is taken to stand still.
    """
    raster = raster_of(shot.image.camera_model, pixels)
    excluded = raster.unseen.copy()
    own = shot.image.static_mask()
    if own is not None:
        excluded |= raster.excluded(own > 0)
    masks = [mask for mask in shot.image.masks() if mask.kind in ("ego", "dynamic")]
    for mask in masks:
        excluded |= raster.excluded(mask.decode() > 0)
    if not any(mask.kind == "dynamic" for mask in masks):
        excluded |= _boxes(shot)
    return ~excluded


def _boxes(shot: PosedImage) -> Bool:
    """The hulls of the frame's boxes, and a pixel round them for what boxes are off by."""
    excluded = np.zeros((shot.lens.height_px, shot.lens.width_px), np.bool_)
    boxes = shot.frame.boxes("world")
    if not len(boxes):
        return excluded
    projected = project_boxes(shot.lens, shot.world_SE3_camera.inverse() @ boxes.pose, boxes.size_m)
    for row in np.flatnonzero(projected.visible).tolist():
        excluded |= polygon_mask(projected.hull(row), shot.lens.width_px, shot.lens.height_px)
    return np.asarray(cv2.dilate(excluded.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)
