"""The road users of a recorded frame: boxes at the frame's time, and the pixels that show them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hybridworldsim.generation.clips.clip import ABSENT
from hybridworldsim.generation.recorded.windows import MASK_KINDS
from hybridworldsim.generation.scenes.rig import SceneRig
from hybridworldsim.generation.scenes.scene_clip import CLASS_OF
from mirror.annotation.masks import draw_hulls
from mirror.arrays import AnyArray, Bool, Float64
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image
from mirror.dataset.raster import ImageRaster
from mirror.dataset.redaction import REDACTION
from mirror.dataset.traversal import FrameBoxes
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses

_GROWN = 1.25
"""Masks are larger than boxes (`mirror annotate masks --margin`), and so are the hulls that name their pixels."""


@dataclass(frozen=True, eq=False)
class FramePixels:
    """The content of the pixels of a frame.

    Attributes:
        tracks: (V, H, W) number of the road user, `ABSENT` elsewhere.
        excluded: (V, H, W) outside the lens, on the recording vehicle, redacted, of a road user without a box, or of a
            missing image.
    """

    tracks: AnyArray
    excluded: Bool


def boxes_at(frame: Frame, min_score: float, timestamp_ns: int | None = None) -> FrameBoxes:
    """Return the boxes of a frame in the world, moved along their velocities to another time.

    Args:
        frame: the frame.
        min_score: boxes with a lower score are left out; labels without a score count.
        timestamp_ns: the time; None: that of the frame.
    """
    boxes = frame.boxes("world")
    kept = np.isnan(boxes.score) | (boxes.score >= min_score)
    rows = np.flatnonzero(kept)
    seconds = ((frame.timestamp_ns if timestamp_ns is None else timestamp_ns) - boxes.timestamp_ns) * 1e-9
    moved = boxes.pose.translation[rows] + seconds * np.nan_to_num(boxes.velocity_mps[rows])
    return replace(
        boxes, pose=Poses.unchecked(boxes.pose.rotation[rows], moved), size_m=boxes.size_m[rows],
        velocity_mps=boxes.velocity_mps[rows], score=boxes.score[rows],
        category=tuple(boxes.category[row] for row in rows), track_id=tuple(boxes.track_id[row] for row in rows),
        source=tuple(boxes.source[row] for row in rows), attributes=tuple(boxes.attributes[row] for row in rows),
    )  # fmt: skip


def read_pixels(frame: Frame, rig: SceneRig, street: Bool, tracks: Mapping[str, int], min_score: float) -> FramePixels:
    """Read the content of each pixel of a frame, in the raster of the generator.

    Args:
        frame: the frame.
        rig: the cameras.
        street: (V, H, W) from `SceneRig.images`.
        tracks: numbers of road users by track id.
        min_score: see `boxes_at`.

    Raises:
        DatasetError: a mask is missing or broken.
    """
    numbers = np.full(street.shape, ABSENT, np.int32)
    excluded = ~street
    for row, camera in enumerate(rig.cameras):
        if camera not in frame.images:
            continue
        image, raster = frame.images[camera], rig.rasters[row]
        shown = masked_pixels(image, raster, MASK_KINDS)
        excluded[row] |= masked_pixels(image, raster, (REDACTION,))
        boxes = boxes_at(frame, min_score, image.timestamp_ns)
        named = name_pixels(boxes, rig.raster_lens(row), image.world_SE3_camera, tracks)
        numbers[row] = np.where(shown, named, ABSENT)
        excluded[row] |= shown & (named == ABSENT)
    return FramePixels(numbers, excluded)


def masked_pixels(image: Image, raster: ImageRaster, kinds: tuple[str, ...]) -> Bool:
    """Mark the pixels (H, W) of the raster in which a mask of given kinds is not zero."""
    shown = np.zeros((raster.final.height_px, raster.final.width_px), np.bool_)
    for mask in image.masks():
        if mask.kind in kinds:
            shown |= raster.mask(mask.decode()) > 0
    return shown


def name_pixels(boxes: FrameBoxes, lens: Camera, world_SE3_camera: Poses, tracks: Mapping[str, int]) -> AnyArray:
    """Return the number (H, W) of the nearest road user in whose grown hull a pixel lies, `ABSENT` elsewhere.

    Args:
        boxes: boxes in the world; those of other classes than the generator's are left out.
        lens: lens of the raster.
        world_SE3_camera: pose of the camera.
        tracks: numbers of road users by track id.
    """
    named = np.full((lens.height_px, lens.width_px), ABSENT, np.int32)
    rows = [row for row, name in enumerate(boxes.category) if name in CLASS_OF]
    if not rows:
        return named
    poses = world_SE3_camera.inverse() @ boxes.pose[np.array(rows)]
    away: Float64 = np.linalg.norm(poses.translation, axis=1)
    for place in np.argsort(-away, kind="stable"):
        size = _GROWN * boxes.size_m[rows[place]]
        named[draw_hulls(lens, poses[place], size[None]) > 0] = tracks[boxes.track_id[rows[place]]]
    return named
