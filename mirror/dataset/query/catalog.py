"""The index for queries: columns of the global tables, and the ranges of row groups that let a query skip them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import Float64, Int32, Int64
from mirror.dataset.query.arrow import (
    floats_or_nan,
    integers_or_zero,
    is_member,
    to_arrow_mask,
    to_arrow_rows,
    to_arrow_strings,
    to_numpy,
)
from mirror.dataset.query.columns import ColumnCache
from mirror.dataset.query.files import TableFiles
from mirror.dataset.query.filters import Filters
from mirror.dataset.store import Store
from mirror.dataset.withheld import read_withheld
from mirror.schema.finished_work import hash_values
from mirror.schema.index_tables import INDEX_BY_SCENE, INDEX_GLOBAL
from mirror.schema.snapshot import IndexSegment, IndexSnapshot

TABLES: Final = {table.name: table for table in (*INDEX_GLOBAL, *INDEX_BY_SCENE)}
GLOBAL: Final = frozenset(table.name for table in INDEX_GLOBAL)
_VISIBLE_BY: Final = {
    "scenes": "scene_id",
    "traversals": "drive_id",
    "passes": "drive_id",
    "row_groups": "traversal_id",
}
"""The column by which a row of a segment is read or left out."""
_ORDER: Final = {"row_groups": ("table", "scene_id", "traversal_id")}
"""Row groups of several files have equal numbers."""
_NARROWED: Final = 4
"""Catalogs of some segments that are kept: each has the row groups of all that is in them."""
_COUNTED: Final = ("traversals", "drives", "images", "duration_s")


@dataclass(frozen=True, eq=False)
class RowGroups:
    """The row groups of one table.

    Attributes:
        path: (G,) file of each row group.
        number: (G,) position in the file.
        traversal: (G,) row of its traversal in the table of traversals.
        rows: (G,) number of rows.
        start_ns: (G,) smallest timestamp; 0 where the table has none.
        end_ns: (G,) largest timestamp.
        west: (G,) smallest longitude in degrees; NaN where the table has none.
        east: (G,) largest longitude.
        south: (G,) smallest latitude.
        north: (G,) largest latitude.
    """

    path: Sequence[str]
    number: Int32
    traversal: Int32
    rows: Int64
    start_ns: Int64
    end_ns: Int64
    west: Float64
    east: Float64
    south: Float64
    north: Float64


class Catalog:
    """The global tables of a snapshot and the row groups of the other tables, shared by all views of a dataset.

    Args:
        store: the dataset's files.
        snapshot: the snapshot.
    """

    def __init__(self, store: Store, snapshot: IndexSnapshot, columns: ColumnCache | None = None) -> None:
        self.store = store
        self.snapshot = snapshot
        self.columns = ColumnCache(TableFiles(store, snapshot)) if columns is None else columns
        self._key = hash_values([segment.name for segment in snapshot.segments])
        self._narrowed: dict[tuple[str, ...], Catalog] = {}
        self._groups: dict[str, RowGroups] = {}
        self._by_traversal: dict[str, dict[int, int]] = {}
        self._orders: dict[str, pa.Array] = {}

    @cached_property
    def is_whole(self) -> bool:
        """True if all rows of all segments are read."""
        return all(segment.is_whole for segment in self.snapshot.segments)

    @cached_property
    def is_compact(self) -> bool:
        """True if there is one segment, all rows of which are read."""
        return self.is_whole and len(self.snapshot.segments) == 1

    def read_global(self, name: str, columns: Sequence[str]) -> pa.Table:
        """Read columns of a global table with all rows; each column is one chunk."""
        if not self.snapshot.segments:
            return _schema(name, columns).empty_table()
        if self.is_compact:
            return self._read_segment(self.snapshot.segments[0], name, columns)
        arrays = self.columns.join(f"{name}@{self._key}", columns, lambda missing: self._join(name, missing))
        return pa.Table.from_arrays(arrays, schema=_schema(name, columns))

    def _join(self, name: str, columns: Sequence[str]) -> pa.Table:
        """Columns of a global table over all segments, in the table's order."""
        parts = [self._read_segment(segment, name, columns) for segment in self._segments_with(name)]
        if not parts:
            return _schema(name, columns).empty_table()
        table = pa.concat_tables(parts).unify_dictionaries().combine_chunks().take(self._order(name)).combine_chunks()
        for column in (one for one in columns if name == "scenes" and one in _COUNTED):
            field = TABLES[name].schema.field(column)
            values = [self._scene_counts[scene_id][column] for scene_id in self._scene_ids]
            table = table.set_column(list(columns).index(column), field, [pa.array(values, field.type)])
        return table

    def _segments_with(self, name: str) -> Sequence[IndexSegment]:
        """The segments that may have rows of a global table."""
        # Runs that add drives to known scenes add no scene.
        return [one for one in self.snapshot.segments if one.scenes or name != "scenes"]

    def read_by_segment(self, name: str, column: str) -> Iterator[pa.Array]:
        """Yield a column of a global table segment by segment, the one with most drives first.

        A value that occurs in the first segment is found without opening the others.
        """
        for segment in sorted(self._segments_with(name), key=lambda one: -len(one.drives)):
            yield self._read_segment(segment, name, [column]).column(0)

    def narrow(self, filters: Filters) -> Catalog:
        """Return a catalog of the segments that may have rows of traversals that pass the filters.

        Tables of other segments are not opened: a segment names its drives in the snapshot, and its scenes in its
        manifest.
        """
        drives, scenes = filters.drive, filters.scene
        if filters.traversal is not None:
            # `scene.drive.entry_ms`, and ids have no full stops.
            parts = [one.partition(".") for one in filters.traversal]
            drives = _common(drives, frozenset(rest.partition(".")[0] for _, _, rest in parts))
            scenes = _common(scenes, frozenset(scene_id for scene_id, _, _ in parts))
        segments = self.snapshot.segments
        if drives is not None:
            segments = tuple(one for one in segments if not drives.isdisjoint(one.drives))
        if scenes is not None and len(segments) > 1:
            keys = frozenset(f"scene:{scene_id}" for scene_id in scenes)
            segments = tuple(one for one in segments if not keys.isdisjoint(self._sources[one.name]))
        # No rows of one segment are none either.
        segments = segments or self.snapshot.segments[:1]
        if len(segments) == len(self.snapshot.segments):
            return self
        names = tuple(one.name for one in segments)
        found = self._narrowed.pop(names, None)
        if found is None:
            found = Catalog(self.store, self.snapshot.model_copy(update={"segments": segments}), self.columns)
        self._narrowed[names] = found
        while len(self._narrowed) > _NARROWED:
            self._narrowed.pop(next(iter(self._narrowed)))
        return found

    def _read_segment(self, segment: IndexSegment, name: str, columns: Sequence[str]) -> pa.Table:
        """The rows of one segment that are read."""
        path, schema = f"index/{segment.name}/{name}.parquet", _schema(name, columns)
        parts = [
            pa.Table.from_arrays(self.columns.read(path, group, columns), schema=schema)
            for group in range(self.columns.row_groups(path))
        ]
        table = parts[0] if len(parts) == 1 else pa.concat_tables(parts).unify_dictionaries().combine_chunks()
        if segment.is_whole:
            return table
        key = _VISIBLE_BY[name]
        if key == "traversal_id":
            ids = self._read_segment(segment, "traversals", [key]).column(0)
            visible = frozenset(ids.to_pylist())
        else:
            visible = frozenset(segment.scenes if key == "scene_id" else segment.drives)
        keys = [self.columns.read(path, group, [key])[0] for group in range(self.columns.row_groups(path))]
        return table.filter(to_arrow_mask(np.concatenate([is_member(one, visible) for one in keys])))

    def _order(self, name: str) -> pa.Array:
        """The rows of all segments in the table's order."""
        if name not in self._orders:
            keys = list(_ORDER.get(name, TABLES[name].sorted_by))
            parts = [self._read_segment(segment, name, keys) for segment in self._segments_with(name)]
            plain = pa.schema([pa.field(key, _plain_type(TABLES[name].schema.field(key).type)) for key in keys])
            table = pa.concat_tables([part.cast(plain) for part in parts])
            self._orders[name] = pc.sort_indices(table, sort_keys=[(key, "ascending") for key in keys])
        return self._orders[name]

    @cached_property
    def _sources(self) -> Mapping[str, frozenset[str]]:
        """The inputs of each segment, as `scene:<scene_id>` and others, by the segment's name."""
        manifests = self.columns.files.manifests([segment.name for segment in self.snapshot.segments])
        return {name: frozenset(manifest.derived_from) for name, manifest in manifests.items()}

    @cached_property
    def _scene_ids(self) -> list[str]:
        return list(self.read_global("scenes", ["scene_id"]).column(0).to_pylist())

    @cached_property
    def _scene_counts(self) -> dict[str, dict[str, Any]]:
        """The counts of each scene, over the traversals of all segments."""
        counts: dict[str, dict[str, Any]] = {
            scene_id: {"traversals": 0, "images": 0, "duration_s": 0.0, "drives": set()} for scene_id in self._scene_ids
        }
        for row in self.read_global("traversals", ["scene_id", "drive_id", "images", "duration_s"]).to_pylist():
            own = counts[row["scene_id"]]
            own["traversals"] += 1
            own["images"] += row["images"]
            own["duration_s"] += row["duration_s"]
            own["drives"].add(row["drive_id"])
        return {scene_id: {**own, "drives": len(own["drives"])} for scene_id, own in counts.items()}

    @cached_property
    def traversal_ids(self) -> pa.Array:
        """Traversal ids in the order of the table of traversals."""
        return self.read_global("traversals", ["traversal_id"]).column(0).combine_chunks()

    @cached_property
    def withheld(self) -> frozenset[str]:
        """Paths of the images that a published dataset withholds; empty for a complete dataset."""
        return read_withheld(self.store)

    def row_groups(self, name: str) -> RowGroups:
        """Return the row groups of a table, sorted by scene and traversal."""
        if name not in self._groups:
            self._groups[name] = self._load_groups(name)
        return self._groups[name]

    def group_of(self, name: str, traversal: int) -> tuple[str, int] | None:
        """Return the file and position of the row group with a traversal's rows in a table; None without rows.

        Args:
            name: name of the table.
            traversal: row of the traversal in the table of traversals.
        """
        groups = self.row_groups(name)
        if name not in self._by_traversal:
            self._by_traversal[name] = {row: group for group, row in enumerate(groups.traversal.tolist())}
        group = self._by_traversal[name].get(traversal)
        return None if group is None else (groups.path[group], int(groups.number[group]))

    def _load_groups(self, name: str) -> RowGroups:
        table = self.read_global("row_groups", TABLES["row_groups"].schema.names)
        table = table.append_column("segment", self._segments_of_row_groups())
        table = table.filter(to_arrow_mask(is_member(table.column("table"), frozenset([name]))))
        columns = {column: table.column(column) for column in table.column_names}
        return RowGroups(
            path=[
                f"index/{segment}/{name}/{scene_id}.parquet"
                for segment, scene_id in zip(columns["segment"].to_pylist(), columns["scene_id"].to_pylist())
            ],
            number=to_numpy(columns["row_group"]),
            traversal=to_numpy(pc.index_in(columns["traversal_id"], value_set=self.traversal_ids)),
            rows=to_numpy(columns["rows"]),
            start_ns=integers_or_zero(columns["start_ns"]),
            end_ns=integers_or_zero(columns["end_ns"]),
            west=floats_or_nan(columns["longitude_min_deg"]),
            east=floats_or_nan(columns["longitude_max_deg"]),
            south=floats_or_nan(columns["latitude_min_deg"]),
            north=floats_or_nan(columns["latitude_max_deg"]),
        )

    def _segments_of_row_groups(self) -> pa.Array:
        """The names of the segments with the rows of the table of row groups, in the table's order."""
        names = [segment.name for segment in self.snapshot.segments]
        rows = [self._read_segment(one, "row_groups", ["row_group"]).num_rows for one in self.snapshot.segments]
        owners = to_arrow_rows(np.repeat(np.arange(len(names)), rows))
        owners = owners if self.is_compact or not names else owners.take(self._order("row_groups"))
        return to_arrow_strings(names).take(owners)


def _schema(name: str, columns: Sequence[str]) -> pa.Schema:
    return pa.schema([TABLES[name].schema.field(key) for key in columns])


def _common(one: frozenset[str] | None, other: frozenset[str]) -> frozenset[str]:
    return other if one is None else one & other


def _plain_type(kind: pa.DataType) -> pa.DataType:
    return kind.value_type if pa.types.is_dictionary(kind) else kind
