"""DS013."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule


@dataset_rule("DS013", Severity.INFO, remedy="write the licence into dataset.json before the dataset is passed on")
def licence(view: DatasetView) -> Iterator[Finding]:
    """The dataset states no licence."""
    if view.document is not None and not view.document.licence:
        yield Finding("dataset.json", "licence", "null")
