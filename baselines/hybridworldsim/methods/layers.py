"""The layers of depth and points that a reconstruction reads; they are made where they are absent."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Set
from dataclasses import dataclass, replace

import mirror
from hybridworldsim.mvs.run import initialise
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.evaluation.methods import Task
from mirror.evaluation.progress import Progress
from mirror.evaluation.training import Picture

BROUGHT = "dataset"


@dataclass(frozen=True)
class Layers:
    """What is read.

    Attributes:
        dataset: that reads these layers.
        depth: ``source@version``; None: there is none.
        points: ``source@version``; None: there is none.
    """

    dataset: Dataset
    depth: str | None
    points: str | None


def layers_for(dataset: Dataset, task: Task, progress: Progress) -> Layers:
    """The layers that a task asks for, of the training traversals of its scene.

    Args:
        dataset: the whole of it.
        task: what is asked.
        progress: told of the making.

    Raises:
        UsageError: there are several and none is named, or the estimator is not known.
        DatasetError: they cannot be made.
    """
    if task.initialise == BROUGHT:
        return Layers(dataset, *(_only(dataset, task, kind) for kind in ("depth", "points")))
    done = initialise(
        dataset.where(scene=task.scene),
        task.split,
        method=task.initialise,
        width_px=task.protocol.pixels.max_width_px,
        version=_version(task),
        withheld=task.withheld,
        progress=progress,
    )
    made = replace(mirror.open(dataset.root), layers=replace(dataset.layers, depth=None, points=None))
    depth, points = (done.layer if done.layer in _there(made, task, kind) else None for kind in ("depth", "points"))
    return Layers(made.with_layers(depth=depth, points=points), depth, points)


def are_made(dataset: Dataset, task: Task) -> bool:
    """Whether all training traversals of a task's scene have the points that `layers_for` would make."""
    own = dataset.where(scene=task.scene, split=task.split, role="train")
    wanted = f"points/{task.initialise}@{_version(task)}"
    return all(wanted in row for row in own.table("traversals", ["layers"]).column(0).to_pylist())


def _version(task: Task) -> str:
    """Of other training pictures or another width they are other layers."""
    return f"{task.split}-{task.protocol.pixels.max_width_px}{_without(task.withheld)}"


def _without(withheld: Set[Picture]) -> str:
    named = hashlib.sha256(json.dumps(sorted(withheld)).encode()).hexdigest()
    return f"-without-{len(withheld)}-{named[:8]}" if withheld else ""


def _there(dataset: Dataset, task: Task, kind: str) -> set[str]:
    own = dataset.where(scene=task.scene, split=task.split, role="train")
    names = {name for row in own.table("traversals", ["layers"]).column(0).to_pylist() for name in row}
    return {name.partition("/")[2] for name in names if name.startswith(f"{kind}/")}


def _only(dataset: Dataset, task: Task, kind: str) -> str | None:
    """The chosen layer of a kind, or the only one."""
    chosen: str | None = getattr(dataset.layers, kind)
    there = sorted(_there(dataset, task, kind))
    if chosen is None and len(there) > 1:
        raise UsageError(
            f"{len(there)} layers of {kind}: {', '.join(there)}", file=dataset.root,
            expected="one that is chosen", remedy="name what made them: --initialise NAME",
        )  # fmt: skip
    return chosen if chosen in there else (there[0] if there else None)
