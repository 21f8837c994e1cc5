"""IDX001."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.problems import unread
from mirror.dataset.check.rule import Finding, Severity, dataset_rule


@dataset_rule("IDX001", Severity.ERROR, remedy="run `mirror index`")
def index_there(view: DatasetView) -> Iterator[Finding]:
    """There is no index, or its manifest is broken: the dataset cannot be opened."""
    if view.index_manifest is None:
        broken = list(unread(view.problems, lambda file: file == "index/manifest.json"))
        yield from broken or [Finding("index", None, "there is no index")]
