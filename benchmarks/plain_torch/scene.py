"""A tiny street that is trained from its images on, by the functions of `mirror reconstruct`, in either form."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import torch
from torch import Tensor

import mirror
from benchmarks.gpu.streets import SPLIT, StreetData
from hybridworldsim.kernels.dispatch import plain_torch
from hybridworldsim.methods.scene_preparation import prepare_scene, source_pairs
from hybridworldsim.methods.street import METHOD
from hybridworldsim.model.initialization import InitialGeometry, initial_street
from hybridworldsim.model.losses import colour_loss
from hybridworldsim.model.scene_geometry import block_geometry
from hybridworldsim.model.trainer import StreetTrainer
from hybridworldsim.model.visibility_cache import VisibilityCache
from hybridworldsim.trainable.viewpoint import Viewpoint
from hybridworldsim.training.block_training import psnr_db
from hybridworldsim.training.data_loader import TrainingImageCache, stream_images
from mirror.dataset.working_copy import update_working_copy
from mirror.methods.plugin import ReconstructionTask
from mirror.progress import NullProgress
from mirror.protocols.document import load_protocol
from mirror.protocols.views.view import RenderView

FORMS: Final[dict[str, Callable[[], AbstractContextManager[None]]]] = {"kernels": nullcontext, "torch": plain_torch}
"""The context in which each form computes."""


class EveryRow(VisibilityCache):
    """A record of nothing, so that every row in view is decoded at each visit, as on a GPU."""

    def record(self, viewpoint: Viewpoint, shown: Sequence[Tensor], numbers: Sequence[Tensor]) -> None:
        """Record nothing."""


@dataclass(frozen=True)
class Variant:
    """A way to train a street.

    Attributes:
        form: one of `FORMS`.
        skips: whether rows that an image hid are skipped, as on a CPU.
        dense: whether Adam moves all rows at each step, as on a GPU.
        noise: standard deviation of what is added to the offsets of the first anchors, as a share of their sizes.
    """

    form: str = "kernels"
    skips: bool = True
    dense: bool = False
    noise: float = 0.0


@dataclass(frozen=True, eq=False)
class PreparedBlock:
    """The only block of a street: its geometry, and its images in memory.

    Attributes:
        initial: the geometry.
        views: training views.
        images: opens the images.
    """

    initial: InitialGeometry
    views: tuple[RenderView, ...]
    images: TrainingImageCache


def prepare_block(street: StreetData, form: str, width_px: int, steps: int, layers: Path) -> PreparedBlock:
    """Estimate depth, points and sky of a street by a form, and read the geometry of its block.

    Args:
        street: the street, which is made.
        form: one of `FORMS`.
        width_px: width of the images.
        steps: number of steps of the task.
        layers: folder of a copy of the dataset, which receives the layers.
    """
    protocol = load_protocol("static-reconstruction")
    protocol = protocol.model_copy(update={"pixels": protocol.pixels.model_copy(update={"max_width_px": width_px})})
    (scene_id,) = mirror.open(street.dataset).where(split=SPLIT, role="train").scenes()
    task = ReconstructionTask(
        scene=scene_id, split=SPLIT, protocol=protocol, steps=steps, core_minutes=None, initialise="plane-sweep"
    )
    with FORMS[form]():
        dataset = update_working_copy(street.dataset, layers, SPLIT, place=str(layers))
        scene = prepare_scene(dataset, task, METHOD.block_m, NullProgress())
    ((block, views),) = scene.blocks
    with_depth = scene.layers.traversals_with("depth")
    images = TrainingImageCache(scene.layers.dataset, scene.training.plan, np.array(block.origin_m), with_depth)
    return PreparedBlock(block_geometry(scene.geometry, block, source_pairs(views)), views, images)


def train_street(block: PreparedBlock, variant: Variant, steps: int, seed: int) -> float:
    """Train a street as `mirror reconstruct` does; return the mean PSNR of its training images then, in dB."""
    settings = METHOD.settings(seed)
    with FORMS[variant.form]():
        street = initial_street(block.initial, settings)
        add_noise(street.background.offsets, variant.noise, seed)
        trainer = StreetTrainer(street, settings, dense=variant.dense)
        if not variant.skips:
            trainer._visibility = EveryRow()
        stream = stream_images(block.images, block.views, seed, 0)
        for step in range(steps):
            image = next(stream)
            while not image.teaches:
                image = next(stream)
            trainer.step(image, step / steps)
        stream.close()
        shown = [image for image in map(block.images, block.views) if image.teaches]
        errors = [colour_loss(trainer.render(one.viewpoint).rgb, one.rgb, one.scored) for one in shown]
    return float(np.mean([psnr_db(float(error)) for error in errors]))


@torch.no_grad()
def add_noise(offsets: Tensor, deviation: float, seed: int) -> None:
    """Add normal noise to offsets, in place; none if the deviation is 0."""
    if deviation:
        offsets.add_(deviation * torch.randn(offsets.shape, generator=torch.Generator().manual_seed(seed)))


def points_apart(first: InitialGeometry, second: InitialGeometry) -> str:
    """Describe how far the points of two geometries of a block are apart, number by number."""
    counts = f"{len(first.points_m):,} and {len(second.points_m):,} points"
    if first.points_m.shape != second.points_m.shape:
        return counts
    return f"{counts}, {np.abs(first.points_m - second.points_m).max(initial=0.0):.1e} m apart at most"
