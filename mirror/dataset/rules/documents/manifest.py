"""DS005."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.problems import unread
from mirror.dataset.check.rule import Finding, Severity, dataset_rule


@dataset_rule("DS005", Severity.ERROR, remedy="run the same `mirror ingest` again, or write the layer again")
def manifest(view: DatasetView) -> Iterator[Finding]:
    """A manifest.json is broken."""
    _ = view.folder_manifests
    yield from unread(view.problems, lambda file: file.endswith("/manifest.json") and not file.startswith("index/"))
