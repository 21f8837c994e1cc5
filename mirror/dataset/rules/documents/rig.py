"""DS003."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.problems import unread
from mirror.dataset.check.rule import Finding, Severity, dataset_rule


@dataset_rule("DS003", Severity.ERROR, remedy="restore the file, or ingest a drive with that rig again")
def rig(view: DatasetView) -> Iterator[Finding]:
    """A rig that a drive names is missing or broken, or its file has another rig's name."""
    for rig_id, document in view.rigs.items():
        if document.rig_id != rig_id:
            yield Finding(f"rigs/{rig_id}.json", "rig_id", f"holds rig {document.rig_id!r}")
    yield from unread(view.problems, lambda file: file.startswith("rigs/"))
