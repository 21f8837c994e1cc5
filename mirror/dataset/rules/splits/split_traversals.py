"""SPL002."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule


@dataset_rule(
    "SPL002",
    Severity.ERROR,
    remedy="make the split anew: `mirror split DATASET NAME --replace`, or run the same `mirror ingest` again",
)
def split_traversals(view: DatasetView) -> Iterator[Finding]:
    """A split assigns a traversal that the dataset does not have."""
    for name, split in view.splits.items():
        lost = [key for key in split.assignments if key not in view.named]
        if lost:
            yield Finding(f"splits/{name}.json", f"assignments.{lost[0]}", "no such traversal", len(lost))
