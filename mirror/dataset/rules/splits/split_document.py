"""SPL001."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.problems import unread
from mirror.dataset.check.rule import Finding, Severity, dataset_rule


@dataset_rule(
    "SPL001", Severity.ERROR, remedy="restore the file, or make the split anew: `mirror split DATASET NAME --replace`"
)
def split_document(view: DatasetView) -> Iterator[Finding]:
    """A split's file is broken, or holds another split's name."""
    for name, split in view.splits.items():
        if split.name != name:
            yield Finding(f"splits/{name}.json", "name", f"holds split {split.name!r}")
    yield from unread(view.problems, lambda file: file.startswith("splits/"))
