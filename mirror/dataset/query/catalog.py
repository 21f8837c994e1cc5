"""The index for queries: columns of the global tables, and the ranges of row groups that let a query skip them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import Float64, Int32, Int64
from mirror.dataset.query.arrow import floats_or_nan, integers_or_zero, is_member, to_arrow_mask, to_numpy
from mirror.dataset.query.columns import ColumnCache
from mirror.dataset.query.files import TableFiles
from mirror.dataset.store import Store
from mirror.dataset.withheld import read_withheld
from mirror.schema.documents import FileEntry
from mirror.schema.index_tables import INDEX_BY_SCENE, INDEX_GLOBAL

TABLES: Final = {table.name: table for table in (*INDEX_GLOBAL, *INDEX_BY_SCENE)}
GLOBAL: Final = frozenset(table.name for table in INDEX_GLOBAL)


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
    """The global tables of an index and the row groups of the other tables, shared by all views of a dataset.

    Args:
        store: the dataset's files.
        files: sizes and hashes of the index's files from its manifest, by name.
    """

    def __init__(self, store: Store, files: Mapping[str, FileEntry]) -> None:
        self.store = store
        self.columns = ColumnCache(TableFiles(store, files))
        self._groups: dict[str, RowGroups] = {}
        self._by_traversal: dict[str, dict[int, int]] = {}

    def read_global(self, name: str, columns: Sequence[str]) -> pa.Table:
        """Read columns of a global table with all rows; each column is one chunk."""
        path, schema = f"index/{name}.parquet", pa.schema([TABLES[name].schema.field(key) for key in columns])
        parts = [
            pa.Table.from_arrays(self.columns.read(path, group, columns), schema=schema)
            for group in range(self.columns.row_groups(path))
        ]
        return parts[0] if len(parts) == 1 else pa.concat_tables(parts).unify_dictionaries().combine_chunks()

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
        table = table.filter(to_arrow_mask(is_member(table.column("table"), frozenset([name]))))
        columns = {column: table.column(column) for column in table.column_names}
        return RowGroups(
            path=[f"index/{name}/{scene_id}.parquet" for scene_id in columns["scene_id"].to_pylist()],
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
