"""Trained models of jobs, opened for measurement."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, TypeVar

import numpy as np

from benchmarks.studies.static_reconstruction.declaration import Declaration
from benchmarks.studies.static_reconstruction.jobs import Job, model_folder, models_folder, parse_job
from benchmarks.studies.static_reconstruction.methods import Entry, entries
from benchmarks.studies.static_reconstruction.truth.request import TruthRequest, request_truth
from benchmarks.studies.static_reconstruction.truth.street import StreetTruth
from hybridworldsim.methods.renderers import BlockRenderer
from hybridworldsim.methods.static import block_folders
from hybridworldsim.training.documents import TrainedCamera, read_run
from hybridworldsim.training.run.folder import MODEL
from mirror.errors import UsageError
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.model_document import Costs, read_reconstruction
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView

FRAMES: Final = 4
"""Frames of each traversal that are measured."""

_Item = TypeVar("_Item")


def evenly_chosen(items: Sequence[_Item], most: int) -> list[_Item]:
    """Return at most `most` items, evenly chosen, with the first and the last."""
    places = np.unique(np.linspace(0, len(items) - 1, min(len(items), most)).round().astype(int))
    return [items[place] for place in places]


def done_jobs(folder: Path) -> list[Job]:
    """Return the jobs whose models are fully trained, by name."""
    models = sorted(models_folder(folder).glob("*/reconstruction.json"))
    return [parse_job(path.parent.name) for path in models if read_reconstruction(path.parent).done is not None]


@dataclass(frozen=True, eq=False)
class TrainedModel:
    """A trained model with the views that it renders.

    Attributes:
        job: that trained it.
        folder: working folder of the study.
        declaration: of the study.
    """

    job: Job
    folder: Path
    declaration: Declaration

    @property
    def model(self) -> Path:
        """Folder of the model."""
        return model_folder(self.folder, self.job)

    @property
    def entry(self) -> Entry:
        """Row of the comparison."""
        return entries()[self.job.entry]

    @property
    def plan(self) -> Plan:
        """Views of training and of held-out traversals."""
        return self._request.plan

    @property
    def street(self) -> StreetTruth:
        """Exact truth of the views."""
        return self._request.street

    @cached_property
    def _request(self) -> TruthRequest:
        split = self.entry.split or self.declaration.split
        return request_truth(self.folder, self.declaration, self.job.scene, split, self.job.width_px)

    @cached_property
    def training_sources(self) -> tuple[TrainedCamera, ...]:
        """Traversals and cameras that the first block was trained on."""
        return read_run(block_folders(self.model)[0]).sources

    @cached_property
    def costs(self) -> Costs:
        """Training costs and size of the model.

        Raises:
            UsageError: it is not fully trained.
        """
        done = read_reconstruction(self.model).done
        if done is None:
            raise UsageError(
                "not fully trained", file=self.model, remedy="python -m benchmarks static_reconstruction run"
            )
        return done

    @property
    def hash(self) -> str:
        """SHA-256 of all blocks."""
        whole = hashlib.sha256()
        for block in block_folders(self.model):
            whole.update((block / MODEL).read_bytes())
        return whole.hexdigest()

    def views(self, group: str) -> list[RenderView]:
        """Return the views of a group: a few evenly chosen frames of each traversal, with all their cameras."""
        own = self._request.views(group)
        frames: dict[str, list[int]] = {}
        for view in own:
            frames.setdefault(view.traversal_id, []).append(view.frame_index)
        chosen = {traversal: set(evenly_chosen(sorted(set(there)), FRAMES)) for traversal, there in frames.items()}
        return [view for view in own if view.frame_index in chosen[view.traversal_id]]

    def open(self, policy: str | None = None, *, everywhere: bool = False) -> BlockRenderer:
        """Return the renderer of the model, with the declared appearance or that of a policy."""
        appearance = AppearancePolicy(policy or self.declaration.policy, self.plan.views, everywhere)
        return self.entry.method.open(self.model, appearance)
