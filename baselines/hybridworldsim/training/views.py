"""Selects the images that a scene is trained on, without images of a stationary vehicle."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass

from hybridworldsim.stationary import STATIONARY_M, select_moving
from hybridworldsim.trainable.viewpoint import require_pinhole
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError
from mirror.methods.training_images import ImageKey
from mirror.protocols.document import Frames, Group, Protocol
from mirror.protocols.views import plan_views
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView


@dataclass(frozen=True)
class TrainingViews:
    """Training images as views, with raster, lens and pose of each; no image is opened.

    Attributes:
        plan: plan of all training frames; its protocol states the raster and the masks.
        views: training views of the scene, in order of traversal, frame and camera.
        stationary_count: number of views left out because the vehicle had hardly moved.
    """

    plan: Plan
    views: tuple[RenderView, ...]
    stationary_count: int


def training_views(
    dataset: Dataset,
    protocol: Protocol,
    split: str,
    scene: str,
    *,
    withheld: Set[ImageKey] = frozenset(),
    stationary_m: float = STATIONARY_M,
) -> TrainingViews:
    """Select the training images of a scene, in the raster and with the masks of a protocol.

    Views have the shutters of their calibrations, whatever the protocol asks of renders.

    Args:
        dataset: the dataset.
        protocol: the protocol that the method will be scored by; its groups and its choice of frames are ignored.
        split: split with the training traversals.
        scene: id of the scene.
        withheld: images that are left out.
        stationary_m: an image is left out if its camera is nearer than this to the last selected one.

    Raises:
        UsageError: a lens is not a pinhole in the protocol's raster.
        DatasetError: there is no such split, or no training traversal with images in the scene.
    """
    every = protocol.model_copy(
        update={
            "frames": Frames(every=1, last=True, cameras=protocol.frames.cameras),
            "groups": (Group(name="training", roles=("train",)),),
        }
    )
    plan = plan_views(dataset.where(scene=scene), every, split, calibrated_shutters=True)
    selected = [view for view in plan.views if (view.traversal_id, view.camera, view.timestamp_ns) not in withheld]
    if not selected:
        raise DatasetError(
            f"scene {scene} has no training image", file=dataset.root, place=f"split {split}",
            expected=f"training traversals with images, besides the {len(withheld)} that are held out",
            remedy="choose another scene or split, or a protocol that asks for fewer",
        )  # fmt: skip
    for view in selected:
        require_pinhole(view)
    kept = select_moving(
        (((view.traversal_id, view.camera), view.pose.translation[0]) for view in selected), stationary_m
    )
    return TrainingViews(plan, tuple(selected[position] for position in kept), len(selected) - len(kept))
