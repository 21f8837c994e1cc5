"""The images that a method may train on: those of a split's training traversals, with poses. No image is opened."""

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
    """The training images of one camera in one scene.

    Attributes:
        images: (N,) images of all training traversals, ordered by traversal and time.
        world_SE3_camera: N poses in the scene's world frame.
    """

    images: tuple[Image, ...]
    world_SE3_camera: Poses


ImageKey: TypeAlias = tuple[str, str, int]
"""Identifies a recorded image: traversal, camera, timestamp_ns."""

TrainingImagesByCamera: TypeAlias = Mapping[tuple[str, str], TrainingImages]
"""Training images by scene and camera."""


def list_training_images(dataset: Dataset, plan: Plan) -> TrainingImagesByCamera:
    """List the training images of the scenes and cameras that a plan requests.

    Images that are the truth of a view are left out, because views of training traversals are scored too.

    Args:
        dataset: dataset with the truth.
        plan: requested views.

    Raises:
        DatasetError: a requested camera has no training image in its scene; poses or calibrations are missing.
    """
    requested = dict.fromkeys((view.scene_id, view.camera) for view in plan.views)
    scored = list_scored_images(plan)
    images: dict[tuple[str, str], list[Image]] = {key: [] for key in requested}
    for scene in dict.fromkeys(scene for scene, _ in requested):
        for frame in dataset.where(split=plan.split, role="train", scene=scene).frames():
            for camera, image in frame.images.items():
                if (scene, camera) in images and (frame.traversal_id, camera, image.timestamp_ns) not in scored:
                    images[scene, camera].append(image)
    without = [key for key, listed in images.items() if not listed]
    if without:
        raise DatasetError(
            f"camera {without[0][1]} has no training image in scene {without[0][0]}"
            + (f" ({len(without)} such cameras)" if len(without) > 1 else ""),
            file=dataset.root,
            place=f"split {plan.split}",
            expected="training traversals with images of every requested camera",
            remedy="choose another split",
        )
    return {key: TrainingImages(tuple(listed), _stack_poses(listed)) for key, listed in images.items()}


def list_scored_training_images(dataset: Dataset, protocol: Protocol, split: str, scene: str) -> frozenset[ImageKey]:
    """List the images of a scene's training traversals that a protocol scores.

    If these images are the only test, as in OmniRe's protocol or with a single traversal, no method may train on them.

    Args:
        dataset: dataset with the truth.
        protocol: the protocol.
        split: name of the split.
        scene: id of the scene.

    Raises:
        DatasetError: the split does not exist, or the protocol scores no image of a training traversal.
    """
    recorded = [group for group in protocol.groups if "train" in group.roles and group.ego_shift_m == 0.0]
    if not recorded:
        raise DatasetError(
            f"protocol {protocol.name} scores no image of a training traversal", file=dataset.root,
            place=f"split {split}", expected="a group with the role train",
            remedy="choose another protocol; held-out traversals are never trained on",
        )  # fmt: skip
    training_only = protocol.model_copy(update={"groups": (Group(name=recorded[0].name, roles=("train",)),)})
    return list_scored_images(plan_views(dataset.where(scene=scene), training_only, split))


def list_withheld_images(dataset: Dataset) -> frozenset[ImageKey]:
    """List the images of a view that a published dataset withholds, which no method can read; none of a whole dataset.

    Args:
        dataset: the view, such as the training traversals of a scene.
    """
    rows = dataset.where(withheld=True).table("images", ["traversal_id", "camera", "timestamp_ns"]).to_pylist()
    return frozenset((row["traversal_id"], row["camera"], row["timestamp_ns"]) for row in rows)


def list_scored_images(plan: Plan) -> frozenset[ImageKey]:
    """Return the recorded images that are the truth of a view; none for a moved view."""
    moved = {group.name for group in plan.protocol.groups if group.ego_shift_m != 0.0}
    return frozenset(
        (view.traversal_id, view.camera, view.timestamp_ns) for view in plan.views if view.group not in moved
    )


def _stack_poses(images: list[Image]) -> Poses:
    poses = [image.world_SE3_camera for image in images]
    return Poses(
        np.concatenate([pose.rotation for pose in poses]), np.concatenate([pose.translation for pose in poses])
    )
