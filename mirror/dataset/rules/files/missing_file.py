"""FIL001."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Cost, Finding, Severity, dataset_rule


@dataset_rule(
    "FIL001", Severity.ERROR, cost=Cost.FILES, remedy="run the same `mirror ingest` again; for index/: `mirror index`"
)
def missing_file(view: DatasetView) -> Iterator[Finding]:
    """A file that a manifest lists is missing."""
    for path, _ in view.listed_files():
        if not path.is_file():
            yield Finding(view.name(path), None, "missing, but the folder's manifest lists it")
