"""LED006."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule
from mirror.dataset.rules.ledger.thresholds import accepted


@dataset_rule("LED006", Severity.ERROR, remedy="`mirror ingest RECORDING... --replace`")
def pass_identity(view: DatasetView) -> Iterator[Finding]:
    """A pass is of another drive, or its traversal's id is not `scene.drive.entry_ms`, or a refused one has an id."""
    passes = view.passes
    expected_drive = [file.split("/")[-2] for file in passes.files]
    yes = accepted(passes)
    decision, words = passes.words("decision")
    unknown = np.isin(decision, [code for code, word in enumerate(words) if word not in ("accepted", "refused")])
    why: dict[int, str] = {}
    columns = [passes.data.column(name).to_pylist() for name in ("scene_id", "drive_id", "traversal_id", "entry_ns")]
    for row, (scene, drive, traversal, entry_ns) in enumerate(zip(*columns)):
        name = f"{scene}.{drive}.{entry_ns // 1_000_000}"
        if unknown[row]:
            why[row] = f"decision is {words[decision[row]]!r}"
        elif drive != expected_drive[passes.owner[row]]:
            why[row] = f"drive_id is {drive!r}"
        elif traversal != (name if yes[row] else None):
            why[row] = (
                f"traversal_id is {traversal!r}; expected {name!r}" if yes[row] else f"refused, but {traversal!r}"
            )
        elif yes[row] and traversal not in view.named:
            why[row] = f"the drive's manifest does not name {traversal!r}"
    bad = np.zeros(len(passes), np.bool_)
    bad[list(why)] = True
    yield from passes.findings(bad, lambda row: why[row])
    there = {value for value in columns[2] if value is not None}
    read = {file.split("/")[-2] for file in passes.files}
    for traversal_id, (drive, _) in view.named.items():
        if drive in read and traversal_id not in there:
            yield Finding(f"drives/{drive}/passes.parquet", None, f"no accepted pass for traversal {traversal_id}")
