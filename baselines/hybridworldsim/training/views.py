"""Which images a block is trained on: those of the training traversals that see it, not one of a standing vehicle."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass

from hybridworldsim.stationary import STATIONARY_M, select_moving
from hybridworldsim.training.viewpoint import require_pinhole
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError
from mirror.methods.training_images import ImageKey
from mirror.protocols.document import Frames, Group, Protocol
from mirror.protocols.views import plan_views
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView


@dataclass(frozen=True)
class TrainingViews:
    """Training images as views: raster, lens and pose of each, none of them opened.

    Attributes:
        plan: of all training frames; its protocol says the raster and the masks.
        views: those of the scene that are trained on, in order of traversal, frame and camera.
        standing: how many were left out since the vehicle had hardly moved.
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
    """The training images of a scene, in the raster and with the masks of a protocol.

    Args:
        dataset: where they lie.
        protocol: what the method will be scored by; its groups and its choice of frames do not matter.
        split: whose training traversals are meant.
        scene: which scene.
        withheld: images that are left out.
        stationary_m: an image is left out where its camera is nearer than this to the last one kept.

    Raises:
        UsageError: a lens is not a pinhole in the protocol's raster.
        DatasetError: no such split, or no training traversal with images in the scene.
    """
    every = protocol.model_copy(
        update={
            "frames": Frames(every=1, last=True, cameras=protocol.frames.cameras),
            "groups": (Group(name="training", roles=("train",)),),
        }
    )
    plan = plan_views(dataset.where(scene=scene), every, split)
    own = [view for view in plan.views if (view.traversal_id, view.camera, view.timestamp_ns) not in withheld]
    if not own:
        raise DatasetError(
            f"scene {scene} has no training image", file=dataset.root, place=f"split {split}",
            expected=f"training traversals with images, besides the {len(withheld)} that are held out",
            remedy="choose another scene or split, or a protocol that asks for fewer",
        )  # fmt: skip
    for view in own:
        require_pinhole(view)
    kept = select_moving((((view.traversal_id, view.camera), view.pose.translation[0]) for view in own), stationary_m)
    return TrainingViews(plan, tuple(own[position] for position in kept), len(own) - len(kept))
