"""The interface of a method: the reconstruction task that it gets, the result that it returns, and its renderer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.devices import CPU
from mirror.executors.choice import ExecutorChoice
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.capabilities import Capabilities
from mirror.methods.training_images import ImageKey
from mirror.progress import ProgressReporter
from mirror.protocols import document as protocols
from mirror.protocols.views.view import RenderView


@dataclass(frozen=True)
class ReconstructionTask:
    """The task of a reconstruction: scene, split, protocol and training budget.

    Attributes:
        scene: id of the scene.
        split: name of the split; only its training traversals are read.
        protocol: protocol that gives raster and masks; images are at most as wide as it allows.
        steps: number of images to train on; None: not limited.
        core_minutes: processor time to train each block; None: not limited.
        seed: seed of all random choices.
        initialise: source of depth and points: the name of an estimator, ``dataset`` for layers of the dataset, or one
            such layer, ``source@version``. None: layers of the dataset, if it has any and no image is withheld;
            otherwise the method's own estimator.
        threads: number of threads; None: the method chooses.
        half: whether the model is written in half precision.
        withheld: images of training traversals that must not be read, such as those of
            `mirror.methods.training_images.list_scored_training_images`.
        blocks: names of the blocks that this call trains, so that blocks can be distributed; empty: all.
        settings: settings of the method that replace its defaults, by name, as text.
        device: where a method with the capability `takes_device` computes, as torch names it.
        devices: devices of one kind on which blocks are trained at the same time; empty: `device` only.
        executor: where a method with the capability `distributes_blocks` trains blocks; None: as `devices` says.
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
    device: str = CPU
    devices: tuple[str, ...] = ()
    executor: ExecutorChoice | None = None


@dataclass(frozen=True)
class ReconstructionResult:
    """The model that a reconstruction wrote, and its costs.

    Attributes:
        folder: folder of the model.
        blocks: trained blocks (folders in `folder`), in order.
        psnr_db: PSNR of the last training images, mean over the blocks; None: not measured.
        steps: training steps of all blocks, one image each; None: not counted.
        core_s: processor time of training; None: `mirror reconstruct` measures that of this process.
        wall_s: elapsed time of training; None: `mirror reconstruct` measures it.
        gaussians: number of Gaussians in the model; None: it has none.
        model_bytes: bytes of all files that rendering needs; None: those of all files in `folder`.
        pictures: number of different training images; None: not counted.
        driven_m: length of the road that the model covers; None: that of the longest training traversal.
        undone: blocks that are not trained yet, see `ReconstructionTask.blocks`; the figures are of the trained ones.
        points: layer of points used for initialisation, ``source@version``; None: no points were used.
    """

    folder: Path
    blocks: tuple[str, ...] = ()
    psnr_db: float | None = None
    steps: int | None = None
    core_s: float | None = None
    wall_s: float | None = None
    gaussians: int | None = None
    model_bytes: int | None = None
    pictures: int | None = None
    driven_m: float | None = None
    undone: tuple[str, ...] = ()
    points: str | None = None


class InstalledMethod(Protocol):
    """An installed method: the functions of `Method`, without the statement of its capabilities.

    A method that has no attribute `capabilities` has those that its functions show.
    """

    def reconstruct(
        self, dataset: Dataset, task: ReconstructionTask, out: Path, progress: ProgressReporter
    ) -> ReconstructionResult:
        """Train a model, or resume the training that an earlier call did not finish.

        `mirror reconstruct` writes ``reconstruction.json`` into the folder; the method writes what its renderer needs.

        Args:
            dataset: dataset with the training images.
            task: scene, split, protocol and budget.
            out: folder of the model; `mirror reconstruct` refuses the folder of another task.
            progress: receives the progress.
        """

    def open(self, model: Path, appearance: AppearancePolicy = ...) -> Callable[[RenderView], UInt8]:
        """Open a trained model as a renderer: a function from a view to its pixels (H, W, 3), uint8, RGB."""


class Method(InstalledMethod, Protocol):
    """The object that an entry point ``mirror.methods`` or ``--method FILE.py:OBJECT`` names.

    Its capabilities name the further functions that it has; they are checked when the method is loaded.
    """

    @property
    def capabilities(self) -> Capabilities | None:
        """Return the method's capabilities; None if its functions show them."""
        ...
