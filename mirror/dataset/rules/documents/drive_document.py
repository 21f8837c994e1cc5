"""DS004."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.problems import unread
from mirror.dataset.check.rule import Finding, Severity, dataset_rule


@dataset_rule("DS004", Severity.ERROR, remedy="run the same `mirror ingest` again")
def drive_document(view: DatasetView) -> Iterator[Finding]:
    """A drive.json is missing or broken, or in the folder of another drive."""
    for name, document in view.drives.items():
        if document.drive_id != name:
            yield Finding(f"drives/{name}/drive.json", "drive_id", f"holds drive {document.drive_id!r}")
    yield from unread(view.problems, lambda file: file.endswith("/drive.json"))
