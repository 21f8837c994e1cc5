"""SPL007."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule


@dataset_rule("SPL007", Severity.WARNING, remedy="make the split anew: `mirror split DATASET NAME --replace`")
def split_stale(view: DatasetView) -> Iterator[Finding]:
    """A traversal was recorded anew after a split was frozen."""
    for name, split in view.splits.items():
        there = {key: view.recorded_manifests[key] for key in split.manifests if key in view.recorded_manifests}
        changed = [key for key, manifest in there.items() if manifest.content != split.manifests[key]]
        if changed:
            yield Finding(f"splits/{name}.json", f"manifests.{changed[0]}", "other files were recorded", len(changed))
