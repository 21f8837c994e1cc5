"""TAB003."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.arrays import Bool
from mirror.dataset.check.rows import Rows
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView
from mirror.schema.tables import EGO_POSES


@scene_rule("TAB003", Severity.ERROR, remedy="write the table again in the order that docs/schema.md states")
def row_order(view: SceneView) -> Iterator[Finding]:
    """Rows are not in the order that the table's schema states."""
    for rows in view.tables():
        # The order of poses is their time, which is a rule of its own.
        if rows.table.name != EGO_POSES.name:
            yield from rows.findings(backward(rows), lambda row: "comes before the row above it")


def backward(rows: Rows) -> Bool:
    """(N,) True where a row's keys are smaller than those of the row above it in its file; null has no order."""
    undecided = rows.same_file[1:].copy()
    smaller = np.zeros(len(rows), np.bool_)
    for values, known in rows.key_columns():
        both = undecided & known[1:] & known[:-1]
        smaller[1:] |= both & (values[1:] < values[:-1])
        undecided = both & (values[1:] == values[:-1])
    return smaller
