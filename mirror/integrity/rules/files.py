"""Rules of FIL: the files that manifests list."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.integrity.dataset_view import DatasetView
from mirror.integrity.finding import Cost, Finding, Severity
from mirror.integrity.rule import dataset_rule
from mirror.schema.files import sha256_bytes


@dataset_rule(
    "FIL001",
    Severity.ERROR,
    title="A file that a manifest lists is missing.",
    cost=Cost.FILES,
    remedy="run the same `mirror ingest` again with --verify; for index/: `mirror index`",
)
def _missing_file(view: DatasetView) -> Iterator[Finding]:
    for path, _ in view.listed_files():
        if not path.is_file():
            yield Finding(view.name(path), None, "missing, but the folder's manifest lists it")


@dataset_rule(
    "FIL002",
    Severity.ERROR,
    title="A file has another size than its manifest says.",
    cost=Cost.FILES,
    remedy="run the same `mirror ingest` again with --verify; for index/: `mirror index`",
)
def _file_size(view: DatasetView) -> Iterator[Finding]:
    for path, entry in view.listed_files():
        if path.is_file() and (size := path.stat().st_size) != entry.bytes:
            yield Finding(view.name(path), None, f"{size} bytes, but the folder's manifest says {entry.bytes}")


@dataset_rule(
    "FIL003",
    Severity.ERROR,
    title="A file of the right size has other bytes than its manifest says.",
    cost=Cost.IMAGES,
    remedy="run the same `mirror ingest` again with --verify; for index/: `mirror index`",
)
def _file_hash(view: DatasetView) -> Iterator[Finding]:
    for path, entry in view.listed_files():
        if path.is_file() and path.stat().st_size == entry.bytes:
            found = sha256_bytes(path.read_bytes())
            if found != entry.sha256:
                yield Finding(
                    view.name(path), None, f"SHA-256 is {found}, but the folder's manifest says {entry.sha256}"
                )
