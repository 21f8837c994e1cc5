"""FIL002."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Cost, Finding, Severity, dataset_rule


@dataset_rule(
    "FIL002", Severity.ERROR, cost=Cost.FILES, remedy="run the same `mirror ingest` again; for index/: `mirror index`"
)
def file_size(view: DatasetView) -> Iterator[Finding]:
    """A file has another size than its manifest says."""
    for path, entry in view.listed_files():
        if path.is_file() and (size := path.stat().st_size) != entry.bytes:
            yield Finding(view.name(path), None, f"{size} bytes, but the folder's manifest says {entry.bytes}")
