"""SPL008."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule


@dataset_rule("SPL008", Severity.INFO, remedy="put them in train: `mirror split DATASET NAME --extend`")
def split_outside(view: DatasetView) -> Iterator[Finding]:
    """Traversals came after a split was frozen, and are not in it."""
    for name, split in view.splits.items():
        scenes = split.scenes
        outside = [
            key
            for key in view.named
            if key not in split.assignments and (scenes is None or key.partition(".")[0] in scenes)
        ]
        if outside:
            yield Finding(f"splits/{name}.json", None, f"{len(outside)} traversals, such as {outside[0]}", len(outside))
