"""The part of a dataset that an export writes: images with poses and lenses, points, and the roles of a split."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any, Final

import numpy as np

from mirror.arrays import Bool, Float64, UInt8
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image
from mirror.dataset.points import Points
from mirror.dataset.raster import ImageRaster, image_raster
from mirror.dataset.redaction import REDACTION
from mirror.errors import DatasetError, UsageError
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses

MASKED: Final = frozenset({"dynamic", "ego", "redaction"})
"""Kinds of masks whose pixels do not show the static street as it is."""


@dataclass(frozen=True, eq=False)
class ExportImage:
    """One image of an export.

    Attributes:
        image: the dataset's image.
        frame: its frame.
        raster: from the recorded to the exported raster.
        drive_id: the drive.
        role: role of its traversal in the split; None: no split was chosen, or the traversal has no role.
        sequence: number of its traversal and camera, among those of the export.
        number: number of the image in that sequence, in order of frames.
    """

    image: Image
    frame: Frame
    raster: ImageRaster
    drive_id: str
    role: str | None
    sequence: int
    number: int

    @property
    def lens(self) -> Camera:
        """The camera of the exported raster."""
        return self.raster.final

    @property
    def is_resampled(self) -> bool:
        """Return whether the exported pixels are resampled from the recorded ones."""
        return self.raster.final != self.raster.recorded

    @property
    def suffix(self) -> str:
        """Ending of the exported file: JPEG files stay JPEG files, frames of videos become PNG files."""
        return ".jpg" if self.image.codec == "jpeg" else ".png"

    @property
    def name(self) -> str:
        """Path of the file below the folder of images: ``traversal/camera/timestamp_ns.jpg``."""
        return f"{self.frame.traversal_id}/{self.image.camera}/{self.image.timestamp_ns}{self.suffix}"

    @cached_property
    def world_SE3_camera(self) -> Poses:  # noqa: N802
        """The camera's pose at mid-exposure, one pose."""
        return self.image.world_SE3_camera

    def valid_pixels(self) -> UInt8 | None:
        """Return the mask (H, W) of the exported raster: 255 where it shows the static street; None if all of it does.

        Road users, the recording vehicle, replaced faces and plates, and pixels outside of the lens's range are 0.
        """
        hidden: Bool | None = None
        masks = [mask.decode() for mask in self.image.masks() if mask.kind in MASKED]
        static = self.image.static_mask()
        for mask in masks if static is None else [*masks, static]:
            shown = self.raster.mask(mask) != 0
            hidden = shown if hidden is None else hidden | shown
        if self.is_resampled:
            hidden = ~self.raster.covered if hidden is None else hidden | ~self.raster.covered
        return None if hidden is None else np.where(hidden, 0, 255).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class ExportScene:
    """The content of an export: one scene with its frames.

    Attributes:
        dataset: the view that is exported.
        scene: row of the scene in the table ``scenes``.
        traversals: rows of the traversals, by id.
        images: the images, ordered by traversal, frame and camera.
        points: points of the training traversals, or of all traversals without a split; None: there are none.
        split: name of the split; None: no split was chosen.
        withheld: number of images that the published dataset withholds, or that a redaction left out.
        without_frame: number of images that belong to no frame.
    """

    dataset: Dataset
    scene: Mapping[str, Any]
    traversals: Mapping[str, Mapping[str, Any]]
    images: tuple[ExportImage, ...]
    points: Points | None
    split: str | None
    withheld: int
    without_frame: int

    @property
    def origin_m(self) -> Float64:
        """(3,) origin, in the scene's world frame, of exports with float32 coordinates.

        World frames of geodetic scenes have their origin at the region's centre. Local metric frames may have theirs
        many kilometres away; the region's centre is subtracted there in float64.
        """
        if self.scene["frame"] is None:
            return np.zeros(3)
        return np.array([self.scene["x_m"], self.scene["y_m"], 0.0])

    def by_frame(self) -> Iterator[tuple[Frame, list[ExportImage]]]:
        """Yield each frame with its images."""
        for _, group in groupby(self.images, key=lambda item: (item.frame.traversal_id, item.frame.frame_index)):
            images = list(group)
            yield images[0].frame, images

    def by_traversal(self) -> Iterator[tuple[str, list[tuple[Frame, list[ExportImage]]]]]:
        """Yield each traversal with its frames and their images."""
        for traversal_id, group in groupby(self.by_frame(), key=lambda item: item[0].traversal_id):
            yield traversal_id, list(group)


def select_scene(dataset: Dataset, scene: str | None, split: str | None, *, undistort: bool) -> ExportScene:
    """Select the content of an export. No image is opened.

    Args:
        dataset: the view to export.
        scene: id of the scene; None: the only one.
        split: split whose roles are exported; traversals without a role are left out. None: all traversals.
        undistort: resample the images of distorted lenses to pinhole cameras.

    Raises:
        UsageError: the view has several scenes and none was chosen, or there are several layers of points.
        DatasetError: the view has no image, or an image's raster differs from that of its calibration.
    """
    scenes = dataset.scenes()
    if scene is None and len(scenes) != 1:
        raise UsageError(
            f"the dataset has {len(scenes)} scenes: {', '.join(scenes[:8])}", file=dataset.root, place="--scene",
            expected="one scene; each has its own world frame", remedy="choose one with --scene",
        )  # fmt: skip
    view = dataset.where(scene=scene or scenes[0])
    if split is not None:
        view = view.where(split=split)
    roles = _roles(view, split)
    rows = {row["traversal_id"]: row for row in view.table("traversals").to_pylist()}
    prefix = f"{REDACTION}/"
    redacted = {
        key: f"traversals/{key}/layers/{prefix}"
        for key, row in rows.items()
        if any(name.startswith(prefix) for name in row["layers"])
    }
    images: list[ExportImage] = []
    sequences: dict[tuple[str, str], list[int]] = {}
    left_out = 0
    for frame in view.frames():
        for image in frame.images.values():
            own = redacted.get(frame.traversal_id)
            if image.is_withheld or (own is not None and not image.uri.startswith(own)):
                left_out += 1
                continue
            raster = image_raster(_lens_of(image), undistort, None)
            drive, role = rows[frame.traversal_id]["drive_id"], roles.get(frame.traversal_id)
            place = sequences.setdefault((frame.traversal_id, image.camera), [len(sequences), 0])
            images.append(ExportImage(image, frame, raster, drive, role, *place))
            place[1] += 1
    if not images:
        raise DatasetError(
            f"there is no image to export ({left_out} are withheld)" if left_out else "there is no image to export",
            file=dataset.root, place=f"scene {view.scenes()[0] if view.scenes() else scene}",
            expected="a view with images",
        )  # fmt: skip
    listed = view.count("images")
    return ExportScene(
        view, view.table("scenes").to_pylist()[0], rows, tuple(images), _points(view, split), split, left_out,
        listed - len(images) - left_out,
    )  # fmt: skip


def _lens_of(image: Image) -> Camera:
    camera = image.camera_model
    if (camera.width_px, camera.height_px) != (image.width_px, image.height_px):
        raise DatasetError(
            f"the image has {image.width_px} x {image.height_px} px, but its calibration is for {camera.width_px} x"
            f" {camera.height_px} px",
            place=f"camera {image.camera}, timestamp_ns {image.timestamp_ns}",
            expected="a calibration of the recorded raster",
            remedy="correct the calibration of the recording and ingest it again",
        )
    return camera


def _roles(view: Dataset, split: str | None) -> dict[str, str]:
    if split is None:
        return {}
    return {key: role for role in view.roles(split) for key in view.where(split=split, role=role).traversals()}


def _points(view: Dataset, split: str | None) -> Points | None:
    """Points; with a split only those of training traversals, which no held-out image has contributed to."""
    if split is not None:
        if "train" not in view.roles(split):
            return None
        view = view.where(split=split, role="train")
    points = view.points()
    return points if len(points) else None
