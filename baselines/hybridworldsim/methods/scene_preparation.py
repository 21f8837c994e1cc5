"""Prepares a scene for training: blocks with their views, layers and geometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from hybridworldsim.methods.layers import KINDS, Layers, layers_for
from hybridworldsim.model.blocks import Block, divide, select_views
from hybridworldsim.model.initialization import InitialGeometry
from hybridworldsim.model.scene_geometry import SceneGeometry, driven_m, read_scene_geometry
from hybridworldsim.trainable.viewpoint import Source
from hybridworldsim.training.appearance import AppearanceSelector
from hybridworldsim.training.data_loader import TrainingImageCache
from hybridworldsim.training.documents import Run
from hybridworldsim.training.previews import Preview
from hybridworldsim.training.views import TrainingViews, training_views
from mirror.arrays import Float64
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, UsageError
from mirror.methods.plugin import ReconstructionTask
from mirror.progress import ProgressReporter
from mirror.protocols.document import Group
from mirror.protocols.views import Plan, plan_views
from mirror.protocols.views.view import RenderView

_PREVIEWS: Final = 2


@dataclass(frozen=True, eq=False)
class PreparedScene:
    """Everything that the blocks of a scene are trained with.

    Attributes:
        blocks: blocks with their training views.
        selected: names of the blocks to train.
        geometry: geometry of the scene.
        layers: layers of depth and points.
        training: training views of the scene.
        traversals: dataset view of the training traversals.
        held_out: plan of held-out views for previews, or None.
    """

    blocks: tuple[tuple[Block, tuple[RenderView, ...]], ...]
    selected: frozenset[str]
    geometry: SceneGeometry
    layers: Layers
    training: TrainingViews
    traversals: Dataset
    held_out: Plan | None


@dataclass(frozen=True, eq=False)
class BlockTraining:
    """Everything that one block is trained with."""

    block: Block
    views: tuple[RenderView, ...]
    initial: InitialGeometry
    layers: Layers
    training: TrainingViews
    held_out: Plan | None

    def previews(self, run: Run, reporter: ProgressReporter) -> list[Preview]:
        """Return some training and held-out images of the block, except held-out images that cannot be read."""
        groups = [("training", self.training.plan, self.views)]
        if self.held_out is not None:
            groups.append(("held-out", self.held_out, select_views(self.block, self.held_out.views)))
        # Training images have their own appearances.
        selector = AppearanceSelector(run.sources, "nearest", () if self.held_out is None else self.held_out.views)
        previews = []
        for name, plan, views in groups:
            images = TrainingImageCache(self.layers.dataset, plan, np.array(self.block.origin_m))
            middles = (np.arange(_PREVIEWS) + 0.5) / _PREVIEWS * len(views)
            for number, place in enumerate(sorted(set(middles.astype(int).tolist())) if views else []):
                view = views[place]
                try:
                    image = images(view)
                except DatasetError as error:
                    if plan is not self.held_out:
                        raise
                    reporter.message(f"not shown in the previews: {error}")
                    continue
                previews.append(Preview(f"{name}-{number}", image, selector.select(view).colours[0][0]))
        return previews


def prepare_scene(
    dataset: Dataset, task: ReconstructionTask, block_m: float, reporter: ProgressReporter
) -> PreparedScene:
    """Select blocks and views, estimate missing layers, and read the geometry of a scene; no model is written.

    Args:
        dataset: the complete dataset.
        task: the task.
        block_m: edge of a block.
        reporter: receives messages and the progress of the estimation.

    Raises:
        UsageError: the task names an unknown block, or layers cannot be selected.
        DatasetError: there is nothing to train on.
    """
    # Views come before layers: without masks of road users no image is matched either.
    views = training_views(dataset, task.protocol, task.split, task.scene, withheld=task.withheld).views
    driven = driven_m(dataset.where(split=task.split, role="train", scene=task.scene))
    candidates = divide(_places_with_images(driven, views), block_m).blocks
    blocks = tuple((block, own_views) for block in candidates if (own_views := select_views(block, views)))
    selected = _select_blocks([block.name for block, _ in blocks], task.blocks)
    layers = layers_for(dataset, task, reporter)
    # Planned again, because the plan lists the layers.
    training = training_views(layers.dataset, task.protocol, task.split, task.scene, withheld=task.withheld)
    traversals = layers.dataset.where(split=task.split, role="train", scene=task.scene)
    geometry = read_scene_geometry(traversals)
    if geometry.few_points is not None:
        reporter.message(geometry.few_points)
    for kind in KINDS:
        if missing := layers.traversals_without(kind, traversals.traversals()):
            reporter.message(f"without {kind}: {', '.join(missing)}")
    if training.stationary_count:
        reporter.message(f"{training.stationary_count} images of a stationary vehicle are left out")
    return PreparedScene(
        blocks=blocks,
        selected=selected,
        geometry=geometry,
        layers=layers,
        training=training,
        traversals=traversals,
        held_out=_plan_held_out(layers.dataset, task, reporter),
    )


def _places_with_images(driven: Float64, views: Sequence[RenderView]) -> Float64:
    """Driven places (N, 3) where images were taken; poses may begin before the first image and end after the last."""
    cameras = np.array([view.pose.translation[0] for view in views])
    _, nearest = cKDTree(driven[:, :2]).query(cameras[:, :2])
    return driven[np.unique(nearest)]


def source_pairs(views: Sequence[RenderView]) -> list[Source]:
    """Return the traversals and cameras of views, sorted."""
    return sorted({Source(view.traversal_id, view.camera) for view in views})


def _select_blocks(names: Sequence[str], requested: frozenset[str]) -> frozenset[str]:
    if requested - set(names):
        raise UsageError(
            f"no block {', '.join(sorted(requested - set(names)))}",
            place="--blocks",
            expected=f"some of {', '.join(names)}",
        )
    return requested or frozenset(names)


def _plan_held_out(dataset: Dataset, task: ReconstructionTask, reporter: ProgressReporter) -> Plan | None:
    """Plan views of held-out images for previews; nothing is learned from them. None if there are none."""
    roles = ("held_out", "test")
    scene = dataset.where(scene=task.scene)
    groups = tuple(group for group in task.protocol.groups if set(group.roles) <= set(roles) and not group.ego_shift_m)
    if set(scene.roles(task.split)).isdisjoint(roles):
        groups = ()
    if task.withheld:
        groups = (*groups, Group(name="withheld", roles=("train",)))
    try:
        return plan_views(scene, task.protocol.model_copy(update={"groups": groups}), task.split) if groups else None
    except DatasetError as error:
        # Training does not need them.
        reporter.message(f"held-out images are not shown: {error}")
        return None
