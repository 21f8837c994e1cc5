"""Clips of a dataset's scene: a window of frames with backgrounds and boxes along a trajectory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from hybridworldsim.generation.clips.captions import Captions
from hybridworldsim.generation.clips.clip import CATEGORIES, Clip, ClipBoxes
from hybridworldsim.generation.clips.map_lines import MapLine, crop_lines, move_lines
from hybridworldsim.generation.scenes.backgrounds import Background
from hybridworldsim.generation.scenes.rig import SceneRig
from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.traversal import FrameBoxes
from mirror.errors import DatasetError, UsageError
from mirror.geometry.poses import Poses
from mirror.protocols.views.view import Edit

CLASS_OF: Final[Mapping[str, str]] = {
    **{name: name for name in CATEGORIES},
    "bicycle": "cyclist",
    "rider": "cyclist",
    "person": "pedestrian",
    "trailer": "truck",
    "construction_vehicle": "truck",
}
"""Class of the generator by the category of a box; boxes of other categories are left out."""


@dataclass(frozen=True, eq=False)
class PlannedFrame:
    """One frame of a scene, with the vehicle's place.

    Attributes:
        frame: the recorded frame, which gives boxes and, for seeds, images.
        world_SE3_ego: one pose.
        edits: vehicles that a protocol moves or removes.
    """

    frame: Frame
    world_SE3_ego: Poses
    edits: tuple[Edit, ...] = ()


@dataclass(frozen=True)
class SceneConditions:
    """The conditions that all frames of a scene share.

    Attributes:
        rig: the cameras.
        background: images of the street without road users.
        rate_hz: frames per second.
        light: light of the traversal.
        weather: weather of the traversal.
        tracks: numbers of road users by track id.
        captions: captions of the views; None: no text.
        lines: lines of the scene's map in the world frame; None: no map is known, or none is wanted.
    """

    rig: SceneRig
    background: Background
    rate_hz: float
    light: str
    weather: str
    tracks: Mapping[str, int]
    captions: Captions | None = None
    lines: tuple[MapLine, ...] | None = None


def make_scene_clip(
    clip_id: str,
    frames: Sequence[PlannedFrame],
    scene: SceneConditions,
    *,
    recorded: int,
    rendered: UInt8 | None = None,
) -> Clip:
    """Make a clip of consecutive frames.

    Args:
        clip_id: id of the clip.
        frames: F frames.
        scene: what they share.
        recorded: number of leading frames whose recorded images are read (the seeds); the images of others are black.
        rendered: (K, V, H, W, 3) backgrounds of the first K frames, if they are known; the others are rendered.

    Raises:
        DatasetError: a background has another size than its view, or a box is not finite.
    """
    rig = scene.rig
    shape = (len(frames), len(rig.cameras), *rig.size_px, 3)
    images, background = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    present = np.ones(shape[:2], np.bool_)
    for place, one in enumerate(frames):
        if rendered is not None and place < len(rendered):
            background[place] = rendered[place]
        elif place and one is frames[place - 1]:
            background[place] = background[place - 1]
        else:
            views = rig.views(one.frame, one.world_SE3_ego, scene.light, scene.weather)
            for row, view in enumerate(views):
                background[place, row] = scale_background(
                    scene.background(view), (view.height_px, view.width_px), rig.size_px
                )
        if place < recorded:
            recorded_images, street = rig.images(one.frame)
            present[place] = street.any(axis=(1, 2))
            # The recording vehicle and the border of a fisheye image are no part of the street.
            images[place] = np.where(street[..., None], recorded_images, background[place])
    start = frames[0].world_SE3_ego.inverse()
    places_m = np.concatenate([one.world_SE3_ego.translation for one in frames])
    return Clip(
        clip_id,
        frames[0].frame.traversal_id,
        scene.rate_hz,
        rig.cameras,
        images,
        background,
        present,
        rig.intrinsics,
        rig.ego_SE3_camera.matrix(),
        np.concatenate([(start @ one.world_SE3_ego).matrix() for one in frames]),
        boxes_of(frames, scene.tracks),
        lines=None if scene.lines is None else move_lines(crop_lines(scene.lines, places_m), start.matrix()[0]),
    )


def require_valid_boxes(dataset: Dataset, frames: Iterable[Frame]) -> None:
    """Check the boxes of all frames before any is generated; boxes of other classes are not drawn.

    Args:
        dataset: the dataset, for errors.
        frames: some of its frames.

    Raises:
        UsageError: a pose is not finite, or there are several layers of boxes and none was chosen.
        DatasetError: a size is not finite, or not above 0.
    """
    for frame in frames:
        place = f"boxes {dataset.layers.boxes or ''} of {frame.traversal_id}, timestamp_ns {frame.timestamp_ns}"
        try:
            boxes = frame.boxes("world")
        except UsageError as error:
            raise UsageError(
                error.problem, file=str(dataset.root), place=place, expected=error.expected, remedy=error.remedy
            ) from error
        good = np.isfinite(boxes.size_m).all(axis=1) & (boxes.size_m > 0.0).all(axis=1)
        for row in np.flatnonzero(~good):
            if boxes.category[row] in CLASS_OF:
                raise DatasetError(
                    f"the box of track {boxes.track_id[row]} is not valid", file=str(dataset.root),
                    place=place, expected="finite sizes above 0 m",
                    remedy="name another layer with --boxes, or correct this one: `mirror check` lists such boxes",
                )  # fmt: skip


def boxes_of(
    frames: Sequence[PlannedFrame],
    tracks: Mapping[str, int],
    read: Callable[[Frame], FrameBoxes] = lambda frame: frame.boxes("world"),
) -> ClipBoxes:
    """Return the boxes of all frames, in the ego frames of the trajectory.

    Args:
        frames: the frames.
        tracks: numbers of road users by track id.
        read: returns the boxes of a frame in the world.
    """
    frame, track, category, poses, sizes = [], [], [], [np.zeros((0, 4, 4))], [np.zeros((0, 3))]
    for place, one in enumerate(frames):
        boxes = read(one.frame)
        targets = {edit.track_id: edit.world_SE3_target for edit in one.edits}
        rows = [
            row
            for row, name in enumerate(boxes.category)
            if name in CLASS_OF and targets.get(boxes.track_id[row], ()) is not None
        ]
        if not rows:
            continue
        moved = [targets.get(boxes.track_id[row]) for row in rows]
        world = boxes.pose[np.array(rows)].matrix()
        for place_of_box, target in enumerate(moved):
            if target is not None:
                world[place_of_box] = target.matrix()[0]
        frame += [place] * len(rows)
        track += [tracks[boxes.track_id[row]] for row in rows]
        category += [CATEGORIES.index(CLASS_OF[boxes.category[row]]) for row in rows]
        poses.append(one.world_SE3_ego.inverse().matrix() @ world)
        sizes.append(boxes.size_m[rows])
    return ClipBoxes(
        np.array(frame, np.int64),
        np.array(track, np.int64),
        np.array(category, np.int64),
        np.concatenate(poses),
        np.concatenate(sizes),
    )


def scale_background(image: UInt8, shape: tuple[int, int], size_px: tuple[int, int]) -> UInt8:
    """Scale a background from the size of its view to the size of the generator's images.

    Raises:
        DatasetError: it has another shape.
    """
    if image.shape != (*shape, 3):
        raise DatasetError(
            f"a background of {image.shape[1]} x {image.shape[0]} px",
            expected=f"{shape[1]} x {shape[0]} px, as its view",
            remedy="render the backgrounds with the lenses of this dataset",
        )
    if shape == size_px:
        return image
    return np.asarray(cv2.resize(image, (size_px[1], size_px[0]), interpolation=cv2.INTER_AREA), np.uint8)
