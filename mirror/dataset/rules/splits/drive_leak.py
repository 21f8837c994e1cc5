"""SPL003."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule
from mirror.dataset.rules.splits.leak_findings import leak_findings


@dataset_rule("SPL003", Severity.ERROR, remedy="make the split anew: `mirror split DATASET NAME --replace`")
def drive_leak(view: DatasetView) -> Iterator[Finding]:
    """One drive is in two roles of a split."""
    yield from leak_findings(view, "drive")
