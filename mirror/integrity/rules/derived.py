"""Rules of IDX: the index, which is derived from all other files."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import pyarrow.compute as pc

from mirror.dataset.index.build import describe_changes, find_changes
from mirror.integrity.dataset_view import DatasetView
from mirror.integrity.finding import Finding, Severity
from mirror.integrity.problems import report_unreadable
from mirror.integrity.rule import dataset_rule, scene_rule
from mirror.integrity.scene_view import SceneView
from mirror.schema.snapshot import SNAPSHOTS, snapshot_path

_LISTED: Final = 10


@dataset_rule(
    "IDX001",
    Severity.ERROR,
    title="There is no index, or its newest snapshot is broken: the dataset cannot be opened.",
    remedy="run `mirror index`",
)
def _index_there(view: DatasetView) -> Iterator[Finding]:
    if view.index_state is None:
        broken = list(report_unreadable(view.problems, lambda file: file.startswith(SNAPSHOTS)))
        yield from broken or [Finding("index", None, "there is no index")]


@dataset_rule(
    "IDX002",
    Severity.ERROR,
    title="The index was derived from other inputs than the present ones.",
    remedy="run `mirror index`",
)
def _index_stale(view: DatasetView) -> Iterator[Finding]:
    inputs, state = view.index_inputs, view.index_state
    if state is None or inputs is None:
        return
    changed = describe_changes(find_changes(state.sources, inputs))
    if changed:
        listed = ", ".join(changed[:_LISTED]) + (f" and {len(changed) - _LISTED} more" * (len(changed) > _LISTED))
        yield Finding(snapshot_path(state.number), None, f"stale: {listed} changed since")


@scene_rule(
    "IDX003",
    Severity.ERROR,
    title="The number of rows in an up-to-date index differs from that of its source tables.",
    remedy="run `mirror index DATASET --force`, and report it: an index is a pure function",
)
def _index_rows(view: SceneView) -> Iterator[Finding]:
    groups = view.dataset.index_row_groups
    if groups is None:
        return
    own = groups.filter(pc.equal(groups.column("scene_id"), view.scene.scene_id))
    shown = (view.without_taken_down(rows) for rows in (view.images, view.masks, view.depth))
    every = (view.poses, view.calibrations, view.boxes, view.points, *shown)
    indexed = {rows.table.name: 0 for rows in every}
    for row in own.select(["table", "rows"]).to_pylist():
        if row["table"] in indexed:
            indexed[row["table"]] += row["rows"]
    for rows in every:
        if indexed[rows.table.name] != len(rows):
            yield Finding(
                "index",
                f"{rows.table.name} of scene {view.scene.scene_id}",
                f"{indexed[rows.table.name]} rows, but the traversals' tables have {len(rows)}",
            )
