"""The layers of depth and points that a reconstruction reads; missing layers are estimated."""

from __future__ import annotations

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
from mirror.schema.hashing import hash_document

GIVEN: Final = "dataset"
PLANE_SWEEP: Final = "plane-sweep"

Kind: TypeAlias = Literal["depth", "points"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)


@dataclass(frozen=True)
class Layers:
    """The layers that a reconstruction reads.

    Attributes:
        dataset: a view of the dataset that reads these layers.
        depth: ``source@version``, or None where there is no depth.
        points: ``source@version``, or None where there are no points.
    """

    dataset: Dataset
    depth: str | None
    points: str | None

    def traversals_with(self, kind: Kind) -> frozenset[str]:
        """Return the traversals that have the layer of a kind."""
        return _traversals_with(self.dataset, kind, getattr(self, kind))

    def traversals_without(self, kind: Kind, traversals: Sequence[str]) -> list[str]:
        """List the given traversals that lack the layer of a kind; empty if no layer of that kind is read."""
        return [] if getattr(self, kind) is None else sorted(set(traversals) - self.traversals_with(kind))


def layers_for(dataset: Dataset, task: ReconstructionTask, progress: ProgressReporter) -> Layers:
    """Select or estimate the layers of a task, for the training traversals of its scene.

    Args:
        dataset: the complete dataset.
        task: the task.
        progress: receives the progress of the estimation.

    Raises:
        UsageError: there are several layers and none is named, or the name is neither a layer nor an estimator.
        DatasetError: the layers cannot be estimated.
    """
    method = layer_source(dataset, task)
    if method not in get_args(Method):
        return _select_given(dataset, task) if method == GIVEN else _named_layers(dataset, task, method)
    estimated = initialise(
        dataset.where(scene=task.scene),
        task.split,
        method=method,
        width_px=task.protocol.pixels.max_width_px,
        version=_version(dataset, task),
        withheld=task.withheld,
        device=task.device,
        progress=progress,
    )
    reopened = replace(mirror.open(dataset.root), layers=replace(dataset.layers, depth=None, points=None))
    depth, points = (
        estimated.layer if estimated.layer in _layer_names(reopened, task, kind) else None
        for kind in ("depth", "points")
    )
    return Layers(reopened.with_layers(depth=depth, points=points), depth, points)


def layer_source(dataset: Dataset, task: ReconstructionTask) -> str:
    """Return the source of the layers if a task does not name one: ``dataset`` or an estimator."""
    is_given = _given_layers(dataset, task, "points") and not task.withheld
    return task.initialise or (GIVEN if is_given else PLANE_SWEEP)


def has_estimated_points(dataset: Dataset, task: ReconstructionTask) -> bool:
    """Return whether all training traversals of a task's scene have the points that `layers_for` would estimate."""
    training = _training_view(dataset, task)
    return set(training.traversals()) <= _traversals_with(
        training, "points", f"{task.initialise or PLANE_SWEEP}@{_version(dataset, task)}"
    )


def _traversals_with(dataset: Dataset, kind: Kind, name: str | None) -> frozenset[str]:
    rows = dataset.table("traversals", ["traversal_id", "layers"]).to_pylist()
    return frozenset(row["traversal_id"] for row in rows if f"{kind}/{name}" in row["layers"])


def _training_view(dataset: Dataset, task: ReconstructionTask) -> Dataset:
    return dataset.where(scene=task.scene, split=task.split, role="train")


def _version(dataset: Dataset, task: ReconstructionTask) -> str:
    """Version of the estimated layers; it differs for other training images, calibrations and another width."""
    calibrations = dataset.layers.calibrations
    placed = "" if calibrations == "recorded" else f"-{calibrations.replace('@', '-')}"
    return f"{task.split}-{task.protocol.pixels.max_width_px}{placed}{_withheld_suffix(task.withheld)}"


def _withheld_suffix(withheld: Set[ImageKey]) -> str:
    digest = hash_document(sorted(withheld))
    return f"-without-{len(withheld)}-{digest[:8]}" if withheld else ""


def _layer_names(dataset: Dataset, task: ReconstructionTask, kind: str) -> set[str]:
    names = {
        name
        for row in _training_view(dataset, task).table("traversals", ["layers"]).column(0).to_pylist()
        for name in row
    }
    return {name.partition("/")[2] for name in names if name.startswith(f"{kind}/")}


def _given_layers(dataset: Dataset, task: ReconstructionTask, kind: str) -> set[str]:
    """Layers that no estimator of this project made; estimated ones may use images that another split holds out."""
    return {name for name in _layer_names(dataset, task, kind) if name.partition("@")[0] not in get_args(Method)}


def _select_given(dataset: Dataset, task: ReconstructionTask) -> Layers:
    """The chosen layers or the only ones, among the given layers if these include points."""
    names = _given_layers if _given_layers(dataset, task, "points") else _layer_names
    depth, points = (_select_layer(dataset, kind, names(dataset, task, kind)) for kind in ("depth", "points"))
    return Layers(dataset.with_layers(depth=depth, points=points), depth, points)


def _select_layer(dataset: Dataset, kind: str, names: Set[str]) -> str | None:
    chosen: str | None = getattr(dataset.layers, kind)
    if chosen in names:
        return chosen
    if chosen is None and len(names) > 1:
        raise UsageError(
            f"{len(names)} layers of {kind}: {', '.join(sorted(names))}", file=dataset.root,
            expected="one that is chosen", remedy="name it: --initialise SOURCE@VERSION",
        )  # fmt: skip
    return min(names, default=None)


def _named_layers(dataset: Dataset, task: ReconstructionTask, name: str) -> Layers:
    """The layers of depth and points of one name."""
    depth, points = (name if name in _layer_names(dataset, task, kind) else None for kind in ("depth", "points"))
    if points is None:
        names = sorted(_layer_names(dataset, task, "points"))
        raise UsageError(
            f"no layer of points is called {name!r}", place="--initialise", file=dataset.root,
            expected=f"one of {', '.join((*get_args(Method), GIVEN, *names))}",
        )  # fmt: skip
    return Layers(dataset.with_layers(depth=depth, points=points), depth, points)
