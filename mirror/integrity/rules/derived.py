"""Rules of IDX: the index, which is derived from all other files."""

from __future__ import annotations

from collections.abc import Iterator

import pyarrow.compute as pc

from mirror.dataset.index.inputs import DATASET_KEY
from mirror.integrity.dataset_view import DatasetView
from mirror.integrity.finding import Finding, Severity
from mirror.integrity.problems import report_unreadable
from mirror.integrity.rule import dataset_rule, scene_rule
from mirror.integrity.scene_view import SceneView


@dataset_rule(
    "IDX001",
    Severity.ERROR,
    title="There is no index, or its manifest is broken: the dataset cannot be opened.",
    remedy="run `mirror index`",
)
def _index_there(view: DatasetView) -> Iterator[Finding]:
    if view.index_manifest is None:
        broken = list(report_unreadable(view.problems, lambda file: file == "index/manifest.json"))
        yield from broken or [Finding("index", None, "there is no index")]


@dataset_rule(
    "IDX002",
    Severity.ERROR,
    title="The index was derived from other inputs than the present ones.",
    remedy="run `mirror index`",
)
def _index_stale(view: DatasetView) -> Iterator[Finding]:
    inputs = view.index_inputs
    if view.index_manifest is None or inputs is None:
        return
    found = view.index_manifest.derived_from
    changed = [key for key in {**inputs.fingerprints, **found} if inputs.fingerprints.get(key) != found.get(key)]
    scenes = sorted(key for key in changed if key != DATASET_KEY)
    if changed:
        yield Finding("index/manifest.json", "derived_from", f"stale: {', '.join(scenes) or 'drives'} changed since")


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
