"""The layers of depth and points that a reconstruction reads; they are made where they are absent."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias, get_args

import mirror
from hybridworldsim.mvs.methods import Method
from hybridworldsim.mvs.run import initialise
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.methods.plugin import ReconstructionTask
from mirror.methods.training_images import ImageKey
from mirror.progress import ProgressReporter

BROUGHT: Final = "dataset"
PLANE_SWEEP: Final = "plane-sweep"

Kind: TypeAlias = Literal["depth", "points"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)


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

    def having(self, kind: Kind) -> frozenset[str]:
        """Traversals that have the layer of a kind."""
        return _having(self.dataset, kind, getattr(self, kind))

    def lacking(self, kind: Kind, traversals: Sequence[str]) -> list[str]:
        """Those of some traversals that have no layer of a kind; none, if nothing of that kind is read."""
        return [] if getattr(self, kind) is None else sorted(set(traversals) - self.having(kind))


def layers_for(dataset: Dataset, task: ReconstructionTask, progress: ProgressReporter) -> Layers:
    """The layers that a task asks for, of the training traversals of its scene.

    Args:
        dataset: the whole of it.
        task: what is asked.
        progress: told of the making.

    Raises:
        UsageError: there are several and none is named, or there is neither an estimator nor a layer of that name.
        DatasetError: they cannot be made.
    """
    method = method_of(dataset, task)
    if method not in get_args(Method):
        return _brought_layers(dataset, task) if method == BROUGHT else _named(dataset, task, method)
    done = initialise(
        dataset.where(scene=task.scene),
        task.split,
        method=method,
        width_px=task.protocol.pixels.max_width_px,
        version=_version(task),
        withheld=task.withheld,
        progress=progress,
    )
    made = replace(mirror.open(dataset.root), layers=replace(dataset.layers, depth=None, points=None))
    depth, points = (done.layer if done.layer in _there(made, task, kind) else None for kind in ("depth", "points"))
    return Layers(made.with_layers(depth=depth, points=points), depth, points)


def method_of(dataset: Dataset, task: ReconstructionTask) -> str:
    """Where layers come from, if a task does not say: ``dataset`` or an estimator."""
    brings = _brought(dataset, task, "points") and not task.withheld
    return task.initialise or (BROUGHT if brings else PLANE_SWEEP)


def are_made(dataset: Dataset, task: ReconstructionTask) -> bool:
    """Whether all training traversals of a task's scene have the points that `layers_for` would make."""
    own = _training(dataset, task)
    return set(own.traversals()) <= _having(own, "points", f"{task.initialise or PLANE_SWEEP}@{_version(task)}")


def _having(dataset: Dataset, kind: Kind, name: str | None) -> frozenset[str]:
    rows = dataset.table("traversals", ["traversal_id", "layers"]).to_pylist()
    return frozenset(row["traversal_id"] for row in rows if f"{kind}/{name}" in row["layers"])


def _training(dataset: Dataset, task: ReconstructionTask) -> Dataset:
    return dataset.where(scene=task.scene, split=task.split, role="train")


def _version(task: ReconstructionTask) -> str:
    """Of other training images or another width they are other layers."""
    return f"{task.split}-{task.protocol.pixels.max_width_px}{_without(task.withheld)}"


def _without(withheld: Set[ImageKey]) -> str:
    named = hashlib.sha256(json.dumps(sorted(withheld)).encode()).hexdigest()
    return f"-without-{len(withheld)}-{named[:8]}" if withheld else ""


def _there(dataset: Dataset, task: ReconstructionTask, kind: str) -> set[str]:
    names = {
        name for row in _training(dataset, task).table("traversals", ["layers"]).column(0).to_pylist() for name in row
    }
    return {name.partition("/")[2] for name in names if name.startswith(f"{kind}/")}


def _brought(dataset: Dataset, task: ReconstructionTask, kind: str) -> set[str]:
    """Layers that no estimator of ours made: those may know the images that another split holds out."""
    return {name for name in _there(dataset, task, kind) if name.partition("@")[0] not in get_args(Method)}


def _brought_layers(dataset: Dataset, task: ReconstructionTask) -> Layers:
    """The layers that are chosen, or the only ones: of what was brought, if there are points of that."""
    there = _brought if _brought(dataset, task, "points") else _there
    depth, points = (_only(dataset, kind, there(dataset, task, kind)) for kind in ("depth", "points"))
    return Layers(dataset.with_layers(depth=depth, points=points), depth, points)


def _only(dataset: Dataset, kind: str, there: Set[str]) -> str | None:
    chosen: str | None = getattr(dataset.layers, kind)
    if chosen in there:
        return chosen
    if chosen is None and len(there) > 1:
        raise UsageError(
            f"{len(there)} layers of {kind}: {', '.join(sorted(there))}", file=dataset.root,
            expected="one that is chosen", remedy="name it: --initialise SOURCE@VERSION",
        )  # fmt: skip
    return min(there, default=None)


def _named(dataset: Dataset, task: ReconstructionTask, name: str) -> Layers:
    """Depth and points of one name."""
    depth, points = (name if name in _there(dataset, task, kind) else None for kind in ("depth", "points"))
    if points is None:
        there = sorted(_there(dataset, task, "points"))
        raise UsageError(
            f"no layer of points is called {name!r}", place="--initialise", file=dataset.root,
            expected=f"one of {', '.join((*get_args(Method), BROUGHT, *there))}",
        )  # fmt: skip
    return Layers(dataset.with_layers(depth=depth, points=points), depth, points)
