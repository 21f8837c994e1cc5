"""A method of static reconstruction: trains the blocks of a scene, and renders them."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from hybridworldsim.methods.device_shares import train_shares
from hybridworldsim.methods.estimates import TableSizes, describe_costs, estimate_task_bytes
from hybridworldsim.methods.gpu_settings import describe_changes, size_factor
from hybridworldsim.methods.overrides import override_settings, settings_document
from hybridworldsim.methods.recorded_cameras import read_recorded_cameras
from hybridworldsim.methods.renderers import BlockRenderer, one_point, open_block, render_nearest, training_sources
from hybridworldsim.methods.scene_preparation import BlockTraining, PreparedScene, prepare_scene, source_pairs
from hybridworldsim.model.blocks import SIZE_M, Block
from hybridworldsim.model.initialization import InitialGeometry
from hybridworldsim.model.scene_geometry import block_geometry
from hybridworldsim.trainable.method import MovableMethod, RenderableModel, TrainableMethod
from hybridworldsim.trainable.viewpoint import Source
from hybridworldsim.training.appearance import trained_cameras
from hybridworldsim.training.block_training import Options, train_block
from hybridworldsim.training.data_loader import GPU_WORKERS, NoSupervisionError, TrainingImageCache
from hybridworldsim.training.documents import Run, TrainingOutcome
from hybridworldsim.training.parameters import write_parameters
from hybridworldsim.training.run.budget import Budget
from hybridworldsim.training.run.document import RUN, describe_computation
from hybridworldsim.training.run.exhaustion import STREET_REMEDY, exhausted_memory_named
from hybridworldsim.training.run.folder import RunFolder
from mirror.dataset.dataset import Dataset
from mirror.devices import CPU, OPTION, require_memory
from mirror.errors import DatasetError, UsageError
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.capabilities import Capabilities, find_capabilities
from mirror.methods.hosting import describe_task, driven_length_m, require_own, write_costs
from mirror.methods.model_document import DOCUMENT, read_reconstruction
from mirror.methods.plugin import ReconstructionResult, ReconstructionTask
from mirror.plugins import is_file_reference
from mirror.progress import ProgressReporter
from mirror.schema.files import write_json
from mirror.schema.hashing import hash_document


@dataclass(frozen=True)
class StaticMethod:
    """A method that `hybridworldsim.training` trains; see `mirror.methods.plugin.Method`.

    Attributes:
        name: name of the entry point.
        make: makes an untrained model from the geometry of a block and settings.
        settings: makes the settings, a dataclass, from a seed.
        block_m: edge of a block.
        sky: whether the method learns from masks of the sky.
        make_empty: makes a model without Gaussians of training sources and settings, whose parameters are then replaced
            by those of a trained block; None: `make` makes one from the geometry of one point.
        capabilities: see `Method`; None: the functions of the models that `make` makes show them.
        sizes: returns the largest sizes of the tables from settings, for the estimate that is printed before a training
            starts; None: none is printed.
        scale: multiplies the numbers of Gaussians of settings, which are those for a CPU, for the larger images of a
            GPU; None: they are the same on every device.
        reads_light: whether the method reads the light and the mountings of the cameras.
    """

    name: str
    make: Callable[[InitialGeometry, Any], TrainableMethod]
    settings: Callable[[int], Any]
    block_m: float = SIZE_M
    sky: bool = False
    make_empty: Callable[[Sequence[Source], Any], RenderableModel] | None = None
    capabilities: Capabilities | None = None
    sizes: Callable[[Any], TableSizes] | None = None
    scale: Callable[[Any, float], Any] | None = None
    reads_light: bool = False

    def reconstruct(
        self, dataset: Dataset, task: ReconstructionTask, out: Path, reporter: ProgressReporter
    ) -> ReconstructionResult:
        """Train each block of a scene; see `InstalledMethod.reconstruct`.

        Raises:
            UsageError: another run began in the folder, or the task is invalid.
            DatasetError: there is nothing to train on, or training failed.
        """
        # Refuse invalid settings before minutes are spent on layers.
        settings = self._settings(task)
        document = describe_task(self._label(out), dataset, task)
        require_own(out, document)
        if task.threads is not None:
            torch.set_num_threads(task.threads)
        stated = self._stated(task)
        for run in sorted(out.glob(f"*/{RUN}")):
            RunFolder(run.parent, TrainingOutcome).require_same(Run, stated)
        if changes := describe_changes(self.settings(task.seed), self._defaults(task)):
            reporter.message(f"defaults on {task.device}: {changes}")
        if self.sizes is not None:
            sizes = self.sizes(settings)
            reporter.message(describe_costs(sizes, task))
            require_memory(task.device, estimate_task_bytes(sizes, task), STREET_REMEDY)
        scene = prepare_scene(dataset, task, self.block_m, reporter)
        if not (out / DOCUMENT).exists():
            write_json(out / DOCUMENT, document)
        untrained = {
            block.name: len(views)
            for block, views in scene.blocks
            if block.name in scene.selected and RunFolder(out / block.name, TrainingOutcome).outcome is None
        }
        is_shared = len(untrained) > 0 if task.executor else len(task.devices) > 1 and len(untrained) > 1
        if is_shared and read_reconstruction(out).done is None:
            # The number of threads is part of a run.
            apart = replace(task, threads=torch.get_num_threads())
            train_shares(self, dataset, apart, out, untrained, reporter)
        result = _summarize(out, self._train_blocks(scene, task, out, reporter), scene)
        if not result.undone:
            write_costs(out, result)
        return result

    def open(
        self,
        model: Path,
        appearance: AppearancePolicy = AppearancePolicy(),  # noqa: B008 - immutable
        *,
        device: str = CPU,
    ) -> BlockRenderer:
        """Open a renderer; see `InstalledMethod.open` and `mirror.methods.method_devices.DeviceMethod`.

        Raises:
            UsageError: this method does not support the appearance policy.
            DatasetError: the folder holds no complete model of this method.
        """
        settings = type(self.settings(0))
        blocks = [open_block(folder, self._make_empty, settings, device) for folder in block_folders(model)]
        return render_nearest(blocks, appearance, find_capabilities(self, blocks[0].model))

    def write(self, path: Path, block: Block, trainer: TrainableMethod, run: Run, *, half: bool) -> int:
        """Write the files that rendering needs, and return their size in bytes."""
        return write_parameters(path, trainer.model, half=half)

    def _train_blocks(
        self, scene: PreparedScene, task: ReconstructionTask, out: Path, reporter: ProgressReporter
    ) -> dict[str, TrainingOutcome | None]:
        """Train the selected blocks; returns the outcome of each block, None where it is not finished.

        Raises:
            NoSupervisionError: masks cover all images of all blocks.
        """
        outcomes: dict[str, TrainingOutcome | None] = {}
        no_supervision: NoSupervisionError | None = None
        is_finished = read_reconstruction(out).done is not None
        for place, (block, views) in enumerate(scene.blocks):
            folder = RunFolder(out / block.name, TrainingOutcome)
            # In a finished model, a block without a folder was left out.
            if is_finished and not folder.path.exists():
                continue
            # Other processes train the other blocks; a finished block is compared with this task in any case.
            if block.name not in scene.selected and folder.outcome is None:
                outcomes[block.name] = None
                continue
            initial = block_geometry(scene.geometry, block, source_pairs(views))
            if self.reads_light:
                initial = replace(
                    initial, cameras=read_recorded_cameras(scene.layers.dataset, scene.training.plan, views)
                )
            points = len(initial.points_m)
            reporter.message(f"{block.name}, {place + 1} of {len(scene.blocks)}: {len(views)} images, {points} points")
            training = BlockTraining(block, views, initial, scene.layers, scene.training, scene.held_out)
            try:
                outcomes[block.name] = self._train(training, task, folder, reporter)
            except NoSupervisionError as error:
                no_supervision = error
                # A corner of the street where road users or the vehicle itself cover all images: train the others.
                reporter.message(f"{block.name} is left out: masks cover all its images")
        if no_supervision is not None and not any(outcome is not None for outcome in outcomes.values()):
            raise no_supervision
        return outcomes

    def _train(
        self,
        training: BlockTraining,
        task: ReconstructionTask,
        folder: RunFolder[TrainingOutcome],
        reporter: ProgressReporter,
    ) -> TrainingOutcome:
        run = self._run(training, task)
        finished = folder.begin(run)
        if finished is not None:
            reporter.message(f"{folder.path} is finished: {finished.psnr_db:.2f} dB after {finished.steps} steps")
            return finished
        trainer = self._make_on(task, training.initial)
        origin = np.array(training.block.origin_m)
        # The layer of the depth map also selects the mask of the sky.
        reads_depth = trainer.reads_depth or self.sky
        depth_traversals = training.layers.traversals_with("depth") if reads_depth else frozenset()
        plan = training.training.plan
        # A width, or a --device, needs less memory; the checkpoint stays.
        named = exhausted_memory_named(task.device, STREET_REMEDY, "memory for the tables, one image and its gradients")
        with folder.claim(run), named:
            try:
                return train_block(
                    trainer,
                    TrainingImageCache(
                        training.layers.dataset, plan, origin, depth_traversals, sky=self.sky, device=task.device
                    ),
                    training.views,
                    Budget(task.steps, task.core_minutes),
                    folder,
                    lambda path: self.write(path, training.block, trainer, run, half=task.half),
                    seed=task.seed,
                    options=Options(
                        previews=training.previews(run, reporter),
                        title=f"{self.name}, {task.scene}, {training.block.name}",
                        workers=1 if task.device == CPU else GPU_WORKERS,
                    ),
                    reporter=reporter,
                )
            except NoSupervisionError:
                # Remove it under the lock: without the lock, another run may have started in this folder.
                shutil.rmtree(folder.path)
                raise

    def _make_on(self, task: ReconstructionTask, initial: InitialGeometry) -> TrainableMethod:
        """Make an untrained model on the device of a task; it begins with the same numbers on every device.

        Raises:
            UsageError: the models of this method cannot be moved.
        """
        trainer = self.make(initial, self._settings(task))
        if task.device == CPU:
            return trainer
        if not isinstance(trainer, MovableMethod):
            raise UsageError(f"method {self.name} takes no device", place=OPTION, remedy=f"{OPTION} {CPU}")
        return trainer.to(task.device)

    def _make_empty(self, run: Run, settings: Any) -> RenderableModel:
        """Make a model whose parameters those of a trained block replace."""
        if self.make_empty is None:
            return self.make(one_point(run), settings)
        return self.make_empty(training_sources(run), settings)

    def _label(self, out: Path) -> str:
        """The name in the model's document: that of the entry point, or the file that a user named."""
        if (out / DOCUMENT).is_file() and is_file_reference(written := read_reconstruction(out).method):
            return written
        return self.name

    def _settings(self, task: ReconstructionTask) -> Any:
        return override_settings(self._defaults(task), task.settings)

    def _defaults(self, task: ReconstructionTask) -> Any:
        """The settings for the device and the width of a task."""
        settings = self.settings(task.seed)
        if self.scale is None or task.device == CPU:
            return settings
        return self.scale(settings, size_factor(task.protocol.pixels.max_width_px))

    def _stated(self, task: ReconstructionTask) -> dict[str, Any]:
        """The values of a run's document, as JSON, that follow from the task alone."""
        settings = settings_document(self._settings(task))
        return {
            "method": self.name,
            "settings": settings,
            "settings_hash": hash_document(settings),
            "seed": task.seed,
            "steps": task.steps,
            "core_minutes": task.core_minutes,
            "threads": torch.get_num_threads(),
            "scene": task.scene,
            "split": task.split,
            "width_px": task.protocol.pixels.max_width_px,
            "half": task.half,
            "withheld": ["/".join(map(str, image)) for image in sorted(task.withheld)],
            "computed": describe_computation(task.device, splats=True).model_dump(mode="json"),
        }

    def _run(self, training: BlockTraining, task: ReconstructionTask) -> Run:
        layers = training.layers.dataset.layers
        return Run(
            **self._stated(task),
            block=training.block.name,
            origin_m=training.block.origin_m,
            radius_m=training.initial.radius_m,
            dataset_hash=training.training.plan.dataset_hash,
            plan_hash=training.training.plan.hash,
            depth=training.layers.depth,
            points=training.layers.points,
            poses=layers.poses,
            calibrations=layers.calibrations,
            stage=layers.stage,
            pictures=len(training.views),
            sources=trained_cameras(training.views),
        )


def _summarize(out: Path, outcomes: dict[str, TrainingOutcome | None], scene: PreparedScene) -> ReconstructionResult:
    finished = {name: outcome for name, outcome in outcomes.items() if outcome is not None}
    return ReconstructionResult(
        folder=out,
        blocks=tuple(finished),
        undone=tuple(name for name, outcome in outcomes.items() if outcome is None),
        psnr_db=float(np.mean([outcome.psnr_db for outcome in finished.values()])),
        steps=sum(outcome.steps for outcome in finished.values()),
        core_s=sum(outcome.core_s for outcome in finished.values()),
        wall_s=sum(outcome.wall_s for outcome in finished.values()),
        gaussians=sum(outcome.gaussians for outcome in finished.values()),
        model_bytes=sum(outcome.model_bytes for outcome in finished.values()),
        pictures=len(scene.training.views),
        driven_m=driven_length_m(scene.traversals),
        points=scene.layers.points,
    )


def block_folders(model: Path) -> list[Path]:
    """Return the folders of a model's blocks.

    Raises:
        DatasetError: a block is not finished, or there is none.
    """
    done = read_reconstruction(model).done
    folders = sorted(path.parent for path in model.glob("*/run.json"))
    undone = [path for path in folders if RunFolder(path, TrainingOutcome).outcome is None]
    if undone or done is None:
        raise DatasetError(
            f"{len(undone) or 'some'} blocks are not trained to the end", file=model,
            expected="a model", remedy="run the same `mirror reconstruct` again: it continues where it stopped",
        )  # fmt: skip
    return folders
