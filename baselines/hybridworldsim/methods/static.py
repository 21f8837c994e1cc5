"""A method of static reconstruction: trains the blocks of a scene, and renders them."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from scipy.spatial import cKDTree

from hybridworldsim.methods.layers import KINDS, Layers, layers_for
from hybridworldsim.methods.overrides import override_settings, settings_document
from hybridworldsim.methods.renderers import NearestBlockRenderer, Renderer, open_block
from hybridworldsim.model.blocks import SIZE_M, Block, divide, select_views
from hybridworldsim.model.initialization import InitialGeometry
from hybridworldsim.model.scene_geometry import block_geometry, driven_m, read_scene_geometry
from hybridworldsim.training.appearance import AppearanceSelector, trained_cameras
from hybridworldsim.training.budget import Budget
from hybridworldsim.training.data_loader import NoSupervisionError, TrainingImageCache
from hybridworldsim.training.loop import Options, train
from hybridworldsim.training.run.folder import Run, RunFolder, TrainingOutcome
from hybridworldsim.training.run.parameters import write_parameters
from hybridworldsim.training.run.previews import Preview
from hybridworldsim.training.trainable_method import TrainableMethod
from hybridworldsim.training.viewpoint import Source
from hybridworldsim.training.views import TrainingViews, training_views
from mirror.arrays import Float64
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, UsageError
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.model_document import DOCUMENT, Costs, Reconstruction, list_trained_traversals, read_reconstruction
from mirror.methods.plugin import ReconstructionResult, ReconstructionTask
from mirror.progress import ProgressReporter
from mirror.protocols.document import Group
from mirror.protocols.views import Plan, plan_views
from mirror.protocols.views.view import RenderView
from mirror.schema.files import write_json
from mirror.schema.folders import FolderKind, require_output_folder

_PREVIEWS: Final = 2


@dataclass(frozen=True)
class StaticMethod:
    """What is trained by `hybridworldsim.training`; see `mirror.methods.plugin.InstalledMethod`.

    Attributes:
        name: of the entry point.
        make: a learner that has seen no image yet, of what is known of a block and of settings.
        settings: a dataclass, of a seed.
        block_m: edge of a block.
        sky: whether the method learns from masks of the sky.
    """

    name: str
    make: Callable[[InitialGeometry, Any], TrainableMethod]
    settings: Callable[[int], Any]
    block_m: float = SIZE_M
    sky: bool = False

    def reconstruct(
        self, dataset: Dataset, task: ReconstructionTask, out: Path, watch: ProgressReporter
    ) -> ReconstructionResult:
        """Train each block of a scene; see `InstalledMethod.reconstruct`.

        Raises:
            UsageError: another run began in the folder, or the task cannot be.
            DatasetError: there is nothing to train on or to begin with, or training failed.
        """
        # What cannot be is refused before minutes go into layers.
        self._settings(task)
        about = Reconstruction(
            method=self.name,
            scene=task.scene,
            split=task.split,
            trained=list_trained_traversals(dataset, task.split, task.scene),
            withheld=len(task.withheld),
            poses=dataset.layers.poses,
        )
        _require_own(out, about)
        if task.threads is not None:
            torch.set_num_threads(task.threads)
        # Before layers are made: what has nothing to mask road users by is not matched either.
        views = training_views(dataset, task.protocol, task.split, task.scene, withheld=task.withheld).views
        driven = driven_m(dataset.where(split=task.split, role="train", scene=task.scene))
        there = divide(_pictured_m(driven, views), self.block_m).blocks
        blocks = [(block, own_views) for block in there if (own_views := select_views(block, views))]
        chosen = _chosen([block.name for block, _ in blocks], task.blocks)
        layers = layers_for(dataset, task, watch)
        # The plan knows of the layers.
        training = training_views(layers.dataset, task.protocol, task.split, task.scene, withheld=task.withheld)
        own = layers.dataset.where(split=task.split, role="train", scene=task.scene)
        # Before anything is written: a scene that cannot begin leaves nothing behind.
        known = read_scene_geometry(own)
        for kind in KINDS:
            if bare := layers.lacking(kind, own.traversals()):
                watch.message(f"without {kind}: {', '.join(bare)}")
        if training.stationary_count:
            watch.message(f"{training.stationary_count} images of a standing vehicle are left out")
        if not (out / DOCUMENT).exists():
            write_json(out / DOCUMENT, about)
        held_out = _held_out(layers.dataset, task, watch)
        found: dict[str, TrainingOutcome | None] = {}
        barren: NoSupervisionError | None = None
        finished = read_reconstruction(out).done is not None
        for place, (block, seen) in enumerate(blocks):
            folder = RunFolder(out / block.name)
            # Of a model that is done, what has no folder was left out.
            if finished and not folder.path.exists():
                continue
            # What others have done is held against this task; what they are still doing is left to them.
            if block.name not in chosen and folder.outcome is None:
                found[block.name] = None
                continue
            initial = block_geometry(known, block, _sources(seen))
            points = len(initial.points_m)
            watch.message(f"{block.name}, {place + 1} of {len(blocks)}: {len(seen)} images, {points} points")
            one = _Block(block, seen, initial, layers, training, held_out)
            try:
                found[block.name] = self._train(one, task, folder, watch)
            except NoSupervisionError as error:
                barren = error
                # A corner of a street of which road users or the vehicle itself hide all: the rest can do without.
                watch.message(f"{block.name} is left out: masks cover every one of its images")
        outcomes = [outcome for outcome in found.values() if outcome is not None]
        if barren is not None and not outcomes:
            raise barren
        done = ReconstructionResult(
            folder=out,
            blocks=tuple(name for name, outcome in found.items() if outcome is not None),
            undone=tuple(name for name, outcome in found.items() if outcome is None),
            psnr_db=float(np.mean([one.psnr_db for one in outcomes])),
            steps=sum(one.steps for one in outcomes),
            core_s=sum(one.core_s for one in outcomes),
            wall_s=sum(one.wall_s for one in outcomes),
            gaussians=sum(one.gaussians for one in outcomes),
            model_bytes=sum(one.model_bytes for one in outcomes),
            pictures=len(training.views),
            driven_m=_length(own),
            points=layers.points,
        )
        if not done.undone:
            _finish(out, done)
        return done

    def open(self, model: Path, appearance: AppearancePolicy = AppearancePolicy()) -> Renderer:  # noqa: B008 - immutable
        """A renderer; see `InstalledMethod.open`.

        Raises:
            UsageError: the policy of the looks is not for this method.
            DatasetError: the folder holds no whole model of this method.
        """
        settings = type(self.settings(0))
        return NearestBlockRenderer(
            [open_block(folder, self.make, settings) for folder in block_folders(model)], appearance
        )

    def write(self, path: Path, block: Block, trainer: TrainableMethod, run: Run, *, half: bool) -> int:
        """Write what rendering needs, and say how many bytes that is."""
        return write_parameters(path, trainer.model, half=half)

    def _train(
        self, one: _Block, task: ReconstructionTask, folder: RunFolder, watch: ProgressReporter
    ) -> TrainingOutcome:
        run = self._run(one, task)
        done = folder.begin(run)
        if done is not None:
            watch.message(f"{folder.path} is done: {done.psnr_db:.2f} dB after {done.steps} steps")
            return done
        trainer = self.make(one.initial, self._settings(task))
        origin = np.array(one.block.origin_m)
        # Where it reads no depth, maps that others have made are not read either, unless they tell whose sky is meant.
        deep = one.layers.having("depth") if trainer.reads_depth or self.sky else frozenset()
        with folder.lock():
            folder.claim(run)
            try:
                return train(
                    trainer,
                    TrainingImageCache(one.layers.dataset, one.training.plan, origin, deep, sky=self.sky),
                    one.views,
                    Budget(task.steps, task.core_minutes),
                    folder,
                    lambda path: self.write(path, one.block, trainer, run, half=task.half),
                    seed=task.seed,
                    options=Options(
                        previews=one.previews(run, watch), title=f"{self.name}, {task.scene}, {one.block.name}"
                    ),
                    watch=watch,
                )
            except NoSupervisionError:
                # Remove it under the lock: without the lock, another run may have started in this folder.
                shutil.rmtree(folder.path)
                raise

    def _settings(self, task: ReconstructionTask) -> Any:
        return override_settings(self.settings(task.seed), task.settings)

    def _run(self, one: _Block, task: ReconstructionTask) -> Run:
        read = one.layers.dataset.layers
        settings = settings_document(self._settings(task))
        return Run(
            method=self.name,
            settings=settings,
            settings_hash=hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest(),
            seed=task.seed,
            steps=task.steps,
            core_minutes=task.core_minutes,
            threads=torch.get_num_threads(),
            scene=task.scene,
            split=task.split,
            block=one.block.name,
            origin_m=one.block.origin_m,
            radius_m=one.initial.radius_m,
            width_px=task.protocol.pixels.max_width_px,
            half=task.half,
            dataset_hash=one.training.plan.dataset_hash,
            plan_hash=one.training.plan.hash,
            depth=one.layers.depth,
            points=one.layers.points,
            poses=read.poses,
            calibrations=read.calibrations,
            stage=read.stage,
            pictures=len(one.views),
            withheld=tuple("/".join(map(str, image)) for image in sorted(task.withheld)),
            sources=trained_cameras(one.views),
        )


@dataclass(frozen=True, eq=False)
class _Block:
    """What one block is trained with."""

    block: Block
    views: tuple[RenderView, ...]
    initial: InitialGeometry
    layers: Layers
    training: TrainingViews
    held_out: Plan | None

    def previews(self, run: Run, watch: ProgressReporter) -> list[Preview]:
        """A few training and held-out images of the block; of what is held out, those that can be had."""
        shown = [("training", self.training.plan, self.views)]
        if self.held_out is not None:
            shown.append(("held-out", self.held_out, select_views(self.block, self.held_out.views)))
        # Training images have looks of their own.
        looks = AppearanceSelector(run.sources, "nearest", () if self.held_out is None else self.held_out.views)
        found = []
        for name, plan, views in shown:
            pictures = TrainingImageCache(self.layers.dataset, plan, np.array(self.block.origin_m))
            middles = (np.arange(_PREVIEWS) + 0.5) / _PREVIEWS * len(views)
            for number, place in enumerate(sorted(set(middles.astype(int).tolist())) if views else []):
                view = views[place]
                try:
                    image = pictures(view)
                except DatasetError as error:
                    if plan is not self.held_out:
                        raise
                    watch.message(f"not shown beside the others: {error}")
                    continue
                found.append(Preview(f"{name}-{number}", image, looks.select(view).colours[0][0]))
        return found


def block_folders(model: Path) -> list[Path]:
    """The folders of a model's blocks.

    Raises:
        DatasetError: a block is not done, or there is none.
    """
    done = read_reconstruction(model).done
    folders = sorted(path.parent for path in model.glob("*/run.json"))
    undone = [path for path in folders if RunFolder(path).outcome is None]
    if undone or done is None:
        raise DatasetError(
            f"{len(undone) or 'some'} blocks are not trained to the end", file=model,
            expected="a model", remedy="run the same `mirror reconstruct` again: it goes on where it stopped",
        )  # fmt: skip
    return folders


def _pictured_m(driven: Float64, views: Sequence[RenderView]) -> Float64:
    """Driven places (N, 3) at which images were taken: poses go on before the first and after the last of them."""
    cameras = np.array([view.pose.translation[0] for view in views])
    _, nearest = cKDTree(driven[:, :2]).query(cameras[:, :2])
    return driven[np.unique(nearest)]


def _sources(views: Sequence[RenderView]) -> list[Source]:
    return sorted({Source(view.traversal_id, view.camera) for view in views})


def _chosen(names: Sequence[str], asked: frozenset[str]) -> frozenset[str]:
    if asked - set(names):
        raise UsageError(
            f"no block {', '.join(sorted(asked - set(names)))}",
            place="--blocks",
            expected=f"some of {', '.join(names)}",
        )
    return asked or frozenset(names)


def _require_own(out: Path, document: Reconstruction) -> None:
    """See that a folder is a new one, or of the same task."""
    if require_output_folder(out, FolderKind.MODEL) is None:
        return
    before = read_reconstruction(out)
    if before.model_copy(update={"done": None}) != document:
        raise UsageError(
            f"a model of scene {before.scene}, split {before.split}, by {before.method} is there", file=out,
            remedy="name another folder with --out",
        )  # fmt: skip


def _finish(out: Path, done: ReconstructionResult) -> None:
    costs = Costs(model_bytes=done.model_bytes, driven_m=done.driven_m, core_s=done.core_s, wall_s=done.wall_s)
    write_json(out / DOCUMENT, read_reconstruction(out).model_copy(update={"done": costs}))


def _held_out(dataset: Dataset, task: ReconstructionTask, watch: ProgressReporter) -> Plan | None:
    """Views of what is held out of the scene, to look at: nothing is learnt from them. None: there are none."""
    roles = ("held_out", "test")
    own = dataset.where(scene=task.scene)
    groups = tuple(one for one in task.protocol.groups if set(one.roles) <= set(roles) and not one.ego_shift_m)
    if set(own.roles(task.split)).isdisjoint(roles):
        groups = ()
    if task.withheld:
        groups = (*groups, Group(name="withheld", roles=("train",)))
    try:
        return plan_views(own, task.protocol.model_copy(update={"groups": groups}), task.split) if groups else None
    except DatasetError as error:
        # Training can do without.
        watch.message(f"held-out images are not shown: {error}")
        return None


def _length(dataset: Dataset) -> float:
    """Length of the longest driven line of a view's traversals: that of the road, if all drive along it."""
    lengths = [0.0]
    for traversal in dataset.traversals():
        places: Float64 = driven_m(dataset.where(traversal=traversal))
        lengths.append(float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum()))
    return max(lengths)
