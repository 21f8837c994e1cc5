"""DS001."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.problems import unread
from mirror.dataset.check.rule import Finding, Severity, dataset_rule


@dataset_rule("DS001", Severity.ERROR, remedy="restore dataset.json, or ingest into a new folder")
def dataset_document(view: DatasetView) -> Iterator[Finding]:
    """dataset.json is broken, or of a schema version that cannot be read."""
    if view.document is None:
        yield from unread(view.problems, lambda file: file == "dataset.json")
