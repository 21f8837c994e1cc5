"""SPL006."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule
from mirror.dataset.rules.splits.leak_findings import leak_findings


@dataset_rule("SPL006", Severity.ERROR, remedy="make the split anew: `mirror split DATASET NAME --replace`")
def ground_leak(view: DatasetView) -> Iterator[Finding]:
    """The same ground, one scene or two that overlap, is in two roles of a split by scene."""
    yield from leak_findings(view, "scene", "area")
