"""LED007."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule


@dataset_rule("LED007", Severity.ERROR, remedy="`mirror ingest RECORDING... --replace`")
def overlapping_passes(view: DatasetView) -> Iterator[Finding]:
    """Two passes of one drive through one scene overlap in time."""
    passes = view.passes
    entry, end = passes.integers("entry_ns"), passes.integers("exit_ns")
    scene = passes.words("scene_id")[0]
    order = np.lexsort((end, entry, scene, passes.owner))
    one, two = order[:-1], order[1:]
    again = (passes.owner[one] == passes.owner[two]) & (scene[one] == scene[two]) & (entry[two] < end[one])
    bad = np.zeros(len(passes), np.bool_)
    bad[two[again]] = True
    yield from passes.findings(
        bad, lambda row: f"begins before the exit of another pass, from {entry[row]} to {end[row]}"
    )
