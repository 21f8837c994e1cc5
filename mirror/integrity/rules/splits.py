"""Rules of SPL: splits and their leaks."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.splits.leaks import TieKind, find_leaks
from mirror.integrity.dataset_view import DatasetView
from mirror.integrity.finding import Finding, Severity
from mirror.integrity.problems import report_unreadable
from mirror.integrity.rule import dataset_rule
from mirror.schema.documents import ByScene


def leak_findings(view: DatasetView, *kinds: TieKind) -> Iterator[Finding]:
    """Yield a finding for each split with a leak of a kind: the first leak, and their number.

    Scenes and their ground count only in splits by scene: in the others all traversals of a scene share it.
    """
    for name, split in view.splits.items():
        wanted = [kind for kind in kinds if kind not in ("scene", "area") or isinstance(split.parameters, ByScene)]
        found = find_leaks((tie for tie in view.ties if tie.kind in wanted), split.assignments)
        if found:
            yield Finding(f"splits/{name}.json", f"{found[0].first}, {found[0].second}", str(found[0]), len(found))


@dataset_rule(
    "SPL001",
    Severity.ERROR,
    title="A split's file is broken, or holds another split's name.",
    remedy="restore the file, or make the split again: `mirror split DATASET NAME --replace`",
)
def _split_document(view: DatasetView) -> Iterator[Finding]:
    for name, split in view.splits.items():
        if split.name != name:
            yield Finding(f"splits/{name}.json", "name", f"holds split {split.name!r}")
    yield from report_unreadable(view.problems, lambda file: file.startswith("splits/"))


@dataset_rule(
    "SPL002",
    Severity.ERROR,
    title="A split assigns a traversal that the dataset does not have.",
    remedy="make the split again: `mirror split DATASET NAME --replace`, or run the same `mirror ingest` again",
)
def _split_traversals(view: DatasetView) -> Iterator[Finding]:
    for name, split in view.splits.items():
        lost = [key for key in split.assignments if key not in view.named_traversals]
        if lost:
            yield Finding(f"splits/{name}.json", f"assignments.{lost[0]}", "no such traversal", len(lost))


@dataset_rule(
    "SPL003",
    Severity.ERROR,
    title="One drive is in two roles of a split.",
    remedy="make the split again: `mirror split DATASET NAME --replace`",
)
def _drive_leak(view: DatasetView) -> Iterator[Finding]:
    yield from leak_findings(view, "drive")


@dataset_rule(
    "SPL004",
    Severity.ERROR,
    title="The same image is in two roles of a split.",
    remedy="make the split again: `mirror split DATASET NAME --replace`",
)
def _image_leak(view: DatasetView) -> Iterator[Finding]:
    yield from leak_findings(view, "bytes")


@dataset_rule(
    "SPL005",
    Severity.ERROR,
    title="One vehicle is in two roles of a split at the same time.",
    remedy="make the split again: `mirror split DATASET NAME --replace`",
)
def _time_leak(view: DatasetView) -> Iterator[Finding]:
    yield from leak_findings(view, "time")


@dataset_rule(
    "SPL006",
    Severity.ERROR,
    title="The same ground, one scene or two that overlap, is in two roles of a split by scene.",
    remedy="make the split again: `mirror split DATASET NAME --replace`",
)
def _ground_leak(view: DatasetView) -> Iterator[Finding]:
    yield from leak_findings(view, "scene", "area")


@dataset_rule(
    "SPL007",
    Severity.WARNING,
    title="A traversal was recorded again after a split was frozen.",
    remedy="make the split again: `mirror split DATASET NAME --replace`",
)
def _split_stale(view: DatasetView) -> Iterator[Finding]:
    for name, split in view.splits.items():
        there = {key: view.recorded_manifests[key] for key in split.manifests if key in view.recorded_manifests}
        changed = [key for key, manifest in there.items() if manifest.content != split.manifests[key]]
        if changed:
            yield Finding(f"splits/{name}.json", f"manifests.{changed[0]}", "other files were recorded", len(changed))


@dataset_rule(
    "SPL008",
    Severity.INFO,
    title="Traversals were added after a split was frozen, and are not in it.",
    remedy="put them in train: `mirror split DATASET NAME --extend`",
)
def _split_outside(view: DatasetView) -> Iterator[Finding]:
    for name, split in view.splits.items():
        scenes = split.scenes
        outside = [
            key
            for key in view.named_traversals
            if key not in split.assignments and (scenes is None or key.partition(".")[0] in scenes)
        ]
        if outside:
            yield Finding(f"splits/{name}.json", None, f"{len(outside)} traversals, such as {outside[0]}", len(outside))
