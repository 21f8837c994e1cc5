"""What a method may learn from: the training pictures of a split with their poses, none of them opened."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from mirror.dataset.dataset import Dataset
from mirror.dataset.image import Image
from mirror.errors import DatasetError
from mirror.geometry.poses import Poses
from mirror.protocols.document import Group, Protocol
from mirror.protocols.views.plan import Plan, plan_views


@dataclass(frozen=True, eq=False)
class TrainingImages:
    """The training pictures of one camera in one scene.

    Attributes:
        images: (N,) of all training traversals, in order of traversal and time.
        world_SE3_camera: (N) poses, in the scene's world frame.
    """

    images: tuple[Image, ...]
    world_SE3_camera: Poses


ImageKey: TypeAlias = tuple[str, str, int]
"""One recorded picture: traversal, camera, timestamp_ns."""

TrainingImagesByCamera: TypeAlias = Mapping[tuple[str, str], TrainingImages]
"""By scene and camera."""


def list_training_images(dataset: Dataset, plan: Plan) -> TrainingImagesByCamera:
    """The training pictures of the scenes and cameras that a plan asks for.

    A picture that is itself the truth of a view is left out: the views of training traversals ask for some of them.

    Args:
        dataset: the truth.
        plan: what is asked.

    Raises:
        DatasetError: a scene and camera that is asked for has no training picture; poses or calibrations are missing.
    """
    wanted = dict.fromkeys((view.scene_id, view.camera) for view in plan.views)
    asked = _truths(plan)
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
    return {key: TrainingImages(tuple(own), _poses(own)) for key, own in images.items()}


def list_scored_training_images(dataset: Dataset, protocol: Protocol, split: str, scene: str) -> frozenset[ImageKey]:
    """The pictures of a scene's training traversals that a protocol asks for.

    Where they are the test, as in OmniRe's protocol or where there is one traversal alone, nothing may learn from them.

    Args:
        dataset: the truth.
        protocol: what asks.
        split: name.
        scene: id.

    Raises:
        DatasetError: no such split, or no picture is asked for.
    """
    recorded = [group for group in protocol.groups if "train" in group.roles and group.ego_shift_m == 0.0]
    if not recorded:
        raise DatasetError(
            f"protocol {protocol.name} asks for no picture of a training traversal", file=dataset.root,
            place=f"split {split}", expected="a group with the role train",
            remedy="choose another protocol; held-out traversals are not learnt from anyhow",
        )  # fmt: skip
    own = protocol.model_copy(update={"groups": (Group(name=recorded[0].name, roles=("train",)),)})
    return _truths(plan_views(dataset.where(scene=scene), own, split))


def _truths(plan: Plan) -> frozenset[ImageKey]:
    """The recorded pictures that are themselves the truth of a view."""
    moved = {group.name for group in plan.protocol.groups if group.ego_shift_m != 0.0}
    return frozenset(
        (view.traversal_id, view.camera, view.timestamp_ns) for view in plan.views if view.group not in moved
    )


def _poses(images: list[Image]) -> Poses:
    poses = [image.world_SE3_camera for image in images]
    return Poses(
        np.concatenate([pose.rotation for pose in poses]), np.concatenate([pose.translation for pose in poses])
    )
