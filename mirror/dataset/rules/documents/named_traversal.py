"""DS007."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule
from mirror.dataset.layout import MANIFEST, manifest_sha256


@dataset_rule("DS007", Severity.ERROR, remedy="run the same `mirror ingest` again")
def named_traversal(view: DatasetView) -> Iterator[Finding]:
    """A drive names a traversal that is missing, or that is not the one it was written with."""
    for traversal_id, (drive, expected) in view.named.items():
        file = f"traversals/{traversal_id}/recorded/{MANIFEST}"
        if not (view.layout.root / file).is_file():
            yield Finding(file, None, f"missing, but drive {drive} names the traversal")
        elif (found := manifest_sha256(view.layout.recorded(traversal_id))) != expected:
            yield Finding(file, None, f"SHA-256 is {found}, but drive {drive} was written with {expected}")
