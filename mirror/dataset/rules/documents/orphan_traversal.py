"""DS008."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule


@dataset_rule("DS008", Severity.WARNING, remedy="run the same `mirror ingest` again, or remove the folder")
def orphan_traversal(view: DatasetView) -> Iterator[Finding]:
    """A traversal is complete, but no drive names it, so that readers pass it over."""
    for traversal_id in view.recorded_manifests:
        if traversal_id not in view.named:
            yield Finding(f"traversals/{traversal_id}", None, "no drive's manifest names this traversal")
