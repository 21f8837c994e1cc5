"""FIL003."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Cost, Finding, Severity, dataset_rule
from mirror.schema.files import sha256_bytes


@dataset_rule(
    "FIL003",
    Severity.ERROR,
    cost=Cost.PICTURES,
    remedy="run the same `mirror ingest` again; for index/: `mirror index`",
)
def file_hash(view: DatasetView) -> Iterator[Finding]:
    """A file of the right size has other bytes than its manifest says."""
    for path, entry in view.listed_files():
        if path.is_file() and path.stat().st_size == entry.bytes:
            found = sha256_bytes(path.read_bytes())
            if found != entry.sha256:
                yield Finding(
                    view.name(path), None, f"SHA-256 is {found}, but the folder's manifest says {entry.sha256}"
                )
