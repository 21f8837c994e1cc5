"""The derived tables of the complete dataset: scenes, passes and row groups."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from mirror.dataset.index.geoparquet import bounding_box, continuous, with_geo_metadata, wkb_polygon
from mirror.dataset.index.inputs import IndexInputs
from mirror.dataset.index.scene_tables import canonical_dictionaries, plain_schema
from mirror.dataset.layout import Layout
from mirror.errors import DatasetError
from mirror.schema.documents import Roi
from mirror.schema.files import encode_table, read_table
from mirror.schema.index_tables import INDEX_PASSES, ROW_GROUPS, SCENES
from mirror.schema.tables import PASSES, Table

_VERTICES_A_CIRCLE = 256


def read_passes(layout: Layout, inputs: IndexInputs) -> pa.Table:
    """Read the ledgers of all drives as one table.

    Raises:
        DatasetError: a ledger is missing, or its accepted traversals differ from those in its drive's manifest.
        SchemaError: a ledger is broken.
    """
    ledgers = []
    for drive_id, named in inputs.drives.items():
        file = layout.drive(drive_id) / "passes.parquet"
        ledger = read_table(file, PASSES)
        accepted = set(ledger.column("traversal_id").drop_null().to_pylist())
        if accepted != named:
            raise DatasetError(
                f"accepted passes and the traversals in the manifest differ by {sorted(accepted ^ named)[0]}",
                file=file,
                expected="one `traversal:<id>` in the drive's manifest for each accepted pass",
                remedy=f"ingest drive {drive_id} again",
            )
        ledgers.append(_plain(ledger, PASSES))
    if not ledgers:
        return _plain(PASSES.schema.empty_table(), PASSES)
    return pa.concat_tables(ledgers).sort_by([(name, "ascending") for name in PASSES.sorted_by])


def accepted_passes(passes: pa.Table) -> dict[str, dict[str, Any]]:
    """Return the accepted rows of the ledger, by traversal id."""
    accepted = passes.filter(pc.is_valid(passes.column("traversal_id")))
    return {row["traversal_id"]: row for row in accepted.to_pylist()}


def encode_global(
    inputs: IndexInputs, passes: pa.Table, traversals: pa.Table, row_groups: pa.Table
) -> dict[str, bytes]:
    """Encode the global tables except the table of traversals; the result maps table names to file bytes.

    Args:
        inputs: the inputs of the index.
        passes: the ledgers of all drives.
        traversals: rows of the table of traversals, without their geometries.
        row_groups: rows of the table of row groups.
    """
    row_groups = row_groups.sort_by([(name, "ascending") for name in ROW_GROUPS.sorted_by])
    return {
        SCENES.name: encode_table(with_geo_metadata(_scenes(inputs, traversals), "Polygon"), SCENES),
        INDEX_PASSES.name: encode_table(canonical_dictionaries(passes, INDEX_PASSES), INDEX_PASSES),
        ROW_GROUPS.name: encode_table(canonical_dictionaries(row_groups, ROW_GROUPS), ROW_GROUPS),
    }


def rows_to_table(rows: Sequence[Mapping[str, Any]], table: Table) -> pa.Table:
    """Convert rows to a table with plain strings in place of dictionaries."""
    return pa.Table.from_pylist(list(rows), schema=plain_schema(table))


def _plain(data: pa.Table, table: Table) -> pa.Table:
    return data.cast(plain_schema(table)).replace_schema_metadata(None)


def _scenes(inputs: IndexInputs, traversals: pa.Table) -> pa.Table:
    columns = ["scene_id", "drive_id", "images", "duration_s"]
    own: dict[str, list[Mapping[str, Any]]] = {scene_id: [] for scene_id in inputs.scenes}
    for row in traversals.select(columns).to_pylist():
        # A segment may add traversals to a scene that another segment has.
        own.setdefault(row["scene_id"], []).append(row)
    rows = []
    for scene_id, roi in inputs.scenes.items():
        ring = _ring(roi)
        figures = {
            "traversals": len(own[scene_id]),
            "drives": len({row["drive_id"] for row in own[scene_id]}),
            "images": sum(row["images"] for row in own[scene_id]),
            "duration_s": sum(row["duration_s"] for row in own[scene_id]),
            "geometry": None if ring is None else wkb_polygon(ring),
            "bbox": None if ring is None else bounding_box(ring),
        }
        rows.append({**roi.model_dump(), **figures})
    return rows_to_table(rows, SCENES)


def _ring(roi: Roi) -> Any:
    if roi.longitude_deg is None or roi.latitude_deg is None:
        return None
    from mirror.geometry.geodesy import geodesic_circle

    ring = geodesic_circle(roi.longitude_deg, roi.latitude_deg, roi.radius_m, _VERTICES_A_CIRCLE)
    ring[:, 0] = continuous(ring[:, 0])
    return ring
