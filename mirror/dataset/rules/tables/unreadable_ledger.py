"""TAB002."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.problems import unread
from mirror.dataset.check.rule import Finding, Severity, dataset_rule


@dataset_rule("TAB002", Severity.ERROR, remedy="run the same `mirror ingest` again; for index/: `mirror index --force`")
def unreadable_ledger(view: DatasetView) -> Iterator[Finding]:
    """A ledger or the index's list of row groups cannot be read, as in TAB001."""
    _ = view.passes, view.index_row_groups
    yield from unread(view.problems, lambda file: file.endswith(".parquet") and not file.startswith("traversals/"))
