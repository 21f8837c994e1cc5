"""SPL007."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule


@dataset_rule("SPL007", Severity.WARNING, remedy="make the split anew: `mirror split --replace`")
def split_stale(view: DatasetView) -> Iterator[Finding]:
    """A traversal was recorded anew after a split was frozen."""
    for name, split in view.splits.items():
        changed = [key for key, value in split.manifests.items() if view.named.get(key, ("", value))[1] != value]
        if changed:
            yield Finding(f"splits/{name}.json", f"manifests.{changed[0]}", "another recorded manifest", len(changed))
