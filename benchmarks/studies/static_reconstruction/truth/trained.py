"""Models that jobs have trained, opened again."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, TypeVar

import numpy as np

from benchmarks.studies.static_reconstruction.declared import Declared
from benchmarks.studies.static_reconstruction.job import RUNS, Job
from benchmarks.studies.static_reconstruction.methods import Entry, entries
from benchmarks.studies.static_reconstruction.truth.asked import Asked, asked
from benchmarks.studies.static_reconstruction.truth.street import StreetTruth
from hybridworldsim.methods.opened import Renderer
from hybridworldsim.methods.static import block_folders
from hybridworldsim.training.run.folder import MODEL, TrainedCamera, read_run
from mirror.errors import UsageError
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.model_document import Costs, read_reconstruction
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import View

_NAME: Final = re.compile(
    r"(?P<entry>.+)\.(?P<scene>[a-z][a-z-]*)\.(?P<minutes>[\d.]+)min\.(?P<width>\d+)px\.(?P<seed>\d+)"
)

FRAMES: Final = 4
"""Of each traversal are looked at."""

_Thing = TypeVar("_Thing")


def spread(things: Sequence[_Thing], most: int) -> list[_Thing]:
    """At most so many of things, evenly chosen, the first and the last among them."""
    places = np.unique(np.linspace(0, len(things) - 1, min(len(things), most)).round().astype(int))
    return [things[place] for place in places]


def job_of(name: str) -> Job:
    """The job whose folder has a name.

    Raises:
        UsageError: no job is called so.
    """
    found = _NAME.fullmatch(name)
    if found is None:
        raise UsageError(f"a run called {name!r}", expected="ENTRY.SCENE.MINUTESmin.WIDTHpx.SEED")
    return Job(found["entry"], found["scene"], int(found["seed"]), float(found["minutes"]), int(found["width"]))


def done_jobs(folder: Path) -> list[Job]:
    """Jobs whose models are trained to the end, by name."""
    models = sorted((folder / RUNS).glob("*/reconstruction.json"))
    return [job_of(path.parent.name) for path in models if read_reconstruction(path.parent).done is not None]


@dataclass(frozen=True, eq=False)
class Trained:
    """A trained model with the views that it is asked for.

    Attributes:
        job: that trained it.
        folder: of the comparison.
        declaration: of the comparison.
    """

    job: Job
    folder: Path
    declaration: Declared

    @property
    def model(self) -> Path:
        """Folder of the model."""
        return self.folder / RUNS / self.job.name

    @property
    def entry(self) -> Entry:
        """Row of the comparison."""
        return entries()[self.job.entry]

    @property
    def plan(self) -> Plan:
        """Views of training and of held-out traversals."""
        return self._asked.plan

    @property
    def street(self) -> StreetTruth:
        """What is exactly known."""
        return self._asked.street

    @cached_property
    def _asked(self) -> Asked:
        split = self.entry.split or self.declaration.split
        return asked(self.folder, self.declaration, self.job.scene, split, self.job.width_px)

    @cached_property
    def seen(self) -> tuple[TrainedCamera, ...]:
        """What the first block was trained on."""
        return read_run(block_folders(self.model)[0]).sources

    @cached_property
    def costs(self) -> Costs:
        """What the model costs.

        Raises:
            UsageError: it is not trained to the end.
        """
        done = read_reconstruction(self.model).done
        if done is None:
            raise UsageError(
                "not trained to the end", file=self.model, remedy="python -m benchmarks reconstruction run"
            )
        return done

    @property
    def hash(self) -> str:
        """SHA-256 of all blocks."""
        whole = hashlib.sha256()
        for block in block_folders(self.model):
            whole.update((block / MODEL).read_bytes())
        return whole.hexdigest()

    def views(self, group: str) -> list[View]:
        """Of the plan, those of a group: of each traversal a few frames, evenly chosen, with all their cameras."""
        own = self._asked.views(group)
        frames: dict[str, list[int]] = {}
        for view in own:
            frames.setdefault(view.traversal_id, []).append(view.frame_index)
        chosen = {traversal: set(spread(sorted(set(there)), FRAMES)) for traversal, there in frames.items()}
        return [view for view in own if view.frame_index in chosen[view.traversal_id]]

    def open(self, policy: str | None = None, *, everywhere: bool = False) -> Renderer:
        """Its renderer; pictures look as declared, or as a policy says."""
        looking = AppearancePolicy(policy or self.declaration.policy, self.plan.views, everywhere)
        return self.entry.method.open(self.model, looking)
