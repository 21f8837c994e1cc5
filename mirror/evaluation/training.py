"""What a method may learn from: the training pictures of a split with their poses, none of them opened."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Image
from mirror.errors import DatasetError
from mirror.evaluation.views.plan import Plan
from mirror.geometry.poses import Poses


@dataclass(frozen=True, eq=False)
class TrainingPictures:
    """The training pictures of one camera in one scene.

    Attributes:
        images: (N,) of all training traversals, in order of traversal and time.
        world_SE3_camera: (N) poses, in the scene's world frame.
    """

    images: tuple[Image, ...]
    world_SE3_camera: Poses


ByCamera: TypeAlias = Mapping[tuple[str, str], TrainingPictures]
"""By scene and camera."""


def training_pictures(dataset: Dataset, plan: Plan) -> ByCamera:
    """The training pictures of the scenes and cameras that a plan asks for.

    A picture that is itself the truth of a view is left out: the views of training traversals ask for some of them.

    Args:
        dataset: the truth.
        plan: what is asked.

    Raises:
        DatasetError: a scene and camera that is asked for has no training picture; poses or calibrations are missing.
    """
    wanted = dict.fromkeys((view.scene_id, view.camera) for view in plan.views)
    moved = {group.name for group in plan.protocol.groups if group.ego_shift_m != 0.0}
    asked = {(view.traversal_id, view.camera, view.timestamp_ns) for view in plan.views if view.group not in moved}
    images: dict[tuple[str, str], list[Image]] = {key: [] for key in wanted}
    for scene in dict.fromkeys(scene for scene, _ in wanted):
        for frame in dataset.where(split=plan.split, role="train", scene=scene).frames():
            for camera, image in frame.images.items():
                if (scene, camera) in images and (frame.traversal_id, camera, image.timestamp_ns) not in asked:
                    images[scene, camera].append(image)
    bare = [key for key, own in images.items() if not own]
    if bare:
        raise DatasetError(
            f"camera {bare[0][1]} has no training picture in scene {bare[0][0]}"
            + (f" ({len(bare)} such cameras)" if len(bare) > 1 else ""),
            file=dataset.root,
            place=f"split {plan.split}",
            expected="training traversals with pictures of every camera that is asked for",
            remedy="choose another split",
        )
    return {key: TrainingPictures(tuple(own), _poses(own)) for key, own in images.items()}


def _poses(images: list[Image]) -> Poses:
    poses = [image.world_SE3_camera for image in images]
    return Poses(
        np.concatenate([pose.rotation for pose in poses]), np.concatenate([pose.translation for pose in poses])
    )
