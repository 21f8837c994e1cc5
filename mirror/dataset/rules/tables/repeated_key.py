"""TAB004."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView
from mirror.schema.tables import EGO_POSES


@scene_rule("TAB004", Severity.ERROR, remedy="take the repeated row out where it comes from, and write the table again")
def repeated_key(view: SceneView) -> Iterator[Finding]:
    """Two rows of a file have the same keys: two pictures of one camera at one instant, one box twice."""
    for rows in view.tables():
        if rows.table.name == EGO_POSES.name or not len(rows):
            continue
        keys = [rows.owner, *(column for pair in rows.key_columns() for column in pair)]
        order = np.lexsort(keys[::-1])
        same = np.all([key[order][1:] == key[order][:-1] for key in keys], axis=0)
        bad = np.zeros(len(rows), np.bool_)
        bad[order[1:][same]] = True
        yield from rows.findings(bad, lambda row: "the keys of another row")
