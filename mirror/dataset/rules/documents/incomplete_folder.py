"""DS006."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule
from mirror.dataset.layout import MANIFEST


@dataset_rule("DS006", Severity.WARNING, remedy="run the same `mirror ingest` again: it finishes or removes the folder")
def incomplete_folder(view: DatasetView) -> Iterator[Finding]:
    """A folder has no manifest: a run was interrupted there, and readers pass it over."""
    for folder in view.sealed_folders():
        if not (folder / MANIFEST).is_file():
            yield Finding(view.name(folder), MANIFEST, "missing: the folder is not complete")
