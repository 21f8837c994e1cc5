"""The protocol that a method follows: what it is asked to reconstruct, what it returns, and how it renders."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.training_images import ImageKey
from mirror.progress import ProgressReporter
from mirror.protocols import document as protocols
from mirror.protocols.views.view import RenderView


@dataclass(frozen=True)
class ReconstructionTask:
    """What is to be reconstructed, and for how long.

    Attributes:
        scene: id.
        split: name; only its training traversals are looked at.
        protocol: whose raster and masks hold; pictures are no wider than it says.
        steps: pictures to train on; or None.
        core_minutes: processor time to train for, in each block; or None.
        seed: of all that is left to chance.
        initialise: where depth and points come from: an estimator's name, ``dataset`` for layers that were brought, or
            one of them, ``source@version``. None: those that were brought, if there are and nothing is withheld;
            else the method's own estimator.
        threads: None: as many as the method takes by itself.
        half: write the model in half precision.
        withheld: pictures of training traversals that are not looked at, such as
            `mirror.methods.training_images.list_scored_training_images` names.
        blocks: names of those that are trained now, for any executor to share out; none: all.
        settings: of the method, by name, in place of its own; as text.
    """

    scene: str
    split: str
    protocol: protocols.Protocol
    steps: int | None = None
    core_minutes: float | None = None
    seed: int = 0
    initialise: str | None = None
    threads: int | None = None
    half: bool = False
    withheld: frozenset[ImageKey] = field(default=frozenset())
    blocks: frozenset[str] = field(default=frozenset())
    settings: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ReconstructionResult:
    """What came of it.

    Attributes:
        folder: of the model.
        blocks: folders in it that are trained, in order.
        psnr_db: of the pictures that were trained on last, mean of the blocks.
        steps: pictures that were learnt from, of all blocks.
        core_s: processor time of training.
        wall_s: time on the wall, of training.
        gaussians: held.
        model_bytes: of all that rendering needs.
        pictures: that were trained on.
        driven_m: length of the road that the model covers.
        undone: blocks that are still to be trained, see `ReconstructionTask.blocks`; the figures are of the others.
        points: layer of points that it began with, ``source@version``; None: it began without.
    """

    folder: Path
    blocks: tuple[str, ...]
    psnr_db: float
    steps: int
    core_s: float
    wall_s: float
    gaussians: int
    model_bytes: int
    pictures: int
    driven_m: float
    undone: tuple[str, ...] = ()
    points: str | None = None


class InstalledMethod(Protocol):
    """What an entry point names."""

    def reconstruct(
        self, dataset: Dataset, task: ReconstructionTask, out: Path, watch: ProgressReporter
    ) -> ReconstructionResult:
        """Train a model, or go on where an earlier call was stopped.

        Args:
            dataset: where the pictures lie.
            task: what is asked.
            out: folder of the model; another task's is refused.
            watch: told how it goes.
        """

    def open(self, model: Path, appearance: AppearancePolicy = ...) -> Callable[[RenderView], UInt8]:
        """A renderer of a trained model: pixels (H, W, 3), RGB, of a view."""
