"""IDX003."""

from __future__ import annotations

from collections.abc import Iterator

import pyarrow.compute as pc
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "IDX003", Severity.ERROR, remedy="run `mirror index DATASET --force`, and report it: an index is a pure function"
)
def index_rows(view: SceneView) -> Iterator[Finding]:
    """An up-to-date index has another number of rows than the tables it was derived from."""
    groups = view.dataset.index_row_groups
    if groups is None:
        return
    own = groups.filter(pc.equal(groups.column("scene_id"), view.scene.scene_id))
    every = (view.poses, view.images, view.calibrations, view.boxes, view.masks, view.depth, view.points)
    indexed = {rows.table.name: 0 for rows in every}
    for row in own.select(["table", "rows"]).to_pylist():
        if row["table"] in indexed:
            indexed[row["table"]] += row["rows"]
    for rows in every:
        if indexed[rows.table.name] != len(rows):
            yield Finding(
                f"index/{rows.table.name}/{view.scene.scene_id}.parquet",
                None,
                f"{indexed[rows.table.name]} rows, but the traversals' tables have {len(rows)}",
            )
